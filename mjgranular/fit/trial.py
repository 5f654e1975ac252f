"""A run as the fit sees it: what was measured, and what a material would have made of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from mjgranular.fit.constants import Material
from mjgranular.fit.result import RunErrors
from mjgranular.fit.run import Run


@dataclass(frozen=True)
class Series:
    """What was measured of one quantity.

    Attributes:
        name: of the quantity.
        values: shape (n,).
        scale: by which errors are divided: its greatest size, mostly.
    """

    name: str
    values: np.ndarray
    scale: float


class Trial(ABC):
    """A run with its data read and checked.

    Attributes:
        run: the run.
        carries: number of constants that such a curve can say something on at most; chosen.
        series: what was measured.
        axis: name of what it was measured against.
        places: along that axis, shape (n,).
        shift: time of the touch [s], where it is fitted with the constants; None where it is not.
        shift_range: least and greatest of it.
    """

    carries: ClassVar[int] = 2

    run: Run
    series: tuple[Series, ...]
    axis: str
    places: np.ndarray
    shift: float | None = None
    shift_range: tuple[float, float] = (0.0, 0.0)

    @property
    def name(self) -> str:
        """Name of the run."""
        return self.run.name

    @property
    def speeds(self) -> tuple[float, ...]:
        """Speeds that it was made with [m/s]."""
        return (self.run.speed or 0.0,)

    @property
    def rows(self) -> int:
        """Number of numbers that were measured."""
        return sum(len(series.values) for series in self.series)

    @abstractmethod
    def simulate(self, material: Material) -> Any:
        """What a material makes of it, for `predicted`."""

    @abstractmethod
    def predicted(self, outcome: Any, shift: float | None) -> list[np.ndarray]:
        """Return the series as they would have been measured."""

    @abstractmethod
    def errors(self, outcome: Any, shift: float | None) -> RunErrors:
        """Errors of a prediction in a few numbers."""

    def residual(self, outcome: Any, shift: float | None) -> np.ndarray:
        """Prediction less measurement, in parts of each scale.

        Divided by the root of the number of rows: every series has the same weight, however often
        somebody's camera took a picture.
        """
        parts = [
            (found - series.values) / (series.scale * np.sqrt(len(series.values)))
            for series, found in zip(self.series, self.predicted(outcome, shift), strict=True)
        ]
        return np.concatenate(parts)


def rms(values: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
