"""A run as the fit sees it: measured data row by row, and the prediction for a material."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from mjgranular.calibrate.material import Material
from mjgranular.calibrate.motion import Errors, Motion, compare, rms
from mjgranular.calibrate.runs import Run
from mjgranular.calibrate.simulate import MOVES, Simulator, place, simulator_of, way_of
from mjgranular.errors import InputError, shown

_POINTS = 41  # points at which the force of a smooth path is computed; linear in between
_DEEPEST = 20.0  # depth of a push, at most, in largest extents of the body; chosen, wide

_FORCES = ("force", "side", "lift")
_SERIES = {
    "intrude": ("depth", ("force",)),
    "drag": ("speed", ("force", "lift")),
    "turn": ("angle", ("force", "lift")),
    "roll": ("spin", ("force", "side", "lift")),
    "sink": ("spin", ("force", "side", "depth")),
    "walk": ("rate", ("speed",)),
}
"""Axis of each kind of run, and the quantities that are fitted."""


@dataclass(frozen=True)
class Series:
    """Measurements of a quantity of `Motion`; errors are in parts of `scale`, the largest value."""

    name: str
    values: np.ndarray
    scale: float


class Trial(ABC):
    """A run with its data read and checked: values of `series` at `places` of an `axis`."""

    carries = 2  # largest number of constants that such a curve can determine; chosen

    run: Run
    series: tuple[Series, ...]
    axis: str
    places: np.ndarray
    speeds: tuple[float, ...]  # of the run [m/s]
    shift: float | None = None  # time of the touch [s], if it is fitted with the constants
    shift_range: tuple[float, float] = (0.0, 0.0)

    @property
    def rows(self) -> int:
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


class RowsTrial(Trial):
    """A run whose rows are compared one by one."""

    def __init__(self, run: Run) -> None:
        self.run, motion = run, run.motion
        self.axis, names = _SERIES[run.kind]
        self.places = getattr(motion, self.axis)
        self.series = _series({name: getattr(motion, name) for name in names})
        self._simulators: dict[str, Simulator] = {}
        found = motion.rate if run.kind == "walk" else motion.speed
        if run.kind == "turn":
            self.speeds = (abs(run.speed) * run.width,)
        elif found is None:
            self.speeds = (run.speed,)
        else:
            self.speeds = (float(found.min()), float(found.max()))

    def simulate(self, material: Material) -> Motion:
        way = way_of(self.run, material.law)
        if way not in self._simulators:
            self._simulators[way] = simulator_of(self.run, way)
        self._simulators[way].use(material)
        return MOVES[way](self.run, self._simulators[way])

    def errors(self, outcome: Motion, shift: float | None) -> Errors:
        return compare(self.run.motion, outcome)


class PushTrial(RowsTrial):
    """A shape pushed straight down, or dragged along: force against depth or speed."""

    def __init__(self, run: Run) -> None:
        inside = _rows_of_push(run)
        names = ("depth", "force", "lift", "speed") if run.kind == "drag" else ("depth", "force")
        rows = {name: getattr(run.motion, name) for name in names}
        motion = Motion(**{k: None if v is None else v[inside] for k, v in rows.items()})
        super().__init__(replace(run, motion=motion))
        places = np.unique(self.places)
        if self.axis == "depth" and len(self.places) > _POINTS:
            places = np.linspace(places[0], places[-1], _POINTS)
        none = np.zeros(len(places))  # forces that are not used
        motion = Motion(depth=places, force=none)
        if self.axis == "speed":
            motion = Motion(depth=none + run.depth, speed=places, force=none)
        self._simulated = replace(run, motion=motion)
        self._simulator = simulator_of(self._simulated, "place")

    def simulate(self, material: Material) -> Motion:
        self._simulator.use(material)
        found = place(self._simulated, self._simulator)
        at = getattr(found, self.axis)
        columns = {s.name: np.interp(self.places, at, getattr(found, s.name)) for s in self.series}
        return Motion(depth=self.places, **columns)

    def errors(self, outcome: Motion, shift: float | None) -> Errors:
        found = self.predicted(outcome, shift)
        off = [f - s.values for f, s in zip(found, self.series, strict=True)]
        force = self.series[0]
        return Errors(
            trajectory=rms(np.linalg.norm(off, axis=0)) / force.scale,
            force=float(found[0].mean() / force.values.mean() - 1),
        )


def _rows_of_push(run: Run) -> np.ndarray:
    """Return which rows of a push or drag are in the sand, after checks of units and signs."""
    where, size = f"run {shown(run.name)}", run.body.reach
    along = getattr(run.motion, _SERIES[run.kind][0])
    deepest, inside = run.depth or run.motion.depth.max(), along > 0
    if deepest > _DEEPEST * size:
        raise InputError(
            f"{where}: a depth of {deepest:.4g} m for a body of {size:.3g} m is implausible: "
            "the key depth is in m; name the unit of a column, such as 'depth [mm]'"
        )
    if run.kind == "drag" and not inside.all():
        raise InputError(f"{where}: speeds of a drag must be positive, got {along.min():g} m/s")
    if inside.sum() < 2:
        count = inside.sum() or "no contact"
        what = "depths" if run.kind == "intrude" else "speeds"
        raise InputError(
            f"{where}: 2 or more rows must be in the sand, got {count}; {what} there are positive"
        )
    mean = run.motion.force[inside].mean()
    if mean <= 0:
        raise InputError(
            f"{where}: the mean force against the motion must be positive, got {mean:.3g} N"
        )
    return inside


def _series(columns: dict[str, np.ndarray | None]) -> tuple[Series, ...]:
    """Return series of the measured columns; forces in several directions have one scale."""
    given = {name: values for name, values in columns.items() if values is not None}
    forces = [values for name, values in given.items() if name in _FORCES]
    scale = float(np.linalg.norm(forces, axis=0).max()) if forces else 0.0
    return tuple(
        Series(name, values, scale if name in _FORCES else float(np.abs(values).max()))
        for name, values in given.items()
    )
