"""Many drops that differ in one thing, spread over processes or a cluster."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from mjgranular._util.checks import check_count, check_kind, is_finite
from mjgranular._util.saved import number
from mjgranular.errors import InputError, OutputError, shown
from mjgranular.experiment.baggage import Baggage, pack, unpack
from mjgranular.experiment.fall import run_impact
from mjgranular.experiment.impact import Impact
from mjgranular.experiment.study import Study
from mjgranular.experiment.trajectory import degrees
from mjgranular.pool import Journal, Workers, map_tasks

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
        check_kind(self.impact, Impact, "a sweep")
        check_count("points", self.points)
        if self.points < 2:
            raise InputError(f"a sweep needs at least 2 points, not {self.points}")
        if not (is_finite(self.first) and is_finite(self.last)):
            raise InputError(
                f"a sweep's range must be finite, not {shown(self.first)} to {shown(self.last)}"
            )
        if self.first == self.last:
            raise InputError(f"a sweep's range is empty: from {self.first} to {self.last}")
        self.impacts()  # each of them checks itself

    def impacts(self) -> list[Impact]:
        """The drops, in order."""
        values = np.linspace(self.first, self.last, self.points)
        return [replace(self.impact, **{self.over: float(value)}) for value in values]

    def journal(self, folder: Path | None) -> Journal:
        """The summaries of its drops that a folder keeps; None for a file that is soon gone."""
        return Journal(folder, {"sweep": asdict(self)}, self.points, _is_summary)


@dataclass(frozen=True)
class SweepResult:
    """Finished part of a sweep.

    Attributes:
        sweep: what was asked for.
        rows: summaries of the finished drops, in the order of the sweep.
        failures: for drops that could not be finished, value and reason.
        interrupted: whether it was broken off before its end.
        stopped_by: the signal that did so; None if none did.
        lost: how many of the failures are drops whose workers died.
    """

    sweep: Sweep
    rows: list[dict[str, Any]]
    failures: list[tuple[float, str]]
    interrupted: bool
    stopped_by: int | None = None
    lost: int = 0


def run_sweep(
    sweep: Sweep,
    *,
    workers: Workers | int | None = None,
    progress: Callable[[int], None] | None = None,
    finished: Mapping[int, dict[str, Any]] | None = None,
    keep: Callable[[int, dict[str, Any]], None] | None = None,
    journal: Journal | None = None,
) -> SweepResult:
    """Runs the drops in processes of their own, which end with this one however it ends.

    An interruption (Ctrl-C) ends the sweep early and keeps what is finished.

    Args:
        sweep: the drops.
        workers: where they run, such as `pool.Workers("ray")`; or the number of processes, None
            for one a core. 1 runs them in this process.
        progress: called with the number of drops done.
        finished: summaries of drops that need not be run again, by their number in the sweep.
        keep: called with number and summary of each drop as soon as it is done.
        journal: where summaries are kept, and those that are there already; `sweep.journal`.

    Raises:
        InputError: fewer than one worker, or an engine that cannot be used.
    """
    check_kind(sweep, Sweep, "run_sweep")
    impacts = sweep.impacts()
    if journal is None:
        journal = sweep.journal(None)
        journal.begin()
        journal.keep([*(finished or {}).items()])
    values = [getattr(impact, sweep.over) for impact in impacts]
    found = map_tasks(
        _drop,
        impacts,
        shared=pack(Study(sweep.impact, {sweep.over: values})),
        on=Workers.of(workers),
        journal=journal,
        progress=progress,
        answered=keep,
    )
    failures = [
        (degrees(values[one.index]) if sweep.over == "angle" else values[one.index], one.reason)
        for one in found.failures
    ]
    return SweepResult(
        sweep, [*journal.results()], failures, found.interrupted, found.stopped_by, found.lost
    )


def _drop(baggage: Baggage, impact: Impact) -> dict[str, Any]:
    """The summary of one drop."""
    unpack(baggage, impact)
    return run_impact(impact).summary()


def _is_summary(row: Mapping[str, Any]) -> bool:
    names = ("speed", "angle_deg", "timestep", "depth", "stopping_time")
    try:
        numbers = [number(row, name, "") for name in names]
    except OutputError:
        return False
    return None not in numbers[:-1]
