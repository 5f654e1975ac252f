"""A run as the fit sees it: measured data, and the prediction for a material."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from mjgranular.calibrate.errors import Errors
from mjgranular.calibrate.material import Material
from mjgranular.calibrate.motion import Motion


@dataclass(frozen=True)
class Series:
    """Measurements of one quantity.

    Attributes:
        name: name of the quantity, an attribute of `Motion`.
        values: shape (n,).
        scale: divisor of errors: mostly the largest absolute value.
    """

    name: str
    values: np.ndarray
    scale: float


class Trial(ABC):
    """A run with its data read and checked.

    Attributes:
        carries: largest number of constants that such a curve can determine; chosen.
        run: a `Run` or `MeasuredRun`.
        series: measured series.
        axis: name of the independent variable.
        places: values on that axis, shape (n,).
        shift: time of the touch [s], if it is fitted with the constants; else None.
        shift_range: lower and upper bound of `shift`.
    """

    carries: ClassVar[int] = 2

    run: Any
    series: tuple[Series, ...]
    axis: str
    places: np.ndarray
    shift: float | None = None
    shift_range: tuple[float, float] = (0.0, 0.0)

    @property
    @abstractmethod
    def speeds(self) -> tuple[float, ...]:
        """Speeds of the run [m/s]."""

    @property
    def rows(self) -> int:
        """Number of measured values."""
        return sum(len(series.values) for series in self.series)

    @abstractmethod
    def simulate(self, material: Material) -> Motion:
        """Simulate the run with a material."""

    @abstractmethod
    def errors(self, outcome: Motion, shift: float | None) -> Errors:
        """Summarize the errors of a simulated run."""

    def predicted(self, outcome: Motion, shift: float | None) -> list[np.ndarray]:
        """Return the series as they would have been measured."""
        return [getattr(outcome, series.name) for series in self.series]

    def since(self, shift: float | None) -> np.ndarray:
        """Return the places of a curve: times count from the touch."""
        return self.places

    def residual(self, outcome: Motion, shift: float | None) -> np.ndarray:
        """Return prediction minus measurement, in parts of each scale.

        Divided by the root of the number of rows: every series has the same weight at any frame
        rate.
        """
        parts = [
            (found - series.values) / (series.scale * np.sqrt(len(series.values)))
            for series, found in zip(self.series, self.predicted(outcome, shift), strict=True)
        ]
        return np.concatenate(parts)
