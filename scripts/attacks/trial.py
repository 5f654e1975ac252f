"""A process with limits in which a stranger's text is tried: it may hang, grow or die there.

A module that attacks has `prepare()`, called once in the process, and `attempt(case)`, which does
what a user would do with the case, gives what is to be told, and raises what the user would see.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import logging
import os
import selectors
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SECONDS = 5.0
"""Of the processor that a case may take."""

PATIENCE = 30.0
"""Seconds after which the process is ended: a machine may be busy, but nothing waits for ever."""

STARTING = 600.0
"""Seconds for `prepare`, which may compile."""

CASES = 100
"""Of one process: MuJoCo does not give back the memory of an `mjData` that a plugin refuses."""

MEGABYTES = 500
"""By which the process may grow."""

LONGEST = 2000
"""Characters of a sentence."""

CANARY = "executed"
"""A file that is there if a case was executed."""

_EXECUTIONS = (
    "os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn", "os.system",
    "pickle.find_class", "pty.spawn", "socket.connect", "subprocess.Popen",
)  # fmt: skip


@dataclass
class Answer:
    """What became of a case.

    Attributes:
        kind: taken, refused (by an error of the package's or of MuJoCo's), raised (any other).
        said: the sentence, or what was made of it.
        seconds: of the processor.
        megabytes: by which the process has grown at the most, so far.
        wrong: what must not be, whatever the case was.
    """

    kind: str
    said: str
    seconds: float = 0.0
    megabytes: float = 0.0
    wrong: list[str] = field(default_factory=list)


class Trial:
    """Tries cases one after the other, in a process that is begun anew now and then.

    Args:
        module: name of the attacking module, "attacks.media".
    """

    def __init__(self, module: str) -> None:
        self._module = module
        self._folder = Path(tempfile.mkdtemp(prefix="attack-"))
        self._process: subprocess.Popen[bytes] | None = None
        self._tried = 0

    def __enter__(self) -> Trial:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()
        shutil.rmtree(self._folder, ignore_errors=True)

    def attempt(self, case: dict[str, Any]) -> Answer:
        """Tries a case."""
        if self._tried == CASES:
            self._end()
        if self._process is None:
            self._begin()
        self._tried += 1
        assert self._process is not None
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(case).encode() + b"\n")
            self._process.stdin.flush()
        line = self._read(PATIENCE)
        if line is None:
            answer = Answer("hangs", f"no answer in {PATIENCE:g} s", wrong=["it hangs"])
            self._end()
        elif not line:
            code = self._process.wait()
            answer = Answer("died", f"status {code}", wrong=[f"the process died, status {code}"])
            self._end()
        else:
            answer = Answer(**json.loads(line))
        canary = self._folder / CANARY
        if canary.exists():
            answer.wrong.append("the case was executed")
            canary.unlink()
        return answer

    def _begin(self) -> None:
        scripts = str(Path(__file__).resolve().parents[1])
        path = os.pathsep.join(filter(None, (scripts, os.environ.get("PYTHONPATH"))))
        self._process = subprocess.Popen(
            [sys.executable, "-m", "attacks.trial", self._module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=self._folder,
            env={**os.environ, "PYTHONPATH": path},
        )
        self._tried = 0
        if not self._read(STARTING):
            self._end()
            raise RuntimeError(
                f"{self._module} cannot be prepared: python -m attacks.trial says why"
            )

    def _read(self, patience: float) -> bytes | None:
        """A line of the process; empty if it has died, None if it says nothing for so long."""
        assert self._process is not None
        assert self._process.stdout is not None
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            return self._process.stdout.readline() if selector.select(patience) else None

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def try_all(module: str, cases: Iterable[dict[str, Any]]) -> list[str]:
    """Tries all cases of an attacking module.

    Returns:
        Failures: each a sentence with the case.
    """
    with Trial(module) as trial:
        found = [judge(case, trial.attempt(case)) for case in cases]
    return [failure for failure in found if failure is not None]


def judge(case: dict[str, Any], answer: Answer) -> str | None:
    """What is wrong with an answer, together with the case; None if nothing is."""
    wrong = list(answer.wrong)
    if answer.kind == "raised":
        wrong.append("not an error of the package's")
    if answer.kind == "refused" and not answer.said.isprintable():
        wrong.append("more than one line, or characters that cannot be printed")
    if len(answer.said) > LONGEST:
        wrong.append(f"a sentence of {len(answer.said)} characters")
    if answer.seconds > SECONDS:
        wrong.append(f"{answer.seconds:.1f} s")
    if answer.megabytes > MEGABYTES:
        wrong.append(f"{answer.megabytes:.0f} MB")
    if not wrong:
        return None
    shown = json.dumps(case)
    shown = shown if len(shown) < 3000 else f"{shown[:3000]}..."
    return f"{'; '.join(wrong)}: {answer.kind} {answer.said[:300]!r} for {shown}"


def main(module: str) -> None:
    """Answers cases, a line each, until there are no more."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a command prints is of no interest
    attack = importlib.import_module(module)
    attack.prepare()
    executed: list[str] = []

    def look(event: str, arguments: Any) -> None:
        if event in _EXECUTIONS:
            executed.append(f"{event} {str(arguments)[:100]}")

    records: list[str] = []
    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: records.append(record.getMessage()[:300])  # type: ignore[method-assign]
    logging.getLogger("mjgranular").addHandler(handler)
    sys.addaudithook(look)
    resident = _resident()
    _limit_memory()
    print("ready", file=answers, flush=True)
    for line in sys.stdin:
        case = json.loads(line)
        executed.clear()
        records.clear()
        began = time.process_time()
        kind, said = _attempt(attack, case)
        answer = Answer(kind, said, time.process_time() - began, _resident() - resident)
        answer.wrong += [f"executed {event}" for event in executed]
        answer.wrong += [f"logged {record!r}" for record in records]
        print(json.dumps(answer.__dict__), file=answers, flush=True)


def _attempt(attack: Any, case: dict[str, Any]) -> tuple[str, str]:
    import mujoco

    from mjgranular.errors import GranularError

    try:
        return "taken", str(attack.attempt(case))
    except GranularError as error:
        return "refused", str(error)
    except (ValueError, mujoco.FatalError) as error:
        reason = attack.own_words(error) if hasattr(attack, "own_words") else None
        return ("raised", f"{error!r}"[:1000]) if reason is None else ("refused", reason)
    except BaseException as error:
        return "raised", f"{error!r}"[:1000]


def _resident() -> float:
    """The most memory that the process has had so far [MB]."""
    try:
        import resource
    except ImportError:
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3


def _limit_memory() -> None:
    """Keeps the process from taking the machine's memory; on Linux only."""
    statistics = Path("/proc/self/statm")
    if statistics.exists():
        import resource

        now = int(statistics.read_text().split()[0]) * resource.getpagesize()
        limit = now + 2 * MEGABYTES * 10**6  # addresses are more than memory
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


if __name__ == "__main__":
    main(sys.argv[1])
