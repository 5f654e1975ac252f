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

from mjgranular.errors import GranularWarning
from mjgranular.kernel import compiler, folder, program
from mjgranular.kernel.compiler import CompilerError, compiling
from mjgranular.kernel.program import Code

CODE = Code(bytes(range(256)) * 3, needs=("exp", "mju_error"), python=True)
STAMP = (1, 2)


def own() -> None:
    """A function whose code is kept."""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where it is kept."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(folder, "_told", set())
    return tmp_path / "cache"


@pytest.fixture
def kept(cache: Path) -> Path:
    """The file with `CODE` in it."""
    program.save(own, "own", STAMP, CODE)
    (path,) = cache.rglob("*.program")
    return path


def load(name: str = "own", stamp: object = STAMP) -> Code | None:
    return program.load(own, name, stamp)


def test_what_was_kept_is_loaded(kept: Path) -> None:
    assert load() == CODE
    assert load(stamp=(1, 3)) is None
    kept.rename(kept.with_name("other.program"))
    assert load("other") is None


def test_a_damaged_file_is_none(kept: Path) -> None:
    whole = kept.read_bytes()
    head = whole.index(b"\n", whole.index(b"\n") + 1) + 1
    chance = random.Random(1)
    places = [*range(head), *(chance.randrange(head, len(whole)) for _ in range(100))]
    damaged = [whole[:size] for size in (*range(0, head, 3), head, len(whole) - 1)]
    for place in places:
        for bit in (1 << chance.randrange(8), 0xFF):
            copy = bytearray(whole)
            copy[place] ^= bit
            damaged.append(bytes(copy))
    damaged += [whole + b"\0", b"\n", b"[]\n", b"null\n\n", b"[" * 100000, b"\xff\xfe\n"]
    for content in damaged:
        kept.write_bytes(content)
        assert load() is None
    kept.write_bytes(whole)
    assert load() == CODE


def a_folder(path: Path) -> None:
    path.mkdir()
    (path / "full").touch()


def a_link(path: Path) -> None:
    target = path.with_name("target")
    target.write_bytes(b"")
    path.symlink_to(target)


def a_pipe(path: Path) -> None:
    os.mkfifo(path)


