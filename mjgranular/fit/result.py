"""What a fit has found, in plain numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from mjgranular.fit.constants import Material


@dataclass(frozen=True)
class RunErrors:
    """Errors of a prediction; depth and stopping time in parts of those measured, with their sign.

    Attributes:
        depth: of the final depth.
        stopping_time: of the time from the touch until the lowest point stops.
        trajectory: root of the mean square over all rows, in parts of the greatest depth or force.
        force: of the mean force.
        pitch: root of the mean square [degrees].
        measured_depth: [m]; the next ones likewise, times in seconds.
        predicted_depth: see above.
        measured_stopping_time: see above.
        predicted_stopping_time: see above.
    """

    trajectory: float
    depth: float | None = None
    stopping_time: float | None = None
    force: float | None = None
    pitch: float | None = None
    measured_depth: float | None = None
    predicted_depth: float | None = None
    measured_stopping_time: float | None = None
    predicted_stopping_time: float | None = None


@dataclass(frozen=True)
class Curve:
    """A measured quantity and what the fitted law makes of it.

    Attributes:
        axis: what it is measured against: time [s], depth [m] or speed [m/s].
        quantity: depth [m], pitch [degrees] or force [N].
        places: along the axis; times since the touch, shape (n,).
        measured: shape (n,).
        predicted: shape (n,).
        held_out: whether the run was held out.
    """

    axis: str
    quantity: str
    places: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    held_out: bool


@dataclass(frozen=True)
class FurtherTest:
    """A test that was not made, and what it would add, by the law as it was fitted.

    Attributes:
        what: in words.
        intervals: half widths of the intervals that it would leave, in parts of each value.
        identifiable: whether all constants could be told apart then.
    """

    what: str
    intervals: Mapping[str, float]
    identifiable: bool


@dataclass(frozen=True)
class Valley:
    """Constants that trade off against each other: along it the curves hardly change.

    Attributes:
        change: relative changes of the constants that go together; the greatest is 1.
        effect: root of the mean square by which the curves differ at a change of 10 %, in parts of
            their greatest values.
        one_speed: whether all runs are of one speed: then a narrow interval rests on the law's
            being right to the last, and say nothing on other speeds.
    """

    change: Mapping[str, float]
    effect: float
    one_speed: bool = False


@dataclass(frozen=True)
class FitResult:
    """A finished fit.

    Attributes:
        start: law and medium before the fit.
        material: law and medium with the fitted constants.
        free: names of the free constants.
        values: of the free constants.
        intervals: 95 % intervals; None where the data say nothing, or where the law has no bound.
        correlations: of the estimates, name by name.
        identifiable: whether the data tell the constant apart from the others.
        at_bound: names of the constants that ended on a bound of the law.
        valleys: what trades off against what.
        further: tests that would add most, the best first; none where all is identifiable.
        runs: errors of the runs that were fitted to, by name.
        held_out: those of the others, predicted.
        curves: what was measured and predicted, by the names of runs.
        residual: root of the mean square of all errors, in parts of the greatest values.
        evaluations: number of simulated runs.
    """

    start: Material
    material: Material
    free: tuple[str, ...]
    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float | None, float | None]]
    correlations: Mapping[str, Mapping[str, float]]
    identifiable: Mapping[str, bool]
    at_bound: tuple[str, ...]
    valleys: tuple[Valley, ...]
    further: tuple[FurtherTest, ...]
    runs: Mapping[str, RunErrors]
    held_out: Mapping[str, RunErrors]
    curves: Mapping[str, tuple[Curve, ...]] = field(repr=False)
    residual: float
    evaluations: int

    def summary(self) -> dict[str, Any]:
        """Return the result in plain numbers, SI units."""
        return {
            "law": self.material.law.name,
            "medium": self.material.medium.name,
            "values": dict(self.values),
            "intervals": {name: list(ends) for name, ends in self.intervals.items()},
            "correlations": {name: dict(row) for name, row in self.correlations.items()},
            "identifiable": dict(self.identifiable),
            "at_bound": list(self.at_bound),
            "valleys": [asdict(valley) for valley in self.valleys],
            "further_tests": [asdict(test) for test in self.further],
            "runs": {name: asdict(errors) for name, errors in self.runs.items()},
            "held_out": {name: asdict(errors) for name, errors in self.held_out.items()},
            "residual": self.residual,
            "evaluations": self.evaluations,
            "constants": self.material.constants(),
        }
