"""Pass an untrusted string to a reader: it must accept or reject it at once, in one sentence.

Attacks call `guard` at the end of `prepare`, and `read` for each case.
"""

from __future__ import annotations

import logging
import os
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
from attacks.worker import Finding, Result, peak_memory

from mjgranular.errors import GranularError

SECONDS = 5.0
"""Limit of processor time per case [s]."""

MEGABYTES = 500
"""Limit of the growth of the process [MB]."""

LONGEST = 2000
"""Limit of the length of a message."""

CANARY = "executed"
"""A file in the current folder that exists if a case was executed."""

_EXECUTIONS = (
    "os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn", "os.system",
    "pickle.find_class", "pty.spawn", "socket.connect", "subprocess.Popen",
)  # fmt: skip
_seen: list[str] = []  # executions and logged errors of the current case
_begin = 0.0  # memory of the process before the first case [MB]


@dataclass
class Answer:
    """Outcome of a case.

    Attributes:
        kind: taken, refused (with an error of the package or of MuJoCo), raised (any other error).
        said: the error message, or the result of the case.
        seconds: processor time.
        megabytes: growth of the process so far.
        wrong: violations, for any case.
    """

    kind: str
    said: str
    seconds: float = 0.0
    megabytes: float = 0.0
    wrong: list[str] = field(default_factory=list)


def guard(*, limited: bool = True) -> None:
    """Watch the process from now on, and limit its memory (on Linux)."""
    global _begin

    def watch(event: str, arguments: Any) -> None:
        if event in _EXECUTIONS:
            _seen.append(f"executed {event} {str(arguments)[:100]}")

    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: _seen.append(f"logged {record.getMessage()[:300]!r}")  # type: ignore[method-assign]
    logging.getLogger("mjgranular").addHandler(handler)
    sys.addaudithook(watch)
    _begin = peak_memory()
    size = Path("/proc/self/statm")
    if limited and size.exists():
        import resource

        now = int(size.read_text().split()[0]) * resource.getpagesize()
        limit = now + 2 * MEGABYTES * 10**6  # address space exceeds memory
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def read(
    reader: Callable[[], object],
    text: str,
    own_words: Callable[[Exception], str | None] = lambda _error: None,
) -> Result:
    """Call a reader, and judge its answer.

    Args:
        reader: the function that a user would call.
        text: the case, for the finding.
        own_words: returns the message of an allowed ValueError or FatalError, else None.
    """
    _seen.clear()
    began = time.process_time()
    kind, said = _answer(reader, own_words)
    answer = Answer(kind, said, time.process_time() - began, peak_memory() - _begin, [*_seen])
    canary = Path(CANARY)
    if canary.exists():
        answer.wrong.append("the case was executed")
        remove(canary)
    wrong = judge(answer)
    findings = [Finding(wrong, f"{kind} {said[:300]!r} for {text[:3000]}")] if wrong else []
    return Result(findings, {kind: 1}, said)


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


def judge(answer: Answer) -> str:
    """Return what is wrong with an answer; empty if nothing is."""
    wrong = list(answer.wrong)
    if answer.kind == "raised":
        wrong.append("not an error of the package")
    if answer.kind == "refused" and not answer.said.isprintable():
        wrong.append("more than one line, or characters that cannot be printed")
    if len(answer.said) > LONGEST:
        wrong.append(f"a sentence of {len(answer.said)} characters")
    if answer.seconds > SECONDS:
        wrong.append(f"{answer.seconds:.1f} s")
    if answer.megabytes > MEGABYTES:
        wrong.append(f"{answer.megabytes:.0f} MB")
    return "; ".join(wrong)


def _answer(
    reader: Callable[[], object], own_words: Callable[[Exception], str | None]
) -> tuple[str, str]:
    try:
        return "taken", str(reader())
    except GranularError as error:
        return "refused", str(error)
    except (ValueError, mujoco.FatalError) as error:
        reason = own_words(error)
        return ("raised", f"{error!r}"[:1000]) if reason is None else ("refused", reason)
    except BaseException as error:
        return "raised", f"{error!r}"[:1000]
