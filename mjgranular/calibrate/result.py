"""Results of a fit, in plain numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from mjgranular.calibrate.material import Material
from mjgranular.calibrate.motion import Errors


@dataclass(frozen=True)
class Curve:
    """A measured quantity and the prediction of the fitted law.

    Attributes:
        axis: independent variable: time since the touch [s], depth [m] or speed [m/s].
        quantity: depth [m], pitch [degrees] or force [N].
        places: values on the axis, shape (n,).
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
    """A proposed test, and what it would add according to the fitted law.

    Attributes:
        what: describes the test.
        intervals: half widths of the resulting intervals, in parts of each value.
        identifiable: whether all constants would be identifiable.
    """

    what: str
    intervals: Mapping[str, float]
    identifiable: bool


@dataclass(frozen=True)
class NullDirection:
    """Constants that trade off against each other: along it curves hardly change.

    Attributes:
        change: relative changes of the constants along it; the largest is 1.
        effect: RMS difference of the curves at a change of 10 %, in parts of their largest values.
        one_speed: whether all runs have the same speed: then a narrow interval assumes an exact
            law, and does not hold at other speeds.
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
        values: fitted values of the free constants.
        intervals: 95 % intervals; None where the data do not constrain the constant, or the law has
            no bound.
        correlations: correlations of the estimates, by names.
        identifiable: whether the data determine the constant separately from the others.
        at_bound: names of the constants that ended on a bound of the law.
        valleys: null directions, in which constants trade off against each other.
        further: the most useful further tests, the best first; empty if all is identifiable.
        runs: errors of the fitted runs, by name.
        held_out: errors of the predicted runs, by name.
        curves: measured and predicted curves, by the names of runs.
        residual: RMS of all errors, in parts of the largest values.
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
    valleys: tuple[NullDirection, ...]
    further: tuple[FurtherTest, ...]
    runs: Mapping[str, Errors]
    held_out: Mapping[str, Errors]
    curves: Mapping[str, tuple[Curve, ...]] = field(repr=False)
    residual: float
    evaluations: int

    def summary(self) -> dict[str, Any]:
        """Return the result in plain numbers, SI units."""
        plain = ("values", "correlations", "identifiable", "residual", "evaluations")
        return {
            "law": self.material.law.name,
            "medium": self.material.medium.name,
            **{name: getattr(self, name) for name in plain},
            "intervals": {name: list(ends) for name, ends in self.intervals.items()},
            "at_bound": list(self.at_bound),
            "valleys": [asdict(direction) for direction in self.valleys],
            "further_tests": [asdict(test) for test in self.further],
            "runs": {name: asdict(errors) for name, errors in self.runs.items()},
            "held_out": {name: asdict(errors) for name, errors in self.held_out.items()},
            "constants": self.material.constants(),
        }
