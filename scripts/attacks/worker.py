"""Run cases in worker processes, which may hang, crash or use too much memory.

An attack is a module with

    cases(options, numbers)    list the cases with these numbers: dictionaries for JSON
    attempt(case, note)        return a `Result`; `note` records its progress in words
    describe(case)             optional: return a case in words
    prepare(), finish()        optional: called once in each worker
    PATIENCE                   optional: seconds that a case may take
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import importlib
import multiprocessing
import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import Any

PATIENCE = 30.0
"""Seconds that a case may take: the machine may be busy."""

STARTING = 900.0
"""Seconds that `prepare` may take: it may compile and train."""

CASES = 100
"""Cases of one process: MuJoCo does not free an `mjData` whose plugin raises an error."""

_CONTEXT = multiprocessing.get_context("spawn")
Case = dict[str, Any]
Note = Callable[[str], None]


@dataclass
class Finding:
    """Something that must not happen.

    Attributes:
        kind: a short label, the same for all findings of one kind.
        text: what happened.
        where: step and interface.
        value: magnitude, to find the worst of a kind.
        failed: whether it is a failure, or only information.
    """

    kind: str
    text: str
    where: str = ""
    value: float = 0.0
    failed: bool = True


@dataclass
class Result:
    """Outcome of a case."""

    findings: list[Finding] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    said: str = ""
    seconds: float = 0.0
    megabytes: float = 0.0  # peak memory of the process so far


class Worker:
    """A process that attempts one case after another, and is replaced when it dies."""

    def __init__(self, attack: str, folder: Path) -> None:
        self._attack, self._folder = attack, folder
        self._patience = getattr(importlib.import_module(attack), "PATIENCE", PATIENCE)
        self._noted = _CONTEXT.RawArray(ctypes.c_char, 200)  # survives a crash
        self._process: Any = None
        self._attempted = 0
        folder.mkdir()

    def attempt(self, case: Case) -> Result:
        """Attempt a case; a death of the process is a finding."""
        result = self._once(case)
        if result is not None:
            return result
        finding = self._death()
        if "bare" in case and self._once({**case, "bare": True}) is None:
            self.close()
            finding.kind, finding.failed = f"{finding.kind} (MuJoCo's own)", False
        return Result([finding])

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._connection.close()  # requests its end
            self._process.join(5.0)
            self._process.kill()
            self._process.join()
            self._process = None

    def _once(self, case: Case) -> Result | None:
        if self._attempted == CASES:
            self.close()
        if self._process is None:
            self._start()
        self._attempted += 1
        with contextlib.suppress(BrokenPipeError):
            self._connection.send(case)
        return self._answer(self._patience)

    def _start(self) -> None:
        self._connection, other = _CONTEXT.Pipe()
        arguments = self._attack, self._folder, other, self._noted
        self._process = _CONTEXT.Process(target=_serve, args=arguments)
        self._process.start()
        other.close()
        self._attempted = 0
        if self._answer(STARTING) is None:
            raise RuntimeError(f"{self._attack} cannot be prepared: {self._death().text}")

    def _answer(self, patience: float) -> Result | None:
        """Wait for an answer; return None after a timeout or if the process has died."""
        try:
            return self._connection.recv() if self._connection.poll(patience) else None
        except (EOFError, OSError):
            return None

    def _death(self) -> Finding:
        """Describe how the process died, or end it if it hangs."""
        self._process.join(5.0)
        code = self._process.exitcode
        kind = "hangs" if code is None else f"exit code {code}"
        if code is not None and code < 0:
            kind = signal.Signals(-code).name
        self.close()
        log = (self._folder / "log").read_text(errors="replace").strip()
        return Finding(kind, log[-2000:] or "no message", self._noted.value.decode())


def run(attack: str, cases: Sequence[Case], jobs: int = 1) -> Iterator[tuple[int, Result]]:
    """Attempt cases in worker processes; yield indices of cases and results as they arrive."""
    with (
        tempfile.TemporaryDirectory(prefix="attack-") as folder,
        ThreadPoolExecutor(jobs) as executor,
    ):
        workers = [Worker(attack, Path(folder) / str(number)) for number in range(jobs)]
        idle: SimpleQueue[Worker] = SimpleQueue()
        for worker in workers:
            idle.put(worker)

        def attempt(case: Case) -> Result:
            worker = idle.get()
            try:
                return worker.attempt(case)
            finally:
                idle.put(worker)

        futures = {executor.submit(attempt, case): index for index, case in enumerate(cases)}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            executor.shutdown(wait=False, cancel_futures=True)
            for worker in workers:
                worker.close()


def attempt_here(attack: Any, case: Case, note: Note) -> Result:
    """Attempt a case in this process."""
    began = time.perf_counter()
    try:
        result = attack.attempt(case, note)
    except Exception:
        result = Result([Finding("the attack itself", traceback.format_exc(limit=-3))])
    result.seconds, result.megabytes = time.perf_counter() - began, peak_memory()
    return result


def peak_memory() -> float:
    """Return the peak memory of the process so far [MB]."""
    try:
        import resource
    except ImportError:  # Windows
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3


def _serve(attack: str, folder: Path, connection: Connection, noted: Any) -> None:
    """Answer cases in a worker process until the connection is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    os.chdir(folder)
    log = os.open("log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    os.dup2(log, 1)
    os.dup2(log, 2)
    faulthandler.enable()
    module = importlib.import_module(attack)
    if hasattr(module, "prepare"):
        module.prepare()
    connection.send(Result())

    def note(text: str) -> None:
        noted.value = text.encode()[:199]

    with contextlib.suppress(EOFError):
        while True:
            connection.send(attempt_here(module, connection.recv(), note))
    if hasattr(module, "finish"):
        module.finish()
