"""Many drops that differ in one thing, spread over the processor's cores."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import threading
import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from typing import Any, Literal, get_args

import numpy as np

from mjgranular.errors import GranularError, GranularWarning, InputError, warn_user
from mjgranular.experiment.fall import run_impact
from mjgranular.experiment.impact import Impact
from mjgranular.experiment.trajectory import degrees
from mjgranular.signals import signal_of

Over = Literal["speed", "angle"]


@dataclass(frozen=True)
class Sweep:
    """Drops over a range of speeds or angles.

    Attributes:
        over: what differs.
        first: its first value [m/s] or [rad].
        last: its last value.
        points: how many values, evenly spaced, both ends included.
        impact: what is common to all drops.
    """

    over: Over = "speed"
    first: float = 1.0
    last: float = 10.0
    points: int = 19
    impact: Impact = field(default_factory=Impact)

    def __post_init__(self) -> None:
        if self.over not in get_args(Over):
            raise InputError(f"a sweep is over {' or '.join(get_args(Over))}, not {self.over!r}")
        if self.points < 2:
            raise InputError(f"a sweep needs at least 2 points, not {self.points}")
        if not (math.isfinite(self.first) and math.isfinite(self.last)):
            raise InputError(f"a sweep's range must be finite, not {self.first} to {self.last}")
        if self.first == self.last:
            raise InputError(f"a sweep's range is empty: from {self.first} to {self.last}")
        self.impacts()  # each of them checks itself

    def impacts(self) -> list[Impact]:
        """The drops, in order."""
        values = np.linspace(self.first, self.last, self.points)
        return [replace(self.impact, **{self.over: float(value)}) for value in values]


@dataclass(frozen=True)
class SweepResult:
    """Finished part of a sweep.

    Attributes:
        sweep: what was asked for.
        rows: summaries of the finished drops, in the order of the sweep.
        failures: for drops that could not be finished, value and reason.
        interrupted: whether it was broken off before its end.
        stopped_by: the signal that did so; None if none did.
    """

    sweep: Sweep
    rows: list[dict[str, Any]]
    failures: list[tuple[float, str]]
    interrupted: bool
    stopped_by: int | None = None


def run_sweep(
    sweep: Sweep,
    *,
    workers: int | None = None,
    progress: Callable[[int], None] | None = None,
    finished: Mapping[int, dict[str, Any]] | None = None,
    keep: Callable[[int, dict[str, Any]], None] | None = None,
) -> SweepResult:
    """Runs the drops in processes of their own, which end with this one however it ends.

    An interruption (Ctrl-C) ends the sweep early and keeps what is finished.

    Args:
        sweep: the drops.
        workers: number of processes; None for one a core. 1 runs them in this process.
        progress: called with the number of drops done.
        finished: summaries of drops that need not be run again, by their number in the sweep.
        keep: called with number and summary of each drop as soon as it is done.

    Raises:
        InputError: fewer than one worker.
    """
    if workers is not None and workers < 1:
        raise InputError(f"a sweep needs at least 1 worker, not {workers}")
    impacts = sweep.impacts()
    rows: dict[int, dict[str, Any]] = dict(finished or {})
    todo = {index: impact for index, impact in enumerate(impacts) if index not in rows}
    count = min(workers or os.cpu_count() or 1, len(todo))
    failures: list[tuple[float, str]] = []
    interrupted, stopped_by = False, None

    def finish(index: int, outcome: dict[str, Any] | str) -> None:
        if isinstance(outcome, str):
            value = getattr(impacts[index], sweep.over)
            failures.append((degrees(value) if sweep.over == "angle" else value, outcome))
        else:
            rows[index] = outcome
            if keep is not None:
                keep(index, outcome)
        if progress is not None:
            progress(len(rows) + len(failures))

    try:
        if count <= 1:
            for index, impact in todo.items():
                finish(index, _drop(impact))
        else:
            _in_processes(todo, count, finish)
    except KeyboardInterrupt as stop:
        interrupted, stopped_by = True, signal_of(stop)
    except BrokenProcessPool:
        warn_user("a process of the sweep was ended from outside, perhaps for lack of memory")
        interrupted = True
    ordered = [rows[index] for index in sorted(rows)]
    return SweepResult(sweep, ordered, failures, interrupted, stopped_by)


def _in_processes(
    impacts: Mapping[int, Impact],
    count: int,
    finish: Callable[[int, dict[str, Any] | str], None],
) -> None:
    # Started anew rather than forked: MuJoCo and numba may hold threads and locks.
    context = multiprocessing.get_context("spawn")
    until, ours = context.Pipe(duplex=False)  # closed by us or, if we are killed, by the system
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_begin, initargs=(until,))
    try:
        futures: dict[Future[dict[str, Any] | str], int] = {
            pool.submit(_drop, impact): index for index, impact in impacts.items()
        }
        for future in as_completed(futures):
            finish(futures[future], future.result())
        pool.shutdown()
    finally:
        ours.close()  # drops that nobody waits for any more are not finished
        pool.shutdown(wait=True, cancel_futures=True)
        until.close()


def _begin(until: Connection) -> None:
    """Has a worker end when its parent does, and leaves Ctrl-C to that, which keeps the rows."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end() -> None:
        with suppress(EOFError, OSError):
            until.recv_bytes()  # nothing is ever sent
        os._exit(1)

    threading.Thread(target=end, daemon=True).start()


def _drop(impact: Impact) -> dict[str, Any] | str:
    """The summary of one drop, or why there is none."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GranularWarning)  # the command line warns once for all
            return run_impact(impact).summary()
    except GranularError as error:
        return str(error)
