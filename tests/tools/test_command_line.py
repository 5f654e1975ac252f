"""The command line: its contract, its files, and one clear sentence for every mistake."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from mjgranular.cli import main
from mjgranular.pool import UNFINISHED

REQUIRED = {
    "law": str,
    "medium": str,
    "scheme": str,
    "timestep": float,
    "speed": float,
    "angle_deg": float,
    "stopping_time": float,
    "depth": float,
    "stopped": bool,
}


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Runs the command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "mjgranular", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


def test_impact_prints_exactly_one_json_object(capfd):
    assert main(["impact", "--json"]) == 0
    printed = json.loads(capfd.readouterr().out)
    for key, kind in REQUIRED.items():
        assert isinstance(printed[key], kind), key
    assert printed["law"] == "link"
    assert printed["medium"] == "play_sand"
    assert printed["scheme"] == "explicit"
    assert (printed["speed"], printed["angle_deg"]) == (10.0, 45.0)
    assert printed["stopping_time"] == pytest.approx(0.007363, rel=2e-3)
    assert printed["depth"] == pytest.approx(0.032508, rel=2e-3)


def test_a_drop_that_does_not_stop_says_so(capfd):
    assert main(["impact", "--json", "--speed", "1", "--duration", "0.005"]) == 0
    printed = json.loads(capfd.readouterr().out)
    assert printed["stopped"] is False
    assert printed["stopping_time"] is None


def test_impact_writes_what_it_promises(tmp_path, capfd):
    folder = tmp_path / "new" / "run"
    assert main(["impact", "--out", str(folder)]) == 0
    assert "stopping time" in capfd.readouterr().out
    assert sorted(path.name for path in folder.iterdir()) == [
        "config.json",
        "forces.png",
        "motion.png",
        "summary.json",
        "trajectory.npz",
    ]
    config = json.loads((folder / "config.json").read_text())
    assert config["config"]["speed"] == 10.0
    assert config["config"]["law"] == "link"  # resolved
    assert config["versions"]["mujoco"]
    assert "seed" in config
    summary = json.loads((folder / "summary.json").read_text())
    with np.load(folder / "trajectory.npz") as arrays:
        assert arrays["y_T"][0] == 0
        assert arrays["y_T"].max() == pytest.approx(summary["depth"], rel=1e-4)
        assert (arrays["power"] <= 0).all()


def test_a_result_is_not_overwritten_unless_told(tmp_path, capfd):
    folder = tmp_path / "run"
    assert main(["impact", "--out", str(folder)]) == 0
    before = (folder / "summary.json").read_bytes()
    assert main(["impact", "--speed", "5", "--out", str(folder)]) == 2
    assert "--overwrite" in capfd.readouterr().err
    assert (folder / "summary.json").read_bytes() == before
    assert main(["impact", "--speed", "5", "--out", str(folder), "--overwrite"]) == 0
    assert json.loads((folder / "summary.json").read_text())["speed"] == 5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--speed", "-1"], ["speed", "negative"]),
        (["--speed", "nan"], ["speed", "finite"]),
        (["--speed", "inf"], ["speed", "finite"]),
        (["--tangential-speed", "nan"], ["finite"]),
        (["--angular-velocity", "inf"], ["finite"]),
        (["--length", "-0.2"], ["length", "positive"]),
        (["--length", "nan"], ["length", "positive"]),
        (["--diameter", "0"], ["diameter", "positive"]),
        (["--diameter", "0.3"], ["longer"]),
        (["--density", "inf"], ["density", "finite"]),
        (["--timestep", "0"], ["time step", "positive"]),
        (["--timestep", "-1e-5"], ["time step", "positive"]),
        (["--timestep", "nan"], ["time step", "finite"]),
        (["--angle", "90"], ["less than 90", "flat"]),
        (["--angle", "-90"], ["less than 90"]),
        (["--angle", "135"], ["less than 90"]),
        (["--height", "-0.01"], ["below the surface"]),
        (["--medium", "moon_dust"], ["moon_dust", "play_sand"]),
        (["--law", "newton"], ["newton", "link, link_distributed"]),
        (["--scheme", "rk4"], ["rk4", "explicit"]),
        (["--video", "--camera", "back"], ["back", "side, close, corner"]),
        (["--timestep", "0.01"], ["time step", "too large"]),
    ],
)
def test_mistakes_are_told_in_one_sentence(tmp_path, capfd, arguments, words):
    folder = tmp_path / "run"
    assert main(["impact", *arguments, "--out", str(folder)]) == 2
    said = capfd.readouterr()
    assert said.out == ""
    assert "Traceback" not in said.err
    error = said.err.rpartition("error: ")[2]
    for word in words:
        assert word in error
    assert not folder.exists()


def test_a_large_step_is_warned_of_with_the_bound(capfd):
    assert main(["impact", "--json", "--timestep", "3e-4"]) == 0
    said = capfd.readouterr()
    assert "0.00018" in said.err
    assert json.loads(said.out)["stopped"]


def test_video_without_a_folder_is_refused(capfd):
    assert main(["impact", "--video"]) == 2
    assert "--out" in capfd.readouterr().err


def test_a_folder_that_cannot_be_written_is_refused_before_computing(tmp_path, capfd):
    occupied = tmp_path / "file"
    occupied.write_text("a user's")
    for folder in (occupied, occupied / "below", Path("/proc/nowhere")):
        assert main(["impact", "--out", str(folder)]) == 2
        assert "cannot write" in capfd.readouterr().err
    assert occupied.read_text() == "a user's"


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_a_read_only_folder_is_refused(tmp_path, capfd):
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o555)
    assert main(["impact", "--out", str(folder)]) == 2
    assert "cannot write" in capfd.readouterr().err


def test_unknown_options_and_commands_exit_with_2():
    done = run("impact", "--sped", "1")
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    for arguments in (["fall"], ["impact", "--speed", "fast"]):
        try:
            status = main(arguments)
        except SystemExit as end:  # of the parser
            status = end.code
        assert status == 2


@pytest.mark.slow
def test_help_of_every_command():
    done = run("--help")
    assert done.returncode == 0
    for command in ("impact", "sweep", "render", "list"):
        assert command in done.stdout
        with pytest.raises(SystemExit) as stopped:
            main([command, "--help"])
        assert stopped.value.code == 0


def test_lists_name_their_sources(capfd):
    assert main(["list", "media", "play_sand"]) == 0
    assert "Lee and Marghitu" in capfd.readouterr().out
    assert main(["list", "media", "--json"]) == 0
    media = json.loads(capfd.readouterr().out)
    assert media[0]["density"]["unit"] == "kg/m^3"
    assert main(["list", "laws"]) == 0
    assert "link_distributed" in capfd.readouterr().out
    assert main(["list", "laws", "--json"]) == 0
    assert all(law["citation"] for law in json.loads(capfd.readouterr().out))
    assert main(["list", "media", "moon_dust"]) == 2
    assert "play_sand" in capfd.readouterr().err


@pytest.mark.slow
def test_sweep_in_processes_equals_sweep_in_one(tmp_path, capfd):
    common = ["sweep", "--json", "--vary", "speed=2:6:4"]
    assert main([*common, "--workers", "1"]) == 0
    alone = capfd.readouterr().out
    assert main([*common, "--workers", "2", "--out", str(tmp_path / "sweep")]) == 0
    assert capfd.readouterr().out == alone
    assert sorted(path.name for path in (tmp_path / "sweep").iterdir()) == [
        "config.json",
        "summary.json",
        "sweep.csv",
        "sweep.png",
    ]


def test_sweep_over_the_angle_in_degrees(capfd):
    arguments = ["sweep", "--json", "--vary", "angle=30:60:3", "--of", "impact --speed 2"]
    assert main([*arguments, "--workers", "1"]) == 0
    rows = json.loads(capfd.readouterr().out)
    assert [row["angle_deg"] for row in rows] == pytest.approx([30, 45, 60])
    assert all(row["speed"] == 2 for row in rows)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--vary", "speed=3:3:2"], ["both ends", "differ"]),
        (["--vary", "speed=nan:3:2"], ["finite"]),
        (["--vary", "angle=30:100:5"], ["less than 90"]),
        (["--workers", "0"], ["at least 1 worker"]),
    ],
)
def test_mistakes_in_a_sweep(tmp_path, capfd, arguments, words):
    assert main(["sweep", *arguments, "--out", str(tmp_path / "run")]) == 2
    error = capfd.readouterr().err
    assert all(word in error for word in words)
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")
def test_an_interrupted_sweep_keeps_what_is_finished(tmp_path):
    folder = tmp_path / "sweep"
    command = [sys.executable, "-m", "mjgranular", "sweep", "--vary", "speed=1:10:2000"]
    command += ["--of", "impact --timestep 1e-6", "--out", str(folder)]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A shell starts what it puts in the background deaf to Ctrl-C, these tests too.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:
        deadline = time.monotonic() + 600
        rows = folder / UNFINISHED  # its first line says what is asked for
        while not (rows.exists() and rows.read_text().count("\n") > 4):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGINT)  # what Ctrl-C in a terminal does
        try:
            _, errors = process.communicate(timeout=600)
        finally:
            process.kill()  # in case it did not listen
    assert process.returncode == 130
    assert "Traceback" not in errors
    finished = json.loads((folder / "summary.json").read_text())["finished"]
    assert 0 < finished < 2000
    assert f"{finished} of 2000 are finished" in errors
    assert json.loads((folder / "config.json").read_text())["config"]["interrupted"] is True


def test_environments_are_listed_with_their_specifications(capfd):
    assert main(["list", "envs", "--json"]) == 0
    rows = json.loads(capfd.readouterr().out)
    assert {"mjgranular/ChainSwim-v0", "mjgranular/Ant-v0"} <= {row["id"] for row in rows}
    assert main(["list", "envs", "mjgranular/Hexapod-v0"]) == 0
    assert "Observation Space" in capfd.readouterr().out
    assert main(["list", "envs", "Nobody"]) == 2
    assert "there are: mjgranular/Ant-v0" in capfd.readouterr().err.replace("\n", " ")


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX pipes")
@pytest.mark.parametrize("command", [["drop", "--help"], ["--version"], ["list", "media"]])
def test_a_reader_that_goes_away_is_no_traceback(command):
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "mjgranular", *command],
        stdout=writer, stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")
