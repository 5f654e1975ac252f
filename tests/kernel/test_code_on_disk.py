"""Machine code on disk is executed: only what nobody else can have written, as it was written."""

from __future__ import annotations

import os
import random
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from numba import config

from mjgranular.errors import GranularWarning
from mjgranular.kernel import cache
from mjgranular.kernel.compiled import KernelError, compiling

CODE = bytes(range(256)) * 3
BUILD, NAME = "build", "program"


def decorate() -> str:
    """Reads and writes as numba does: two files, in a folder of the folder that it is told."""
    place = Path(config.CACHE_DIR, "package")
    index, code = place / "program.nbi", place / "program.1.nbc"
    if code.exists():
        assert (index.read_bytes(), code.read_bytes()) == (b"index", CODE)
        return "loaded"
    place.mkdir()
    index.write_bytes(b"index")
    code.write_bytes(CODE)
    return "compiled"


def load(name: str = NAME, build: str = BUILD) -> str | None:
    return cache.load(build, name, decorate)


def save() -> str | None:
    return cache.save(BUILD, NAME, decorate)


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which programs are kept."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "_reported", set())
    assert save() == "compiled"
    (made,) = (tmp_path / "cache").iterdir()
    return made


@pytest.fixture
def kept(root: Path) -> Path:
    """The file with `CODE` in it."""
    return root / BUILD / NAME / "package" / "program.1.nbc"


def test_what_was_kept_is_loaded(root: Path) -> None:
    assert load() == "loaded"
    assert load(build="another") is None
    assert load(name="another") is None
    assert [path.name for path in (root / BUILD).iterdir()] == [NAME]  # nothing half written


def test_a_kept_program_that_is_damaged_is_made_again(kept: Path) -> None:
    sums = kept.parents[1] / "sums"
    chance = random.Random(1)
    for path in (kept, kept.with_name("program.nbi"), sums):
        whole = path.read_bytes()
        damaged = [whole[:size] for size in range(0, len(whole), 7)]
        for place in (*range(min(40, len(whole))), *(chance.randrange(len(whole)) for _ in "ab")):
            for bit in (1 << chance.randrange(8), 0xFF):
                copy = bytearray(whole)
                copy[place] ^= bit
                damaged.append(bytes(copy))
        damaged += [whole + b"x", b"\n", b"[]\n", b"null", b"{}", b"[" * 100000, b"\xff\xfe\n"]
        for content in damaged:
            path.write_bytes(content)
            assert load() is None
        path.write_bytes(whole)
        assert load() == "loaded"
    sums.unlink()
    assert load() is None
    assert save() == "compiled"
    assert load() == "loaded"


def test_a_file_too_many_is_not_read(kept: Path) -> None:
    kept.with_name("program.2.nbc").write_bytes(b"")
    assert load() is None