def a_huge_file(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(1 << 40)


posix = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files do not say whose they are")


@posix
@pytest.mark.parametrize("what", [a_folder, a_link, a_pipe, a_huge_file])
def test_what_is_no_file_of_ours_is_none(kept: Path, what: Callable[[Path], None]) -> None:
    kept.unlink()
    what(kept)
    if what is a_link:
        with pytest.raises(OSError, match="symbolic links"):
            folder.read(kept)
    assert load() is None
    program.save(own, "own", STAMP, CODE)
    assert load() == (None if what is a_folder else CODE)
    assert not list(kept.parent.glob("*.program.*"))  # nothing half written


@posix
def test_the_folder_is_ours_alone(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for user, modes in ((0, (0o755, 0o644)), (os.geteuid() or 4321, (0o700, 0o600))):
        kept.unlink()
        kept.parent.rmdir()
        before = os.umask(0)
        monkeypatch.setattr(folder, "_user", lambda user=user: user)
        monkeypatch.setattr(folder, "_is_trusted", lambda path, found: True)
        try:
            program.save(own, "own", STAMP, CODE)
        finally:
            os.umask(before)
        (kept,) = kept.parents[1].rglob("*.program")
        assert f"mjgranular-{user}-" in kept.parent.name
        assert (
            stat.S_IMODE(kept.parent.stat().st_mode),
            stat.S_IMODE(kept.stat().st_mode),
        ) == modes


@posix
@pytest.mark.parametrize("mode", [0o020, 0o002])
@pytest.mark.parametrize("whole_folder", [False, True])
def test_what_others_may_write_is_not_read(kept: Path, mode: int, whole_folder: bool) -> None:
    path = kept.parent if whole_folder else kept
    path.chmod(path.stat().st_mode | mode)
    with pytest.warns(GranularWarning, match="may be written by others") as told:
        assert load() is None
    assert load() is None  # and is told once
    assert str(path) in str(told[0].message)
    content = kept.read_bytes()
    program.save(own, "own", STAMP, CODE)
    assert (load() is None) == whole_folder
    assert kept.read_bytes() == content
    assert program.can_be_kept(own) != whole_folder


class Foreign:
    """The state of a file that belongs to somebody else."""

    def __init__(self, found: os.stat_result, user: int) -> None:
        self._found, self.st_uid = found, user

    def __getattr__(self, name: str) -> Any:
        return getattr(self._found, name)


@posix
@pytest.mark.parametrize("whole_folder", [False, True])
def test_what_others_own_is_not_read(
    kept: Path, monkeypatch: pytest.MonkeyPatch, whole_folder: bool
) -> None:
    name, ask = ("lstat", Path.lstat) if whole_folder else ("fstat", os.fstat)
    holder = Path if whole_folder else os
    monkeypatch.setattr(holder, name, lambda path: Foreign(ask(path), 12345))
    with pytest.warns(GranularWarning, match="belongs to another user"):
        assert load() is None
    assert program.can_be_kept(own) != whole_folder
    monkeypatch.setattr(holder, name, lambda path: Foreign(ask(path), 0))
    assert load() == CODE  # what the administrator owns


@posix
def test_what_the_administrator_kept_for_all_is_read(
    kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept.parent.rename(kept.parents[1] / folder._name(Path(__file__), 0))
    monkeypatch.setattr(folder, "_user", lambda: 4321)
    fstat = os.fstat
    monkeypatch.setattr(os, "fstat", lambda file: Foreign(fstat(file), 0))
    lstat = Path.lstat
    monkeypatch.setattr(Path, "lstat", lambda path: Foreign(lstat(path), 0))
    assert load() == CODE


@posix
def test_a_folder_that_is_a_link_is_not_used(kept: Path) -> None:
    elsewhere = kept.parents[1] / "elsewhere"
    kept.parent.rename(elsewhere)
    kept.parent.symlink_to(elsewhere)
    with pytest.warns(GranularWarning, match="is a link"):
        assert load() is None


PLANTED = """
import os, pickle, sys
from pathlib import Path
from mjgranular.kernel import compiled

@compiled
def twice(x):
    return 2.0 * x

print(twice(1.0))
"""

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

print(entry(add, "int64", "float64")(1, 2.0), twice(1.0))
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
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=100)
    assert done.stdout == "5 2.0\n", done.stderr


PLANT = """
import pickle, sys
from pathlib import Path

class Mine:
    def __reduce__(self):
        return print, ("executed",)

for path in Path(sys.argv[1]).rglob("*.nb[ic]"):
    path.write_bytes(pickle.dumps(Mine()))
    path.chmod(0o666)
"""


@pytest.mark.slow
@posix
def test_what_numba_would_unpickle_is_not_read_either(tmp_path: Path) -> None:
    (tmp_path / "kernels.py").write_text(PLANTED)
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}

    def run(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", code, *arguments]
        return subprocess.run(command, env=env, capture_output=True, text=True, check=True)

    assert run("import kernels").stdout == "2.0\n"
    assert list((tmp_path / "cache").rglob("*.nbi"))
    run(PLANT, str(tmp_path / "cache"))
    done = run("import kernels")
    assert done.stdout == "2.0\n"
    assert "may be written by others" in done.stderr


@pytest.mark.parametrize(
    ("installed", "error", "said"),
    [
        ("0.61.2", AttributeError("no forceinline"), r"numba 0.61.2 cannot .*no forceinline"),
        ("0.99.0", TypeError("two\nlines"), r"numba 0.99.0 cannot .*\(TypeError: two\)"),
        ("0.68.1", ImportError("needs NumPy 2.4"), r"numba 0.68.1 cannot .*needs NumPy 2.4"),
        (None, ModuleNotFoundError("No module named 'numba'"), "numba is not installed"),
    ],
)
def test_what_is_numbas_fault_is_said_to_be(
    monkeypatch: pytest.MonkeyPatch, installed: str | None, error: Exception, said: str
) -> None:
    monkeypatch.setattr(compiler, "_installed", lambda: installed)
    with pytest.raises(CompilerError, match=said) as caught, compiling():
        raise error
    assert caught.value.__cause__ is error
    assert "tested versions of numba: 0.62 to 0.68" in str(caught.value)
    assert "MuJoCo" not in str(caught.value)


def test_an_error_in_a_law_stays_what_it_is_with_a_numba_that_was_tested() -> None:
    with pytest.raises(TypeError, match="mine"), compiling():
        raise TypeError("mine")


def test_without_numba_both_doors_say_so(tmp_path: Path) -> None:
    code = """
import sys
sys.modules.update({"numba": None, "numba.core.errors": None})
import mujoco
from mjgranular import Sand, add_sand
from mjgranular.models import Link
spec = Link().spec()
try:
    Sand(spec.compile())
except RuntimeError as error:
    print(error)
add_sand(spec)
for _ in range(2):
    try:
        spec.compile()
    except ValueError as error:
        print(error)
"""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 3
    for line in lines:
        assert "compile the kernels of mjgranular (ModuleNotFoundError: " in line
        assert "MuJoCo" not in line
