"""A run as the fit sees it: measured data row by row, and the prediction for a material."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from mjgranular.calibrate.material import Material
from mjgranular.calibrate.motion import Errors, Motion, compare, rms
from mjgranular.calibrate.runs import MeasuredRun, Run
from mjgranular.calibrate.simulate import MOVES, Simulator, place, simulator_of, way_of
from mjgranular.errors import InputError, UnstableError, shown

_POINTS = 41  # points at which the force of a smooth path is computed; linear in between
_PUSH_SPEED = 0.01  # default speed of a push [m/s]: slow
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
    """A run with its data read and checked: values of `series` at `places` of an `axis`."""

    carries = 2  # largest number of constants that such a curve can determine; chosen

    run: Any  # a `Run` or `MeasuredRun`
    series: tuple[Series, ...]
    axis: str
    places: np.ndarray
    speeds: tuple[float, ...]  # of the run [m/s]
    shift: float | None = None  # time of the touch [s], if it is fitted with the constants
    shift_range: tuple[float, float] = (0.0, 0.0)

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
        found = run.motion.rate if run.kind == "walk" else run.motion.speed
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
            raise InputError(f"{where}: a {run.kind} needs 2 or more rows in the sand, got {count}")
        rows = {name: values[inside] for name, values in measured.items()}
        if rows["force"].mean() <= 0:
            raise InputError(
                f"{where}: the mean force must be positive, that of the sand against the motion, "
                f"got {rows['force'].mean():.3g} N"
            )
        self.places = rows[self.axis]
        self.series = _series({name: rows.get(name) for name in names})
        ends = float(self.places.min()), float(self.places.max())
        self._speed = run.speed or _PUSH_SPEED
        self.speeds = ends if self.axis == "speed" else (self._speed,)
        few = self.axis == "speed" or len(self.places) <= _POINTS
        places = np.unique(self.places) if few else np.linspace(*ends, _POINTS)
        self._simulated = self._run_at(places)
        self._simulator = simulator_of(self._simulated, "place")

    def _run_at(self, places: np.ndarray) -> MeasuredRun:
        """Return the run with rows at these places, and forces that are not used."""
        run, none = self.run, np.zeros(len(places))
        motion = Motion(depth=places, force=none)
        if self.axis == "speed":
            motion = Motion(depth=none + run.depth, speed=places, force=none)
        angle = float(np.degrees(run.angle))
        body = run.body.projectile
        return MeasuredRun(run.name, run.kind, body, motion, speed=self._speed, angle=angle)

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


_FAR = 10.0  # residual of a run that diverged: ten times what was measured
_FINE = 1e-3  # relative step of a difference; chosen: the error of central ones is its square
_KEPT = 64  # outcomes that are kept


class Problem:
    """Unknown constants and touches, and residuals of the runs.

    The unknowns are the free constants, then the touch time of each drop whose record does not have
    it.
    """

    def __init__(
        self,
        trials: Sequence[Trial],
        material: Material,
        free: Sequence[str],
        progress: Callable[[int, str], None] | None = None,
    ) -> None:
        self.trials, self.material, self.free = tuple(trials), material, tuple(free)
        self.shifted = [k for k, trial in enumerate(trials) if trial.shift is not None]
        bounds = [material.bounds(name) for name in free]
        bounds += [trials[k].shift_range for k in self.shifted]
        self.low, self.high = (np.array(ends, float) for ends in zip(*bounds, strict=True))
        self.count = len(self.free)
        self.range = self.high - self.low  # may be infinite
        self.evaluations = 0
        self._progress = progress
        self._outcomes: dict[tuple[float, ...], list[Motion | None]] = {}

    def sizes(self, constants: np.ndarray) -> np.ndarray:
        """Return the size of each unknown: that of `constants`, and the range of each touch."""
        return np.concatenate([constants[: self.count], self.range[self.count :]])

    def start(self) -> np.ndarray:
        """Return the initial unknowns."""
        constants = [self.material.value(name) for name in self.free]
        shifts = [self.trials[k].shift for k in self.shifted]
        return np.array([*constants, *shifts], float)

    def material_at(self, x: np.ndarray) -> Material:
        """Return the material with those constants."""
        values = {name: float(value) for name, value in zip(self.free, x, strict=False)}
        return self.material.changed(values)

    def shift_of(self, x: np.ndarray, trial: int) -> float | None:
        """Return the touch of a run."""
        if trial not in self.shifted:
            return None
        return float(x[self.count + self.shifted.index(trial)])

    def outcomes(self, x: np.ndarray) -> list[Motion | None]:
        """Return the outcome of each run; None for one that diverged."""
        key = tuple(x[: self.count])
        if key not in self._outcomes:
            material = self.material_at(x)
            found = []
            for trial in self.trials:
                try:
                    found.append(trial.simulate(material))
                except UnstableError:
                    found.append(None)
                self.evaluations += 1
                if self._progress is not None:
                    self._progress(self.evaluations, "fitting")
            if len(self._outcomes) >= _KEPT:
                self._outcomes.pop(next(iter(self._outcomes)))
            self._outcomes[key] = found
        return self._outcomes[key]

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Return the residuals of all runs, one after the other."""
        parts = []
        for k, outcome in enumerate(self.outcomes(x)):
            trial = self.trials[k]
            if outcome is None:
                parts.append(np.full(trial.rows, _FAR / np.sqrt(trial.rows)))
            else:
                parts.append(trial.residual(outcome, self.shift_of(x, k)))
        return np.concatenate(parts)

    def blocks(self) -> list[slice]:
        """Return the rows of each series of each run among the residuals."""
        return _slices([len(series.values) for trial in self.trials for series in trial.series])

    def runs(self) -> list[slice]:
        """Return the rows of each run among the residuals."""
        return _slices([trial.rows for trial in self.trials])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals, central differences if the bounds allow."""
        columns = []
        for k in range(len(x)):
            if k < self.count:
                step = _FINE * max(abs(x[k]), 1e-3 * abs(self.start()[k]))
            else:
                step = _FINE * self.range[k]
            up, down = x.copy(), x.copy()
            up[k] = min(x[k] + step, self.high[k])
            down[k] = max(x[k] - step, self.low[k])
            columns.append((self.residual(up) - self.residual(down)) / (up[k] - down[k]))
        return np.column_stack(columns)


def _slices(lengths: Sequence[int]) -> list[slice]:
    """Return slices of these lengths, one after the other."""
    return [slice(a, b) for a, b in pairwise(np.cumsum([0, *lengths]).tolist())]
