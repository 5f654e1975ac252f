"""The engine `local`: processes on this machine, which end with this one in any case."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

from mjgranular.errors import InputError
from mjgranular.pool.chunk import Function, run_chunk
from mjgranular.pool.workers import Chunk, Done, Lost

# Successive workers that may end before they have begun, before we give up.
_STILLBORN = 3  # by themselves
_KILLED = 10  # from outside; chosen
_PATIENCE = 5.0  # [s] for a process to exit by itself; chosen


class ThisProcess:
    """No workers: chunks run in the calling process.

    Args:
        function: function of the tasks.
        shared: data for all of them.
    """

    slots = count = 1

    def __init__(self, function: Function, shared: Any) -> None:
        self._function, self._shared = function, shared
        self._chunks: deque[tuple[int, Chunk]] = deque()

    def submit(self, key: int, chunk: Chunk) -> None:
        self._chunks.append((key, chunk))

    def wait(self) -> list[Done | Lost]:
        key, chunk = self._chunks.popleft()
        return [Done(key, *run_chunk(self._function, self._shared, chunk))]

    def close(self) -> None:
        self._chunks.clear()


@dataclass
class _Worker:
    """A process: the connection to it, whether it has begun, and its current chunk."""

    process: Any
    line: Connection
    begun: bool = False
    key: int | None = None


class Processes:
    """Processes on this machine, each with one chunk at a time.

    Args:
        function: function of the tasks; the processes import it by its name.
        shared: data for all of them.
        count: number of processes.
    """

    def __init__(self, function: Function, shared: Any, count: int) -> None:
        # Spawned rather than forked: MuJoCo and numba may hold threads and locks.
        self._context = multiprocessing.get_context("spawn")
        # Closed by us or, if we are killed, by the system: then the workers end.
        self._until, self._ours = self._context.Pipe(duplex=False)
        self._work = pickle.dumps((function, shared))
        self._stillborn = 0
        self._workers: list[_Worker] = []
        self.slots = self.count = count

    def submit(self, key: int, chunk: Chunk) -> None:
        free = next((one for one in self._workers if one.key is None), None)
        if free is None:
            free = self._start()
        free.key = key
        with suppress(OSError):  # it has died, which `wait` detects
            free.line.send(chunk)

    def wait(self) -> list[Done | Lost]:
        found: list[Done | Lost] = []
        while not found:
            ready = wait([one.line for one in self._workers])
            for worker in [one for one in self._workers if one.line in ready]:
                found += self._hear(worker)
        return found

    def _hear(self, worker: _Worker) -> list[Done | Lost]:
        try:
            said = worker.line.recv()
        except (EOFError, OSError):
            return self._bury(worker)
        if not worker.begun:
            worker.begun = True
            self._stillborn = 0
            return []
        key, worker.key = worker.key, None
        assert key is not None
        return [Done(key, *said)]

    def _bury(self, worker: _Worker) -> list[Done | Lost]:
        """Drop a worker that has died; another one is started when there is work for it."""
        self._workers.remove(worker)
        worker.line.close()
        worker.process.join(_PATIENCE)
        code = worker.process.exitcode
        killed = code is not None and code < 0
        how = f"signal {-(code or 0)}" if killed else f"status {code}"
        reason = f"its process was ended from outside ({how}), perhaps for lack of memory"
        if not worker.begun:
            self._stillborn += 1
            if self._stillborn >= _STILLBORN and not killed:
                raise InputError(
                    "the worker processes end before they begin: a script needs "
                    'if __name__ == "__main__": around what it does, or 1 worker'
                )
            if self._stillborn >= _KILLED:
                raise InputError(f"no worker can begin: {reason}")
        return [] if worker.key is None else [Lost(worker.key, reason, worker.begun)]

    def _start(self) -> _Worker:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(
            target=_work, args=(theirs, self._until, self._work), daemon=True
        )
        process.start()
        theirs.close()
        worker = _Worker(process, ours)
        self._workers.append(worker)
        return worker

    def close(self) -> None:
        self._ours.close()  # which ends them in the middle of a task
        for worker in self._workers:
            worker.process.join(_PATIENCE)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
            worker.line.close()
        self._workers.clear()
        self._until.close()


def _work(line: Connection, until: Connection, work: bytes) -> None:
    """Process chunks as they come. Ctrl-C is for the parent, which keeps finished results."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end() -> None:
        with suppress(EOFError, OSError):
            until.recv_bytes()  # nothing is ever sent
        os._exit(1)

    threading.Thread(target=end, daemon=True).start()
    function, shared = pickle.loads(work)
    with suppress(EOFError, OSError):  # the parent has gone
        line.send(None)
        while True:
            line.send(run_chunk(function, shared, line.recv()))
