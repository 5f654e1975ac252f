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
from typing import Any, NamedTuple

from mjgranular.errors import InputError
from mjgranular.pool.workers import Chunk, Done, Function, WorkerLostError, run_chunk

# Chosen, not measured.
_STILLBORN = 5  # successive workers that may end before they have begun
_PATIENCE = 5.0  # [s] for a process to exit by itself


class _Worker(NamedTuple):
    """An executor with one process, and the future of its process id."""

    executor: ProcessPoolExecutor
    process_id: Future

    @property
    def begun(self) -> bool:
        """Whether it has been ready for work."""
        return self.process_id.done() and self.process_id.exception() is None


class ThisProcess:
    """No workers: chunks run in the calling process."""

    slots = count = 1

    def __init__(self, function: Function, shared: Any) -> None:
        self._function, self._shared = function, shared

    def submit(self, chunk: Chunk) -> Future:
        future: Future = Future()
        future.set_result(run_chunk(self._function, self._shared, chunk))
        return future

    def result(self, future: Future) -> Done:
        return future.result()

    def close(self) -> None:
        pass


class Processes:
    """Processes of this machine, each with one chunk at a time.

    Each is an executor with one process: if it dies, the chunks of the others are not affected.

    Args:
        function: function of the tasks; the processes import it by its name.
        shared: data for all of them.
        count: number of processes.
    """

    def __init__(self, function: Function, shared: Any, count: int) -> None:
        self.slots = self.count = count
        self._work = pickle.dumps((function, shared))
        # Spawned rather than forked: MuJoCo and numba may hold threads and locks.
        self._context = multiprocessing.get_context("spawn")
        # Closed by us or, if we are killed, by the system: then the workers end.
        self._until, self._ours = self._context.Pipe(duplex=False)
        self._idle: list[_Worker] = []
        self._busy: dict[Future, _Worker] = {}
        self._stillborn = 0

    def submit(self, chunk: Chunk) -> Future:
        worker = self._idle.pop() if self._idle else self._start()
        try:
            future = worker.executor.submit(_run, chunk)
        except BrokenProcessPool:  # it was killed while it was idle
            worker = self._start()
            future = worker.executor.submit(_run, chunk)
        self._busy[future] = worker
        return future

    def _start(self) -> _Worker:
        executor = ProcessPoolExecutor(
            1, self._context, initializer=_begin, initargs=(self._until, self._work)
        )
        return _Worker(executor, executor.submit(os.getpid))

    def result(self, future: Future) -> Done:
        worker = self._busy.pop(future)
        try:
            done = future.result()
        except BrokenProcessPool:
            raise self._lost(worker) from None
        self._stillborn = 0
        self._idle.append(worker)
        return done

    def _lost(self, worker: _Worker) -> WorkerLostError:
        """Return the error for a dead worker; another one is started when there is work for it.

        Raises:
            InputError: several in succession have died before they began.
        """
        worker.executor.shutdown()
        self._stillborn = 0 if worker.begun else self._stillborn + 1
        if self._stillborn >= _STILLBORN:
            raise InputError(
                "the worker processes end before they begin: a script needs "
                'if __name__ == "__main__": around what it does, or 1 worker'
            )
        reason = "its process ended abruptly, perhaps for lack of memory"
        return WorkerLostError(reason, begun=worker.begun)

    def close(self) -> None:
        self._ours.close()  # which ends them in the middle of a task
        workers = [*self._idle, *self._busy.values()]
        numbers = {worker.process_id.result() for worker in workers if worker.begun}
        for process in multiprocessing.active_children():
            if process.pid in numbers:
                process.join(_PATIENCE)
                process.kill()
        for worker in workers:
            worker.executor.shutdown(cancel_futures=True)
        self._idle.clear()
        self._busy.clear()
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


def _run(chunk: Chunk) -> Done:
    return run_chunk(*_work, chunk)
