"""A function over many independent tasks, robust to dying workers."""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

from mjgranular._util.signals import signal_of
from mjgranular.pool.journal import Journal
from mjgranular.pool.local import Processes, ThisProcess
from mjgranular.pool.workers import Done, Function, Pool, WorkerLostError, Workers

TRIES = 3
"""Attempts at a task; after the first, in a chunk, it runs alone."""

# A chunk of one second takes 1.6 % longer on Ray than on local processes (docs/cluster.md), and
# little is lost with it. Toward the end of a run chunks become smaller, so that all workers end
# together.
_SECONDS = 1.0
_ROUNDS = 2
_LARGEST = 10_000


@dataclass(frozen=True)
class Failure:
    """A task without a result.

    Attributes:
        index: number of the task.
        reason: the reason, in a sentence.
        lost: whether all of its three workers died; else it raised an error.
    """

    index: int
    reason: str
    lost: bool = False


@dataclass(kw_only=True)
class Mapped:
    """Outcome of many tasks.

    Attributes:
        journal: the results; `journal.results()` yields them in the order of the tasks.
        failures: tasks without a result, in order.
        stopped_by: the signal that interrupted the run before its end; None if none did.
    """

    journal: Journal
    failures: list[Failure]
    stopped_by: int | None = None

    @property
    def interrupted(self) -> bool:
        """Whether the run was interrupted before its end."""
        return self.stopped_by is not None

    @property
    def failed(self) -> int:
        """Number of tasks without a result."""
        return len(self.failures)

    @property
    def lost(self) -> int:
        """Number of tasks that were lost with their workers."""
        return sum(failure.lost for failure in self.failures)


def map_tasks(
    function: Function,
    tasks: Sequence[Any],
    *,
    shared: Any = None,
    on: Workers | None = None,
    journal: Journal | None = None,
    progress: Callable[[int], None] | None = None,
) -> Mapped:
    """Call a function for each of many tasks, in chunks. Ctrl-C ends it, and keeps results.

    A worker that dies is replaced, and the tasks that it may have had are repeated at the end, one
    at a time, for three attempts at most: a task that ends its process costs no other its result.

    Args:
        function: `function(shared, task)`, which workers import by its name; returns plain values.
        tasks: accessed lazily; need not be in memory.
        shared: sent to each worker once.
        on: where the tasks run; None for one process per core.
        journal: journal for the results; tasks with results in it are skipped. None for a temporary
            one.
        progress: called with the number of finished tasks.

    Raises:
        InputError: no worker can do the work; says what would help.
        OutputError: results cannot be written.
    """
    if journal is None:
        journal = Journal(None, {}, len(tasks))
        journal.begin()
    run = _Run(tasks, on or Workers(), journal, progress)
    todo = len(tasks) - journal.count
    if todo == 0:
        return run.mapped
    pool: Pool | None = None
    try:
        pool = _open(function, shared, run.workers, todo)
        run.follow(pool)
    except KeyboardInterrupt as stop:
        run.mapped.stopped_by = signal_of(stop)
    finally:
        if pool is not None:
            pool.close()
        run.mapped.failures.sort(key=lambda failure: failure.index)
    return run.mapped


def _open(function: Function, shared: Any, workers: Workers, todo: int) -> Pool:
    if workers.engine == "ray":
        from mjgranular.pool.on_ray import RayPool

        return RayPool(function, shared, workers)
    count = min(workers.count or os.cpu_count() or 1, todo)
    return ThisProcess(function, shared) if count == 1 else Processes(function, shared, count)


class _Batch(NamedTuple):
    """A chunk being processed.

    Attributes:
        indices: numbers of its tasks.
        lost: workers that each of them may have killed.
    """

    indices: Sequence[int]
    lost: int = 0


class _Run:
    """Submits chunks, and collects their results."""

    def __init__(
        self,
        tasks: Sequence[Any],
        workers: Workers,
        journal: Journal,
        progress: Callable[[int], None] | None,
    ) -> None:
        self.workers = workers
        self.mapped = Mapped(journal=journal, failures=[])
        self._tasks = tasks
        self._journal = journal
        self._progress = progress
        self._missing = journal.missing()
        self._left = len(tasks) - journal.count  # not submitted yet
        self._suspects: deque[_Batch] = deque()  # tasks whose worker has died, one by one
        self._seconds: float | None = None  # of a task, the shortest so far

    def follow(self, pool: Pool) -> None:
        """Loop until every task has an answer or is lost."""
        under_way: dict[Future, _Batch] = {}
        while True:
            while len(under_way) < pool.slots and (batch := self._next(pool.count)) is not None:
                under_way[self._submit(pool, batch)] = batch
            if not under_way and self._suspects:  # alone, so that no other task is lost with it
                batch = self._suspects.popleft()
                under_way[self._submit(pool, batch)] = batch
            if not under_way:
                return
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                batch = under_way.pop(future)
                try:
                    self._keep(pool.result(future))
                except WorkerLostError as lost:
                    self._lose(batch, lost)
                if self._progress is not None:
                    self._progress(self._journal.count + self.mapped.failed)

    def _submit(self, pool: Pool, batch: _Batch) -> Future:
        return pool.submit(tuple((index, self._tasks[index]) for index in batch.indices))

    def _next(self, count: int) -> _Batch | None:
        indices = list(islice(self._missing, self._size(count)))
        self._left -= len(indices)
        return _Batch(indices) if indices else None

    def _size(self, count: int) -> int:
        if self.workers.chunk is not None:
            return self.workers.chunk
        if self._seconds is None:  # their duration is still unknown
            return 1
        by_time = int(min(_SECONDS / max(self._seconds, 1e-9), _LARGEST))
        return max(1, min(by_time, math.ceil(self._left / (_ROUNDS * count))))

    def _keep(self, done: Done) -> None:
        each = done.seconds / len(done.answers)
        self._seconds = each if self._seconds is None else min(self._seconds, each)
        self._journal.keep([(one.number, one.result) for one in done.answers if one.error is None])
        for one in done.answers:
            if one.error is not None:
                self.mapped.failures.append(Failure(one.number, one.error))

    def _lose(self, batch: _Batch, error: WorkerLostError) -> None:
        lost = batch.lost + error.begun
        for index in batch.indices:
            if lost < TRIES:
                self._suspects.append(_Batch([index], lost))
            else:
                self.mapped.failures.append(
                    Failure(index, f"{error}; tried {TRIES} times", lost=True)
                )
