"""A run as the fit sees it: measured data row by row, and the prediction for a material."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from mjgranular.calibrate.material import Material
from mjgranular.calibrate.motion import Errors, Motion, compare, rms
from mjgranular.calibrate.runs import MeasuredRun, Run
from mjgranular.calibrate.simulate import MOVES, place, simulator_of, way_of
from mjgranular.calibrate.simulator import Simulator
from mjgranular.errors import InputError, shown

_POINTS = 41  # points at which the force of a smooth path is computed; linear in between
_UNITS = (("mm", 1e-3), ("cm", 1e-2))
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


class RowsTrial(Trial):
    """A run whose rows are compared one by one."""

    def __init__(self, run: MeasuredRun) -> None:
        self.run = run
        self.axis, names = _SERIES[run.kind]
        self.places = getattr(run.motion, self.axis)
        self.series = _series({name: getattr(run.motion, name) for name in names})
        self._simulators: dict[str, Simulator] = {}

    @property
    def speeds(self) -> tuple[float, ...]:
        run = self.run
        assert isinstance(run, MeasuredRun)
        if run.kind == "turn":
            return (abs(run.speed) * run.width,)
        found = run.motion.rate if run.kind == "walk" else run.motion.speed
        return (run.speed,) if found is None else (float(found.min()), float(found.max()))

    def simulate(self, material: Material) -> Motion:
        assert isinstance(self.run, MeasuredRun)
        way = way_of(self.run, material.law)
        if way not in self._simulators:
            self._simulators[way] = simulator_of(self.run, way)
        self._simulators[way].use(material)
        return MOVES[way](self.run, self._simulators[way])

    def errors(self, outcome: Motion, shift: float | None) -> Errors:
        return compare(self.run.motion, outcome)


class PushTrial(Trial):
    """A body pushed straight down, or dragged along: force against depth or speed."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.axis, names = _SERIES[run.kind]
        where = f"run {shown(run.name)}"
        measured = run.measured()
        inside = measured["depth"] > 0 if run.kind == "intrude" else measured["speed"] > 0
        _check_depth(run.depth or measured["depth"].max(), run, where)
        if run.kind == "drag" and not inside.all():
            least = measured["speed"].min()
            raise InputError(f"{where}: speeds of a drag must be positive, got {least:g} m/s")
        if inside.sum() < 2:
            count = inside.sum() or "no contact"
            raise InputError(
                f"{where}: a {run.kind} needs at least 2 rows in the sand, got {count}"
            )
        rows = {name: values[inside] for name, values in measured.items()}
        if rows["force"].mean() <= 0:
            raise InputError(
                f"{where}: the mean force must be positive, that of the sand against the motion, "
                f"got {rows['force'].mean():.3g} N"
            )
        self.places = rows[self.axis]
        self.series = _series({name: rows.get(name) for name in names})
        self._simulated = self._run_at(self._points())
        self._simulator = simulator_of(self._simulated, "place")

    def _points(self) -> np.ndarray:
        """Return the places at which the force is computed."""
        if self.axis == "speed" or len(self.places) <= _POINTS:
            return np.unique(self.places)
        return np.linspace(self.places.min(), self.places.max(), _POINTS)

    def _run_at(self, places: np.ndarray) -> MeasuredRun:
        """Return the run with rows at these places, and forces that are not used."""
        run, none = self.run, np.zeros(len(places))
        motion = Motion(depth=places, force=none)
        if self.axis == "speed":
            motion = Motion(depth=none + run.depth, speed=places, force=none)
        angle = float(np.degrees(run.angle))
        body = run.body.projectile
        return MeasuredRun(run.name, run.kind, body, motion, speed=run.push_speed, angle=angle)

    @property
    def speeds(self) -> tuple[float, ...]:
        if self.axis == "depth":
            return (self.run.push_speed,)
        return float(self.places.min()), float(self.places.max())

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


def _series(columns: dict[str, np.ndarray | None]) -> tuple[Series, ...]:
    """Return series of the measured columns; forces in several directions have one scale."""
    given = {name: values for name, values in columns.items() if values is not None}
    forces = [values for name, values in given.items() if name in _FORCES]
    scale = float(np.linalg.norm(forces, axis=0).max()) if forces else 0.0
    return tuple(
        Series(name, values, scale if name in _FORCES else float(np.abs(values).max()))
        for name, values in given.items()
    )


def _check_depth(depth: float, run: Run, where: str) -> None:
    """Check that a depth is plausible in meters; guess the unit if not."""
    assert run.body is not None
    size = run.body.size
    if depth <= _DEEPEST * size:
        return
    what = f"{where}: a depth of {depth:.4g} m for a body of {size:.3g} m"
    for unit, factor in _UNITS:
        if depth * factor <= _DEEPEST * size:
            raise InputError(f"{what} looks like {unit}: name the column 'depth [{unit}]'")
    raise InputError(f"{what} is not plausible: check the units")
