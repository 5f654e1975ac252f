"""The engine `local`: processes of this machine, by `concurrent.futures`."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from mjgranular.errors import InputError
from mjgranular.pool.workers import Answer, Function, WorkerLostError, run_task

_AHEAD = 2  # tasks per process, so that none waits for us; chosen


class ThisProcess:
    """No workers: tasks run in the calling process."""

    slots = 1

    def __init__(self, function: Function, shared: Any) -> None:
        self._function, self._shared = function, shared

    def submit(self, task: Any) -> Future:
        future: Future = Future()
        future.set_result(run_task(self._function, self._shared, task))
        return future

    def result(self, future: Future) -> Answer:
        return future.result()

    def close(self) -> None:
        pass


class Processes:
    """Processes of this machine, each with one task at a time.

    If one dies, the tasks of all of them are lost, and other processes start.
    """

    def __init__(self, function: Function, shared: Any, count: int) -> None:
        self._count, self.slots = count, _AHEAD * count
        self._work = pickle.dumps((function, shared))
        # Spawned rather than forked: MuJoCo and numba may hold threads and locks.
        self._context = multiprocessing.get_context("spawn")
        # Closed by us or, if we are killed, by the system: then the workers end.
        self._until, self._ours = self._context.Pipe(duplex=False)
        self._executor = self._started()
        self._first = self._executor.submit(os.getpid)

    def _started(self) -> ProcessPoolExecutor:
        work = (self._until, self._work)
        return ProcessPoolExecutor(self._count, self._context, initializer=_begin, initargs=work)

    def submit(self, task: Any) -> Future:
        try:
            return self._executor.submit(_run, task)
        except BrokenProcessPool:
            self._executor.shutdown()
            self._executor = self._started()
            return self._executor.submit(_run, task)

    def result(self, future: Future) -> Answer:
        try:
            return future.result()
        except BrokenProcessPool:
            if self._first.exception() is not None:
                raise InputError(
                    "the worker processes end before they begin: a script needs "
                    'if __name__ == "__main__": around what it does, or 1 worker'
                ) from None
            reason = "its process ended abruptly, perhaps for lack of memory"
            raise WorkerLostError(reason) from None

    def close(self) -> None:
        self._ours.close()  # which ends them in the middle of a task
        self._executor.shutdown(cancel_futures=True)
        self._until.close()


# In a worker

_work: tuple[Function, Any]


def _begin(until: Connection, work: bytes) -> None:
    """Prepare a worker. Ctrl-C is for the parent, which keeps finished results."""
    global _work
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end() -> None:
        with suppress(EOFError, OSError):
            until.recv_bytes()  # nothing is ever sent
        os._exit(1)

    threading.Thread(target=end, daemon=True).start()
    _work = pickle.loads(work)


def _run(task: Any) -> Answer:
    return run_task(*_work, task)
