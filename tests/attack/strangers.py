"""Readers of what strangers write, for a child process that watches what they do.

A reader accepts its input or raises one clear error, at once, and executes nothing in it. `read`
returns what went wrong, in words, and an empty string if nothing did.
"""

from __future__ import annotations

import faulthandler
import io
import logging
import os
import re
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mjgranular.cli import main
from mjgranular.errors import GranularError
from mjgranular.law import get_law
from mjgranular.medium import get_medium

SECONDS, MEGABYTES, LONGEST = 5.0, 500.0, 2000
"""Limits: processor time of a case, growth of the process, characters of a message."""

HANGS = 600.0  # [s], after which the process ends
CANARY = "executed"
"""A file in the current folder that exists if something was executed."""

_EXECUTIONS = (
    "os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn", "os.system",
    "pickle.find_class", "pty.spawn", "socket.connect", "subprocess.Popen",
)  # fmt: skip
_seen: list[str] = []  # executions and logged errors of the current case
_begin = 0.0  # memory of the process before the first case [MB]


def begin(folder: Path) -> None:
    """Work in a folder."""
    os.chdir(folder)
    faulthandler.enable()


def prepare_text(medium: str, models: Sequence[str]) -> None:
    """Compile what valid input needs, check that it is accepted, and watch the process."""
    read_medium(medium.encode())
    Path("evil.yaml").write_text(f"!!python/object/apply:os.system [touch {CANARY}]", "utf-8")
    put_special(Path("pipe.yaml"), "pipe")
    put_special(Path("folder.yaml"), "folder")
    for model in models:
        read_model(model.encode())
    guard(limited=True)


def guard(*, limited: bool) -> None:
    """Watch the process from now on, and limit its memory if requested."""
    global _begin

    def watch(event: str, arguments: Any) -> None:
        if event in _EXECUTIONS:
            _seen.append(f"executed {event} {str(arguments)[:100]}")

    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: _seen.append(f"logged {record.getMessage()[:300]!r}")
    logging.getLogger("mjgranular").addHandler(handler)
    sys.addaudithook(watch)
    _begin = _peak_memory()
    size = Path("/proc/self/statm")
    if limited and size.exists():
        import resource

        now = int(size.read_text().split()[0]) * resource.getpagesize()
        limit = now + int(2e6 * MEGABYTES)  # address space exceeds memory
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _peak_memory() -> float:
    try:
        import resource
    except ImportError:  # Windows
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3


def read(reader: Callable[[Any], object], content: Any) -> str:
    """Call a reader; return what went wrong, empty if nothing did."""
    _seen.clear()
    faulthandler.dump_traceback_later(HANGS, exit=True)
    began = time.process_time()
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            reader(content)
        wrong = []
    except Exception as error:
        wrong = complaints_of(error, by_mujoco=reader is read_model)
    wrong += _seen
    seconds, grown = time.process_time() - began, _peak_memory() - _begin
    faulthandler.cancel_dump_traceback_later()
    if seconds > SECONDS:
        wrong.append(f"it took {seconds:.1f} s")
    if grown > MEGABYTES:
        wrong.append(f"the process grew by {grown:.0f} MB")
    if Path(CANARY).exists():
        wrong.append("something was executed")
        remove(Path(CANARY))
    return "; ".join(wrong)


def complaints_of(error: Exception, *, by_mujoco: bool) -> list[str]:
    """Return what is wrong with an error: it must be one clear sentence of ours.

    Args:
        error: the error.
        by_mujoco: whether MuJoCo may have raised it, with our message or its own.
    """
    said = str(error) if isinstance(error, GranularError) else None
    if said is None and by_mujoco:
        said = _own_words(error)
    if said is None:
        return [f"not an error of the package: {error!r}"[:1000]]
    wrong = [f"{len(said)} characters: {said[:300]!r}"] if len(said) > LONGEST else []
    if not said.isprintable():
        wrong.append(f"more than one line, or characters that cannot be printed: {said[:300]!r}")
    return wrong


def _own_words(error: Exception) -> str | None:
    """Return our message in an error of MuJoCo, or MuJoCo's; None for any other error."""
    if isinstance(error, UnicodeDecodeError):  # MuJoCo repeats its input
        return None if b"mjgranular '" in error.object else "MuJoCo: not UTF-8"
    if not isinstance(error, (ValueError, mujoco.FatalError)):
        return None
    ours = re.search(r"mjgranular (?:'.*?'|\".*?\"): (.*)", str(error), re.DOTALL)
    if ours is None:
        return "MuJoCo's own"
    return None if re.match(r"\w*(Error|Exception|Interrupt)\(", ours[1]) else ours[1]


def put_special(path: Path, kind: str) -> None:
    """Put a special file in place of a regular one; nothing for kinds without a file."""
    remove(path)
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "sparse":
        path.touch()
        os.truncate(path, 10**11)
    elif kind in ("zero", "loop", "unreadable"):
        path.symlink_to({"zero": "/dev/zero", "loop": path, "unreadable": "/proc/self/mem"}[kind])


def remove(path: Path) -> None:
    """Remove a file or a folder, if there is one."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)


def read_medium(content: bytes | str) -> None:
    """Read a medium from these bytes, or from a special file; make its law, and list it."""
    path = Path("stranger.yaml")
    if isinstance(content, bytes):
        remove(path)
        path.write_bytes(content)
    else:
        put_special(path, content)
    named = {"long": "x" * 5000 + ".yaml", "null": "a\0b.yaml"}
    name = named.get(content, str(path)) if isinstance(content, str) else str(path)
    try:
        medium = get_medium(name)
    except Exception:
        assert main(["list", "media", name]) == 2
        raise
    # Each law checks its constants: names and values may still be wrong.
    assert {main(["list", "media", name, *form]) for form in ([], ["--json"])} in ({0}, {2})
    get_law(None, medium)


def read_model(content: bytes) -> None:
    """Load a model, take some steps, and list its elements with the command."""
    path = Path("model.xml")
    path.write_bytes(content)
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except Exception:
        assert main(["elements", str(path)]) == 2
        raise
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 3)
    assert np.isfinite(data.qpos).all() or any(warning.number for warning in data.warning)
    assert main(["elements", str(path), "--medium", "play_sand"]) in (0, 2)
