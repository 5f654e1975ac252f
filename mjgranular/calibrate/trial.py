"""Runs as the fit sees them: measured data row by row, predictions, and all of their residuals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from mjgranular.calibrate.material import Material
from mjgranular.calibrate.motion import Errors, Motion, compare
from mjgranular.calibrate.runs import Run, motion_of
from mjgranular.calibrate.simulate import Simulator, simulate_with
from mjgranular.errors import UnstableError
from mjgranular.models import Projectile

_FAR = 10.0  # residual of a run that diverged: ten times what was measured
_FINE = 1e-3  # relative step of a difference; chosen: the error of central ones is its square

_POINTS = 41  # points at which the force of a smooth path is computed; linear in between
_DEEPEST = 20.0  # depth of a push, at most, in largest extents of the body; chosen, wide

_FAST = 0.1  # Froude number from which a push meets the inertia of sand that it drives; chosen

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


class Trial:
    """A run with its data read and checked: values of `series` at `places` of an `axis`.

    By default, its rows are simulated and compared one by one.
    """

    carries = 2  # largest number of constants that such a curve can determine; chosen

    run: Any  # a `Run`
    series: tuple[Series, ...]
    axis: str
    places: np.ndarray
    speeds: tuple[float, ...]  # of the run [m/s]
    shift: float | None = None  # time of the touch [s], if it is fitted with the constants
    shift_range: tuple[float, float] = (0.0, 0.0)

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

    @property
    def rows(self) -> int:
        return sum(len(series.values) for series in self.series)

    def simulate(self, material: Material) -> Motion:
        return simulate_with(self.run, material, self._simulators)

    def errors(self, predicted: list[np.ndarray], shift: float | None) -> Errors:
        """Summarize the errors of predicted series."""
        columns = zip((series.name for series in self.series), predicted, strict=True)
        return compare(self.run.motion, replace(self.run.motion, **dict(columns)))

    def predicted(self, outcome: Motion, shift: float | None) -> list[np.ndarray]:
        """Return the series as they would have been measured."""
        return [getattr(outcome, series.name) for series in self.series]

    def since(self, shift: float | None) -> np.ndarray:
        """Return the places of a curve: times count from the touch."""
        return self.places

    def residual(self, predicted: list[np.ndarray]) -> np.ndarray:
        """Return prediction minus measurement, in parts of each scale.

        Divided by the root of the number of rows: a series weighs the same at any frame rate.
        """
        pairs = zip(predicted, self.series, strict=True)
        return np.concatenate(
            [(values - s.values) / (s.scale * np.sqrt(len(s.values))) for values, s in pairs]
        )


class PushTrial(Trial):
    """A shape pushed straight down, or dragged along: force against depth or speed."""

    def __init__(self, run: Run) -> None:
        inside = _rows_of_push(run)
        names = ("depth", "force", "lift", "speed") if run.kind == "drag" else ("depth", "force")
        given = {k: v for k, v in vars(run.motion).items() if k in names and v is not None}
        super().__init__(replace(run, motion=Motion(**{k: v[inside] for k, v in given.items()})))
        places = np.unique(self.places)
        if self.axis == "depth" and len(self.places) > _POINTS:
            places = np.linspace(places[0], places[-1], _POINTS)
        columns = {self.axis: places, "force": np.zeros(len(places))}  # forces are not used
        self._simulated = replace(run, motion=motion_of(columns, run.depth))
        self._is_fast = run.kind == "intrude" and self._simulated.froude > _FAST

    def simulate(self, material: Material) -> Motion:
        way = "press" if self._is_fast and material.law.adds_mass else "place"
        found = simulate_with(self._simulated, material, self._simulators, way)
        at = getattr(found, self.axis)
        columns = {s.name: np.interp(self.places, at, getattr(found, s.name)) for s in self.series}
        return Motion(depth=self.places, **columns)

    def errors(self, predicted: list[np.ndarray], shift: float | None) -> Errors:
        force = float(predicted[0].mean() / self.series[0].values.mean() - 1)
        return replace(super().errors(predicted, shift), force=force, lift=None)


def _rows_of_push(run: Run) -> np.ndarray:
    """Return which rows of a push or drag are in the sand, after checks of units and signs."""
    force, along = run.motion.force, getattr(run.motion, _SERIES[run.kind][0])
    assert isinstance(run.body, Projectile)
    assert force is not None
    size, deepest, inside = run.body.reach, run.depth or run.motion.depth.max(), along > 0
    if deepest > _DEEPEST * size:
        raise run.error(
            f"a depth of {deepest:.4g} m for a body of {size:.3g} m is implausible: "
            "the key depth is in m; name the unit of a column, such as 'depth [mm]'"
        )
    if run.kind == "drag" and not inside.all():
        raise run.error(f"speeds of a drag must be positive, got {along.min():g} m/s")
    if inside.sum() < 2:
        count = inside.sum() or "no contact"
        what = "depths" if run.kind == "intrude" else "speeds"
        raise run.error(
            f"2 or more rows must be in the sand, got {count}; {what} there are positive"
        )
    mean = force[inside].mean()
    if mean <= 0:
        raise run.error(f"the mean force against the motion must be positive, got {mean:.3g} N")
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


class Problem:
    """Unknown constants and touches, and residuals of the runs.

    The unknowns are the free constants, then the touch time of each drop.
    """

    def __init__(
        self,
        trials: Sequence[Trial],
        material: Material,
        free: Sequence[str],
        progress: Callable[[int], None] | None = None,
    ) -> None:
        self.trials, self.material, self.free = tuple(trials), material, tuple(free)
        self.shifted = [trial for trial in trials if trial.shift is not None]
        bounds = [material.bounds(name) for name in free]
        bounds += [trial.shift_range for trial in self.shifted]
        self.low, self.high = (np.array(ends, float) for ends in zip(*bounds, strict=True))
        self.count = len(self.free)
        self.range = self.high - self.low  # may be infinite
        constants = [material.value(name) for name in free]
        self.start = np.array([*constants, *(trial.shift for trial in self.shifted)], float)
        # Rows of each series of each run, and of each run, among the residuals.
        self.blocks = _slices([len(series.values) for trial in trials for series in trial.series])
        self.runs = _slices([trial.rows for trial in trials])
        self.evaluations = 0
        self._progress = progress
        self._outcomes: dict[tuple[float, ...], list[Motion | None]] = {}

    def sizes(self, constants: np.ndarray) -> np.ndarray:
        """Return the size of each unknown: that of `constants`, and the range of each touch."""
        return np.concatenate([constants[: self.count], self.range[self.count :]])

    def material_at(self, x: np.ndarray) -> Material:
        values = {name: float(value) for name, value in zip(self.free, x, strict=False)}
        return self.material.changed(values)

    def shift_of(self, x: np.ndarray, trial: Trial) -> float | None:
        if trial not in self.shifted:
            return trial.shift  # held out
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
                    self._progress(self.evaluations)
            self._outcomes[key] = found
        return self._outcomes[key]

    def residual(self, x: np.ndarray) -> np.ndarray:
        parts = []
        for trial, outcome in zip(self.trials, self.outcomes(x), strict=True):
            if outcome is None:
                parts.append(np.full(trial.rows, _FAR / np.sqrt(trial.rows)))
            else:
                parts.append(trial.residual(trial.predicted(outcome, self.shift_of(x, trial))))
        return np.concatenate(parts)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals, central differences if the bounds allow."""
        columns = []
        for k in range(len(x)):
            if k < self.count:
                step = _FINE * max(abs(x[k]), 1e-3 * abs(self.start[k]))
            else:
                step = _FINE * self.range[k]
            up, down = x.copy(), x.copy()
            up[k] = min(x[k] + step, self.high[k])
            down[k] = max(x[k] - step, self.low[k])
            columns.append((self.residual(up) - self.residual(down)) / (up[k] - down[k]))
        return np.column_stack(columns)


def _slices(lengths: Sequence[int]) -> list[slice]:
    return [slice(a, b) for a, b in pairwise(np.cumsum([0, *lengths]).tolist())]
