"""A function over many independent tasks, robust to dying workers."""

import os
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from typing import Any

from mjgranular._util.signals import signal_of
from mjgranular.pool.journal import Journal
from mjgranular.pool.on_ray import RayPool
from mjgranular.pool.workers import Function, Processes, ThisProcess, WorkerLostError, Workers

Pool = ThisProcess | Processes | RayPool

TRIES = 3  # attempts at a task whose worker dies; after the first it runs alone


@dataclass(frozen=True)
class Failure:
    """A task that raised an error, or was lost, as all of its three workers died."""

    index: int
    reason: str
    lost: bool = False


@dataclass(kw_only=True)
class Mapped:
    """Outcome of many tasks: a journal of results, and failures in the order of the tasks."""

    journal: Journal
    failures: list[Failure]
    stopped_by: int | None = None  # signal that interrupted the run before its end

    @property
    def interrupted(self) -> bool:
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
    """Call a function for each of many tasks. Ctrl-C ends it, and keeps results.

    A worker that dies is replaced, and the tasks that it may have had are repeated at the end, one
    at a time, for three attempts at most: a task that ends its process costs no other its result.

    Args:
        function: `function(shared, task)`, which workers import by its name; returns plain values.
        tasks: accessed lazily; need not be in memory.
        shared: sent to each worker once.
        on: where the tasks run; None for one process per core.
        journal: tasks with results in it are skipped; None for a temporary one.
        progress: called with the number of finished tasks.

    Raises:
        InputError: no worker can do the work; says what would help.
        OutputError: results cannot be written.
    """
    if journal is None:
        journal = Journal(None, {}, len(tasks))
        journal.begin()
    mapped = Mapped(journal=journal, failures=[])
    todo = len(tasks) - journal.count
    if todo == 0:
        return mapped
    try:
        with closing(_open(function, shared, on or Workers(), todo)) as pool:
            _follow(pool, tasks, mapped, progress)
    except KeyboardInterrupt as stop:
        mapped.stopped_by = signal_of(stop)
        journal.recount()
    finally:
        mapped.failures.sort(key=lambda failure: failure.index)
    return mapped


def _open(function: Function, shared: Any, workers: Workers, todo: int) -> Pool:
    if workers.engine == "ray":
        return RayPool(function, shared, workers)
    count = min(workers.count or os.cpu_count() or 1, todo)
    return ThisProcess(function, shared) if count == 1 else Processes(function, shared, count)


def _follow(
    pool: Pool, tasks: Sequence[Any], mapped: Mapped, progress: Callable[[int], None] | None
) -> None:
    """Submit tasks and collect their results until each has an answer or is lost."""
    journal = mapped.journal
    missing = (index for index in range(len(journal)) if index not in journal)
    under_way: dict[Future, int] = {}
    suspects: deque[int] = deque()  # tasks whose worker has died
    lost: Counter[int] = Counter()  # workers that each of these may have killed
    while True:
        for index in islice(missing, pool.slots - len(under_way)):
            under_way[pool.submit(tasks[index])] = index
        if not under_way:
            if not suspects:
                return
            index = suspects.popleft()  # alone, so that no other task is lost with it
            under_way[pool.submit(tasks[index])] = index
        for future in wait(under_way, return_when=FIRST_COMPLETED).done:
            index = under_way.pop(future)
            try:
                answer = pool.result(future)
            except WorkerLostError as error:
                lost[index] += 1
                if lost[index] < TRIES:
                    suspects.append(index)
                else:
                    reason = f"{error}; tried {TRIES} times"
                    mapped.failures.append(Failure(index, reason, lost=True))
                continue
            if answer.error is None:
                journal.keep(index, answer.result)
            else:
                mapped.failures.append(Failure(index, answer.error))
            if progress is not None:
                progress(journal.count + mapped.failed)
