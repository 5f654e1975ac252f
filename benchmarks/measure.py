"""Measurement of a cost: cases of a group take turns, and each turn gives a ratio.

The speed of a shared machine drifts, which slows all cases of a turn equally: so the ratio of each
turn counts, and its median is reported with its quartiles.
"""

from __future__ import annotations

import platform
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Case:
    """A case whose cost is measured.

    Attributes:
        name: name in tables.
        begin: resets it to its start; not timed.
        run: does its work; timed.
        count: number of steps, or of other units of cost, in one run.
        facts: reported with the cost (number of elements, ...).
    """

    name: str
    begin: Callable[[], object]
    run: Callable[[], object]
    count: int
    facts: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Group:
    """Cases that are measured in turns; the first is the reference.

    Attributes:
        title: title in tables.
        note: what it shows, in one or two sentences.
        unit: unit of the costs, one of `UNITS`.
        prepare: makes the cases; called only when they are measured.
    """

    title: str
    note: str
    prepare: Callable[[], Sequence[Case]]
    unit: str = "us/step"


UNITS = {"us/step": 1e6, "ms": 1e3}
"""Units of cost in one second."""


@dataclass(frozen=True)
class Effort:
    """Length of a measurement.

    Attributes:
        turns: number of turns, after one that is not counted.
        seconds: least time of each case in a turn [s].
    """

    turns: int
    seconds: float


FULL = Effort(turns=9, seconds=0.2)
QUICK = Effort(turns=2, seconds=0.0)


@dataclass(frozen=True)
class Figure:
    """The cost of a case: medians over the turns, with quartiles.

    Attributes:
        cost: cost in the unit of its group.
        cost_low: lower quartile.
        cost_high: upper quartile.
        ratio: ratio to the first case of the group, turn by turn.
        ratio_low: lower quartile.
        ratio_high: upper quartile.
        facts: facts of the case.
    """

    cost: float
    cost_low: float
    cost_high: float
    ratio: float
    ratio_low: float
    ratio_high: float
    facts: dict[str, Any]

    def plain(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)


def measure(
    group: Group, effort: Effort, *, progress: Callable[[], object] = lambda: None
) -> dict[str, Figure]:
    """Measure a group.

    Args:
        group: the group.
        effort: length of the measurement.
        progress: called after each turn.

    Returns:
        Figures by the names of the cases, in their order.
    """
    cases = group.prepare()
    repeats = {case.name: _repeats(case, effort.seconds) for case in cases}
    costs: dict[str, list[float]] = {case.name: [] for case in cases}
    for turn in range(effort.turns):
        for case in _rotated(cases, turn):
            spent = 0.0
            for _ in range(repeats[case.name]):
                spent += _once(case)
            costs[case.name].append(spent / (repeats[case.name] * case.count) * UNITS[group.unit])
        progress()
    first = costs[cases[0].name]
    figures = {}
    for case in cases:
        mine = costs[case.name]
        ratios = [cost / base for cost, base in zip(mine, first, strict=True)]
        figures[case.name] = Figure(*_spread(mine), *_spread(ratios), case.facts)
    return figures


def _once(case: Case) -> float:
    case.begin()
    begin = time.perf_counter()
    case.run()
    return time.perf_counter() - begin


def _repeats(case: Case, seconds: float) -> int:
    """Warm a case up, and return the number of runs that take `seconds`."""
    _once(case)
    return max(1, round(seconds / _once(case) + 0.5))


def _rotated(cases: Sequence[Case], turn: int) -> Iterator[Case]:
    """Yield the cases, rotated by the turn: no case always follows the same one."""
    start = turn % len(cases)
    yield from cases[start:]
    yield from cases[:start]


def _spread(values: Sequence[float]) -> tuple[float, float, float]:
    """Return median and quartiles."""
    low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
    return middle, low, high


def machine() -> str:
    """Return the name of the processor."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()
