"""Files survive a killed process: whole or not at all, together, and by one writer at a time."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from mjgranular._util import files
from mjgranular._util.io import checked_fields, is_plain_name, read_arrays, read_json, read_text
from mjgranular._util.signals import Stopped, stopped_by_signals
from mjgranular.cli import main
from mjgranular.errors import OutputError
from mjgranular.experiment import Impact, Study, journal_of, run_study
from mjgranular.experiment.folder import read_impact
from mjgranular.pool import UNFINISHED

BALL = """
<mujoco><worldbody>
  <body pos="0 0 .1"><freejoint/><geom size=".1"/></body>
</worldbody></mujoco>
"""
QUICK = ["--timestep", "1e-4", "--duration", "0.05", "--json"]
OF = "impact --timestep 1e-4 --duration 0.05"


# One file


def test_a_file_is_written_whole_or_left_as_it_was(tmp_path):
    file = tmp_path / "a.txt"
    files.write_text(file, "old")

    def half(error: BaseException) -> None:
        with files.atomic_write(file) as part:
            assert part.suffix == ".txt"  # writers choose the format by it
            part.write_text("half")
            raise error

    with pytest.raises(OutputError, match="No space left on device"):
        half(OSError(28, "No space left on device"))
    assert file.read_text() == "old"
    with pytest.raises(KeyboardInterrupt):
        half(KeyboardInterrupt())
    assert file.read_text() == "old"
    with files.atomic_write(file) as part:
        part.write_text("new")
    assert file.read_text() == "new"
    assert list(tmp_path.iterdir()) == [file]


# Files that belong together


class Killed(BaseException):
    """As good as a lost machine: nothing catches it."""


OPERATIONS = 30


@pytest.mark.parametrize("at", range(OPERATIONS))
def test_files_that_belong_together_are_never_mixed(at, tmp_path, monkeypatch):
    """At whatever operation the process is killed: all old or all new for a reader."""
    names = ("a", "b", "c")

    def publish(what: str, some: tuple[str, ...]) -> None:
        with files.replace_directory(tmp_path, instead_of=names) as waiting:
            for name in some:
                (waiting / name).write_text(what)

    def read() -> dict[str, str]:
        there = {name: files.latest_path(tmp_path, name) for name in names}
        return {name: path.read_text() for name, path in there.items() if path.exists()}

    publish("old", names)
    count = 0

    def counted(original):
        def operation(*args, **kwargs):
            nonlocal count
            count += 1
            if count == at + 1:
                raise Killed
            if count > at:  # a killed process does not clean up
                raise Killed
            return original(*args, **kwargs)

        return operation

    with monkeypatch.context() as patch:
        for name in ("replace", "rename", "fsync", "unlink", "mkdir", "rmdir"):
            patch.setattr(os, name, counted(getattr(os, name)))
        try:
            publish("new", ("a", "b"))
        except Killed:
            killed = True
        else:
            killed = False
    old, new = dict.fromkeys(names, "old"), {"a": "new", "b": "new"}
    seen = read()
    # What goes may be there until the next process has cleaned up; a reader knows it by the others.
    assert seen in (old, new, {**new, "c": "old"})
    files.finish_publishing(tmp_path)
    files.remove_leftovers(tmp_path)
    assert read() in ((old,) if seen == old else (new,))
    assert {path.name for path in tmp_path.iterdir()} == set(read())
    assert killed or read() == new
    assert killed == (at < count) or not killed


def test_what_waits_names_nothing_elsewhere(tmp_path):
    """A stranger's folder cannot have files removed that are not in it."""
    mine = tmp_path / "mine"
    mine.write_text("")
    folder = tmp_path / "folder"
    (folder / ".publish").mkdir(parents=True)
    names = ["../mine", str(mine), ".hidden", 7, None]
    (folder / ".publish" / "publish.json").write_text(json.dumps({"remove": names}))
    files.finish_publishing(folder)
    assert mine.exists()
    assert not (folder / ".publish").exists()


@pytest.mark.parametrize("name", ["", ".", "..", "../a", "/a", "a/b", ".a", "a\0", "a\\b", 7, None])
def test_plain_names(name):
    assert not is_plain_name(name)
    assert is_plain_name("trajectory.npz")


# Folders