def test_numba_is_left_as_it_was(root: Path) -> None:
    before = config.CACHE_DIR
    load()
    with pytest.raises(ZeroDivisionError):
        cache.save(BUILD, "another", lambda: 1 // 0)
    assert before == config.CACHE_DIR
    assert [path.name for path in (root / BUILD).iterdir()] == [NAME]


@pytest.mark.slow
def test_two_that_compile_at_once(root: Path) -> None:
    """Whoever ends first: what is kept is whole, and of one of them."""
    places = [Path(root.parent, name) for name in "ab"]
    code = f"""
import sys, time
from pathlib import Path
sys.path.insert(0, {str(Path(__file__).parent)!r})
from mjgranular.kernel import cache
import test_code_on_disk as t
me, other = sys.argv[1:]
def slow():
    made = t.decorate()
    Path(me).touch()
    end = time.monotonic() + 10
    while not Path(other).exists() and time.monotonic() < end:
        time.sleep(0.001)
    return made
print(cache.save({BUILD!r}, "race", slow), cache.load({BUILD!r}, "race", t.decorate))
"""
    a, b = map(str, places)
    runs = [
        subprocess.Popen([sys.executable, "-c", code, *names], stdout=subprocess.PIPE, text=True)
        for names in ((a, b), (b, a))
    ]
    for run in runs:
        out, _ = run.communicate(timeout=600)
        assert out.split()[0] == "compiled"
    assert load("race") == "loaded"  # that of the first, which the second left


def a_folder(path: Path) -> None:
    path.mkdir()
    (path / "full").touch()


def a_pipe(path: Path) -> None:
    os.mkfifo(path)


posix = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files do not say whose they are")


@posix
@pytest.mark.parametrize("what", [a_folder, a_pipe])
def test_what_is_no_file_of_ours_is_made_again(kept: Path, what: Callable[[Path], None]) -> None:
    kept.unlink()
    what(kept)
    assert load() is None
    assert save() == "compiled"
    assert load() == "loaded"


@posix
def test_the_folder_is_ours_alone(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for user, modes in ((0, {0o755, 0o644}), (os.geteuid() or 4321, {0o700, 0o600})):
        before = os.umask(0)
        monkeypatch.setattr(cache, "_user", lambda user=user: user)
        monkeypatch.setattr(cache, "_is_trusted", lambda folder: True)
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(root.parents[1] / str(user)))
        try:
            save()
        finally:
            os.umask(before)
        made = root.parents[1] / str(user) / f"mjgranular-{user}"
        assert {stat.S_IMODE(path.stat().st_mode) for path in (made, *made.rglob("*"))} == modes


@posix
@pytest.mark.parametrize("mode", [0o020, 0o002])
def test_what_others_may_write_is_not_read(root: Path, mode: int) -> None:
    root.chmod(root.stat().st_mode | mode)
    with pytest.warns(GranularWarning, match="can be written by other users") as warned:
        assert load() is None
    assert load() is None  # and is said once
    assert str(root) in str(warned[0].message)
    assert not cache.can_save()
    assert save() is None


class Foreign:
    """The state of a file that belongs to somebody else."""

    def __init__(self, found: os.stat_result, user: int) -> None:
        self._found, self.st_uid = found, user

    def __getattr__(self, name: str) -> Any:
        return getattr(self._found, name)


@posix
def test_what_others_own_is_not_read(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lstat = Path.lstat
    monkeypatch.setattr(Path, "lstat", lambda path: Foreign(lstat(path), 12345))
    with pytest.warns(GranularWarning, match="belongs to another user"):
        assert load() is None
    assert not cache.can_save()
    monkeypatch.setattr(Path, "lstat", lambda path: Foreign(lstat(path), 0))
    assert load() == "loaded"  # what the administrator owns


@posix
def test_what_the_administrator_kept_for_all_is_read(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root.rename(root.with_name("mjgranular-0"))
    monkeypatch.setattr(cache, "_user", lambda: 4321)
    lstat = Path.lstat
    monkeypatch.setattr(Path, "lstat", lambda path: Foreign(lstat(path), 0))
    assert load() == "loaded"


@posix
def test_a_folder_that_is_a_link_is_not_used(root: Path) -> None:
    elsewhere = root.with_name("elsewhere")
    root.rename(elsewhere)
    root.symlink_to(elsewhere)
    with pytest.warns(GranularWarning, match="is a link"):
        assert load() is None


def test_programs_of_builds_long_gone_are_removed(root: Path) -> None:
    old, new = root / "old", root / "new"
    for path, age in ((old, 40), (new, 10)):
        path.mkdir()
        then = path.stat().st_mtime - age * 86400
        os.utime(path, (then, then))
    save()
    assert new.exists()
    assert not old.exists()


IMPORTED = """
import mujoco, mjgranular
from mjgranular.kernel import compiled, entry
from mjgranular.models import Link

@compiled
def twice(x):
    return 2.0 * x

@compiled
def add(n, x):
    return n + int(twice(x))

print(entry(add, "int64(int64, float64)")(1, 2.0), twice(1.0))
spec = Link().spec()
mjgranular.add_sand(spec)
spec.compile()
"""


@pytest.mark.slow
def test_kernels_are_compiled_while_their_module_is_imported(tmp_path: Path) -> None:
    """The compiler must not wait for the module: it is waited for."""
    (tmp_path / "kernels.py").write_text(IMPORTED)
    env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", "import kernels"]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=600)
    assert done.stdout == "5 2.0\n", done.stderr


def test_an_error_in_a_law_is_one_sentence() -> None:
    with pytest.raises(TypeError, match="mine") as caught, compiling("law mud"):
        raise TypeError('\x1b[1mFailed in nopython mode pipeline\nmine\nFile "a.py", line 3:')
    assert isinstance(caught.value, KernelError)
    assert str(caught.value) == (
        "numba cannot compile the kernels for law mud: TypeError: mine, in a.py, line 3"
    )
    said = "KeyError: no record that they read has a field 'visc'"
    with pytest.raises(KernelError, match=said), compiling("law mud"):
        raise KeyError("visc")


HOLD = """
import sys
from mjgranular.kernel import cache
with cache.alone("build", "program"):
    print("locked", flush=True)
    sys.stdin.read()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no locks of files on Windows")
def test_one_process_at_a_time_compiles_a_program(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command, pipe = [sys.executable, "-c", HOLD], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "locked\n"
        with cache.alone(BUILD, "another"):
            pass
        waited = []

        def let_go() -> None:
            waited.append(other.poll())
            other.communicate()

        monkeypatch.setattr(cache, "cancellation_point", let_go)
        with cache.alone(BUILD, NAME):
            assert waited == [None]


@pytest.mark.skipif(sys.platform == "win32", reason="no locks of files on Windows")
def test_a_lock_that_is_never_released_is_not_waited_for_forever(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command, pipe = [sys.executable, "-c", HOLD], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "locked\n"
        monkeypatch.setattr(cache, "_PATIENCE", 0.1)
        with cache.alone(BUILD, NAME):
            assert other.poll() is None
        other.communicate()
