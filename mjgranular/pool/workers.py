"""Where tasks run: this process, or others of this machine by `concurrent.futures`.

A pool, as `on_ray.RayPool` is too, has a function and the shared data of its tasks. It accepts
`slots` tasks at a time by `submit`; `result` returns the outcome of one whose future is done, or
raises if no worker could do it; `close` ends all workers, even busy ones.
"""

import multiprocessing
import os
import pickle
import signal
import threading
import warnings
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Literal, NamedTuple, get_args

from mjgranular._util.checks import check_name
from mjgranular.errors import GranularError, GranularWarning, InputError, one_line

Engine = Literal["local", "ray"]

Function = Callable[[Any, Any], Any]
"""Takes the shared data and one task, and returns a result; workers import it by its name."""

_LONGEST = 500  # characters of an error's message; chosen


@dataclass(frozen=True)
class Workers:
    """Where tasks run.

    Attributes:
        engine: "local", processes of this machine, or "ray".
        count: number of tasks that run at once; None for one per core. Local, 1 is this process.
        address: address of a Ray cluster: HOST:PORT of its head, or "auto" for the one that this
            machine belongs to. None to start Ray on this machine.
    """

    engine: Engine = "local"
    count: int | None = None
    address: str | None = None

    def __post_init__(self) -> None:
        check_name("engine", self.engine, get_args(Engine))
        if self.count is not None and self.count < 1:
            raise InputError(f"a run needs at least 1 worker, got {self.count}")
        if self.address is not None and self.engine != "ray":
            raise InputError(f"an address is for Ray, not for {self.engine}: say --engine ray too")


class Answer(NamedTuple):
    """Outcome of one task: the result of the function, or why there is none."""

    result: Any
    error: str | None = None


class WorkerLostError(Exception):
    """A worker died with a task; says why, as far as it is known."""


def run_task(function: Function, shared: Any, task: Any) -> Answer:
    """Run a task in this process. A task that raises affects no other."""
    try:
        with warnings.catch_warnings(action="ignore", category=GranularWarning):  # one per task
            return Answer(function(shared, task))
    except GranularError as error:
        return Answer(None, str(error))
    except (Exception, SystemExit) as error:  # any code, such as a custom law
        return Answer(None, one_line(f"{type(error).__name__}: {error}")[:_LONGEST])


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