def test_damage_of_a_folder_is_found_out(tmp_path):
    folder = tmp_path / "step-1"

    def fill(at: Path) -> None:
        (at / "a").write_text("a")

    files.write_folder(folder, fill)
    assert files.find_corruption(folder, ["a"]) is None
    assert files.find_corruption(folder, ["b"]) == "manifest.json lacks b"
    (folder / files.MANIFEST).write_text("{}")  # says nothing of what is there
    assert files.find_corruption(folder, ["a"]) is not None
    (folder / files.MANIFEST).write_text('{"../step-1/a": {}}')
    assert files.find_corruption(folder) is not None


def test_the_old_folder_comes_back_if_the_new_one_was_not_in_its_place_yet(tmp_path):
    (tmp_path / ".step-1.gone").mkdir()
    (tmp_path / ".step-1.part0").mkdir()
    (tmp_path / ".other.part0").mkdir()
    files.remove_leftovers(tmp_path, ["step-1"])
    assert {path.name for path in tmp_path.iterdir()} == {"step-1", ".other.part0"}


# One process at a time


HOLD = """
import sys
from mjgranular._util import files
with files.locked(files.Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""
CONTEND = """
import sys, time
from pathlib import Path
from mjgranular._util import files
from mjgranular.errors import OutputError
folder, count = Path(sys.argv[1]), int(sys.argv[2])
while count:
    try:
        with files.locked(folder):
            count -= 1
            number = int((folder / "number").read_text())
            (folder / "number").write_text(str(number + 1))
            (folder / "log").open("a").write("x")
    except OutputError:
        time.sleep(0.001)
"""


def python(code: str, *arguments: object) -> subprocess.Popen:
    """A process of its own."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def test_one_process_at_a_time(tmp_path):
    with python(HOLD, tmp_path / "new") as process:
        assert process.stdout.readline() == b"held\n"
        with (
            pytest.raises(OutputError, match="in use by another process"),
            files.locked(tmp_path / "new"),
        ):
            pass
        assert main(["impact", *QUICK, "--out", str(tmp_path / "new")]) == 2
        process.kill()  # the system lets go of its lock
    with files.locked(tmp_path / "new"):
        assert (tmp_path / "new" / files.LOCK).exists()
        with pytest.raises(OutputError), files.locked(tmp_path / "new"):
            pass
    assert list((tmp_path / "new").iterdir()) == []


@pytest.mark.slow
def test_a_lock_that_is_removed_by_its_holder_still_keeps_others_out(tmp_path):
    (tmp_path / "number").write_text("0")
    several = [python(CONTEND, tmp_path, 60) for _ in range(3)]
    for process in several:
        process.communicate()
        assert process.returncode == 0
    assert int((tmp_path / "number").read_text()) == (tmp_path / "log").stat().st_size == 180


# Results


def test_a_result_takes_the_place_of_the_whole_one_before(tmp_path, capfd):
    folder = tmp_path / "run"
    assert main(["impact", *QUICK, "--out", str(folder)]) == 0
    (folder / "impact.mp4").write_text("a film of the old one")
    (folder / "diary.txt").write_text("mine")
    sweep = ["sweep", "--vary", "speed=2,4", "--of", OF, "--workers", "1", "--out", str(folder)]
    assert main(sweep) == 2
    assert main([*sweep, "--overwrite"]) == 0
    assert {path.name for path in folder.iterdir()} == {
        *("config.json", "summary.json", "sweep.csv", "sweep.png", "diary.txt")
    }


@pytest.mark.parametrize(
    ("command", "drawn"),
    [
        (["impact", *QUICK], "mjgranular.cli.impact.draw_forces"),
        (["drop", "ball.xml", "--duration", "0.05"], "mjgranular.cli.drop.draw_drop"),
    ],
)
def test_a_command_that_was_cut_off_while_it_drew_goes_on(
    command, drawn, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    Path("ball.xml").write_text(BALL)
    command, other = (
        [*command, "--out", "run"],
        [*command, "--medium", "quikrete_medium", "--out", "run"],
    )

    def cut_off(*arguments, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(drawn, cut_off)
        assert main(command) == 130
    assert main(other) == 2
    assert "holds a result already" in capfd.readouterr().err
    assert main(command) == 0
    assert list(Path("run").glob("*.png"))
    assert not Path("run", "unfinished").exists()
    assert main(command) == 2


def test_a_training_run_is_not_overwritten(tmp_path, capfd):
    (tmp_path / "config.json").write_text('{"command": "train"}')
    assert main(["impact", *QUICK, "--out", str(tmp_path), "--overwrite"]) == 2
    assert "holds a training run" in capfd.readouterr().err
    assert (tmp_path / "config.json").read_text() == '{"command": "train"}'


@pytest.mark.slow
def test_a_reader_sees_one_result_while_it_is_replaced(tmp_path, monkeypatch):
    """The result changes between two files that belong together: read again."""
    folder = tmp_path / "run"
    for speed in ("2", "4"):
        name = str(tmp_path / speed)
        assert main(["impact", *QUICK, "--speed", speed, "--out", name]) == 0
    (tmp_path / "2").rename(folder)
    calls = 0

    def arrays(file, names, **options):
        nonlocal calls
        calls += 1
        if calls == 1:  # after configuration and summary were read, before the samples
            with files.replace_directory(folder) as waiting:
                for path in (tmp_path / "4").glob("*.[jn]*"):
                    (waiting / path.name).write_bytes(path.read_bytes())
        return read_arrays(file, names, **options)

    monkeypatch.setattr("mjgranular.experiment.trajectory.read_arrays", arrays)
    impact, summary, trajectory, _ = read_impact(folder)
    assert impact.speed == summary["speed"] == 4.0
    assert trajectory.v_Ty[0] == pytest.approx(4.0, rel=1e-2)
    assert calls == 2


# Sweeps


SWEEP = Study(Impact(timestep=1e-4, duration=0.05), {"speed": [1.0, 5.5, 10.0]})


def kept(sweep, folder):
    """The rows that a folder keeps of a sweep, by their number; None if there are none of it."""
    journal = journal_of(sweep, folder)
    if journal.fault() is not None:
        return None
    journal.begin()
    rows = {index: journal[index] for index in range(len(sweep)) if index in journal}
    journal.close()
    return rows


def keep(sweep, folder, index, row):
    journal = journal_of(sweep, folder)
    journal.begin()
    journal.keep(index, row)
    journal.close()


def test_rows_are_kept_as_soon_as_they_are_finished(tmp_path):
    whole = list(run_study(SWEEP, workers=1).rows())
    assert kept(SWEEP, tmp_path) is None
    (tmp_path / UNFINISHED).write_text('{"asked"')  # killed at its first line
    assert kept(SWEEP, tmp_path) == {}
    keep(SWEEP, tmp_path, 2, {**whole[2], "speed": 7.0})
    altered = (tmp_path / UNFINISHED).read_text().replace('"speed": 7.0', '"speed": 8.0')
    (tmp_path / UNFINISHED).write_text(altered)
    assert journal_of(SWEEP, tmp_path).fault() == "it is damaged"
    (tmp_path / UNFINISHED).unlink()
    keep(SWEEP, tmp_path, 2, whole[2])
    with (tmp_path / UNFINISHED).open("a") as file:
        file.write('{"index": 1, "ro')  # killed while it wrote
    assert kept(SWEEP, tmp_path) == {2: whole[2]}
    assert kept(Study(SWEEP.experiment, {"speed": [1.0, 10.0]}), tmp_path) is None
    journal = journal_of(SWEEP, tmp_path)
    journal.begin()
    done = []
    result = run_study(SWEEP, workers=1, journal=journal, progress=done.append)
    assert done == [2, 3]
    assert list(result.rows()) == whole
    journal.close()


def test_another_unfinished_sweep_is_not_lost(tmp_path, capfd):
    keep(SWEEP, tmp_path, 0, next(run_study(SWEEP, workers=1).rows()))
    before = (tmp_path / UNFINISHED).read_bytes()
    command = ["sweep", "--workers", "1", "--of", OF, "--out", str(tmp_path), "--vary"]
    assert main([*command, "speed=1:10:5"]) == 2
    assert UNFINISHED in capfd.readouterr().err
    assert (tmp_path / UNFINISHED).read_bytes() == before
    assert main([*command, "speed=1:10:3"]) == 0
    assert not (tmp_path / UNFINISHED).exists()
    assert json.loads((tmp_path / "summary.json").read_text())["finished"] == 3


def workers_of(pid: int) -> list[int]:
    """Processes that a process has started and that are still there."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if fields[3] == str(pid) and fields[0] != "Z" and entry.name != str(pid):
            found.append(int(entry.name))
    return found


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes as Linux does")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_a_sweep_that_is_ended_and_its_rows_are_kept(number, tmp_path):
    command = [sys.executable, "-m", "mjgranular", "sweep", "--vary", "speed=1:10:400"]
    command += ["--of", "impact --timestep 1e-6", "--workers", "2", "--out", str(tmp_path)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, start_new_session=True) as process:
        deadline = time.monotonic() + 600
        file = tmp_path / UNFINISHED  # its first line says what is asked for
        while not (file.exists() and file.read_text().count("\n") >= 2):
            assert time.monotonic() < deadline
            time.sleep(0.1)
        assert len(workers_of(process.pid)) >= 2
        process.send_signal(number)
        said = process.communicate(timeout=600)[1].decode()
    assert process.returncode == (143 if number == signal.SIGTERM else -9)
    assert "Traceback" not in said.partition("multiprocessing")[0]
    deadline = time.monotonic() + 600
    while workers_of(process.pid) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not workers_of(process.pid)
    assert (tmp_path / UNFINISHED).read_text().count("\n") >= 2
    if number == signal.SIGTERM:
        assert "the same command resumes it" in said
        assert json.loads((tmp_path / "config.json").read_text())["config"]["interrupted"] is True


# Reading what strangers wrote


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "Expecting value"),
        ("[1]", "must be an object, not a list"),
        ("[" * 100_000, "is damaged"),
        ('{"a": NaN}', "NaN"),
        ('{"a": ' + "9" * 5000 + "}", "is damaged"),
        ('{"a": "\\ud800"}', "surrogates not allowed"),
        ("\x00", "is damaged"),
    ],
)
def test_json_that_is_none_is_told_of(text, message, tmp_path):
    file = tmp_path / "config.json"
    file.write_text(text)
    with pytest.raises(OutputError, match=message) as caught:
        read_json(file)
    assert len(str(caught.value)) < 400


@pytest.mark.skipif(sys.platform == "win32", reason="files of POSIX")
def test_only_regular_files_of_sensible_size_are_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "endless").symlink_to("/dev/zero")
    (tmp_path / "itself").symlink_to(tmp_path / "itself")
    (tmp_path / "folder").mkdir()
    with (tmp_path / "huge").open("wb") as stream:
        stream.truncate(2**40)
    for name in ("pipe", "endless", "itself", "folder", "huge", "missing"):
        with pytest.raises(OutputError, match=name):
            read_text(tmp_path / name)
    with pytest.raises(OutputError):
        read_text(Path("nul\0"))


def test_arrays_are_numbers_or_refused(tmp_path):
    file = tmp_path / "a.npz"
    np.savez(file, a=np.array([{}], dtype=object))
    with pytest.raises(OutputError, match="is damaged"):
        read_arrays(file, ["a"])
    for value in (np.array([np.nan]), np.array(["x"]), np.array([1j])):
        np.savez(file, a=value)
        with pytest.raises(OutputError, match="a must be finite numbers"):
            read_arrays(file, ["a"])
    with pytest.raises(OutputError, match=r"b\.npy"):
        read_arrays(file, ["b"])
    np.savez_compressed(file, a=np.zeros(10**6))
    for most in (10**6, None):
        with pytest.raises(OutputError, match="larger than anything"):
            read_arrays(file, ["a"], most=most)
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(OutputError, match="not a zip file"):
        read_arrays(file, ["a"])


@pytest.mark.parametrize(
    "content", [None, [], {"a": 1}, {"speed": "x"}, {"speed": True}, {"law": 7}, {"until": "x"}]
)
def test_fields_have_known_names_and_types(content):
    with pytest.raises(OutputError):
        checked_fields(Impact, content, "config.json")
    assert checked_fields(Impact, {"speed": 1, "law": None}, "") == {"speed": 1, "law": None}


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no such signal")
def test_a_signal_that_a_library_turns_into_an_error_of_its_own_is_the_signal():
    """pybind11 does, in the conversion of an argument: matplotlib said `TypeError`."""

    def convert() -> None:
        try:
            signal.raise_signal(signal.SIGHUP)
        except KeyboardInterrupt:
            raise TypeError("incompatible arguments") from None

    with pytest.raises(Stopped) as stopped, stopped_by_signals():
        convert()
    assert stopped.value.number == signal.SIGHUP
    with pytest.raises(TypeError, match="by itself"), stopped_by_signals():
        raise TypeError("by itself")
