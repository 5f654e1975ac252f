"""A fit: constants of a law from measured runs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular._util.checks import check_kind, check_name, require
from mjgranular.calibrate import intervals
from mjgranular.calibrate.drops import DropTrial, ModelTrial
from mjgranular.calibrate.intervals import COLLINEAR, WIDE, NullDirection
from mjgranular.calibrate.material import Material
from mjgranular.calibrate.motion import Errors
from mjgranular.calibrate.runs import Run
from mjgranular.calibrate.trial import Problem, PushTrial, Trial
from mjgranular.errors import InputError, RangeWarning, UnstableError, shown, warn_user
from mjgranular.law import Law
from mjgranular.medium import Medium, get_medium
from mjgranular.models import Projectile

_SCAN = tuple(10.0**k for k in range(-3, 4))  # starts that are tried if none is given
_MOST_ROUNDS = 40
_UNKNOWN = 10.0  # half width in parts of the value from which no interval is reported; chosen
_DENSITIES = (5.0, 25000.0)  # of bodies, from foam to osmium [kg/m^3]; chosen
_ON_BOUND = 1e-3  # parts of its size within which a constant counts as on a bound; chosen


@dataclass(frozen=True)
class Fit:
    """Runs, medium, law and free constants of a fit.

    Attributes:
        runs: the runs, with different names.
        medium: a medium, its name, or a YAML file. Its constants are the start of the fit.
        law: a law, or its name, optionally with parameters; None for the medium's default.
        free: names of the constants to fit.
        hold_out: names of runs that are predicted, not fitted.

    Raises:
        UnknownNameError: the law has no such free constant, or there is no such run to hold out.
        InputError: no run to fit, two of the same name, or a start that lies on a bound.
    """

    runs: tuple[Run, ...]
    medium: Medium | str | Path
    free: tuple[str, ...]
    law: str | Law | None = None
    hold_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if isinstance(self.runs, Run | str | Path) or isinstance(self.free, str):
            raise InputError(
                "runs and free are each several, [run, ...] and ['strength']; read_fit reads a file"
            )
        for run in self.runs:
            check_kind(run, Run, "a fit")
            if run.guided:
                raise run.error("a guided body cannot be fitted to")
        names = [run.name for run in self.runs]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two runs are called {shown(name)}: each needs its own name")
        for name in self.hold_out:
            check_name("run to hold out", name, names)
        if not set(names) - set(self.hold_out):
            raise InputError("there is no run to fit to: at least one must not be held out")
        self.material.check_free(self.free)

    @property
    def material(self) -> Material:
        return Material.of(get_medium(self.medium), self.law)


@dataclass(frozen=True)
class Curve:
    """A measured quantity and the prediction of the fitted law; arrays of shape (n,).

    Places on the axis are times since the touch [s], depths [m], speeds or angles; the quantity is
    a depth [m], speed, pitch [degrees] or force [N].
    """

    axis: str
    quantity: str
    places: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    held_out: bool


@dataclass(frozen=True)
class FitResult:
    """A finished fit.

    Attributes:
        start: law and medium before the fit.
        material: the `law` with the fitted constants, and the `medium` with a fitted density.
        free: names of the free constants.
        values: fitted values of the free constants.
        intervals: 95 % intervals; None where neither the data nor the law bound the constant.
        correlations: correlations of the estimates, by names.
        identifiable: whether the data determine the constant separately from the others.
        at_bound: names of the constants that ended on a bound of the law.
        valleys: null directions, in which constants trade off against each other.
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
            "runs": {name: asdict(errors) for name, errors in self.runs.items()},
            "held_out": {name: asdict(errors) for name, errors in self.held_out.items()},
            "constants": self.material.constants(),
        }


def run_fit(fit: Fit, *, progress: Callable[[int], None] | None = None) -> FitResult:
    """Fit constants to runs, and predict the runs held out.

    `progress` is called with the number of simulated runs.

    Raises:
        InputError: implausible data, or too few data for the free constants.
        UnstableError: a run diverges with the initial constants.
        MissingExtraError: SciPy is not installed.
    """
    check_kind(fit, Fit, "run_fit", "read_fit('runs.yaml', free=[...])")
    optimize = require("scipy.optimize", extra="fit", purpose="Fitting")
    _check_bodies(fit.runs)
    trials = {run.name: _trial(run) for run in fit.runs}
    fitted = [trial for name, trial in trials.items() if name not in fit.hold_out]
    _check_enough(fitted, fit.free)
    start = _with_starts(fit, fitted)
    problem = Problem(fitted, start, fit.free, progress)
    x = problem.start
    if any(outcome is None for outcome in problem.outcomes(x)):
        raise UnstableError(f"a run diverges with {start.law}: start from other constants")
    inner = 1e-6 * np.where(np.isfinite(problem.range), problem.range, 0.0)
    solution = optimize.least_squares(
        problem.residual,
        np.clip(x, problem.low + inner, problem.high - inner),  # a solver starts inside
        jac=problem.jacobian,
        bounds=(problem.low, problem.high),
        x_scale=problem.sizes(np.abs(x)),
        xtol=1e-6,
        ftol=1e-9,
        gtol=1e-9,
        max_nfev=_MOST_ROUNDS,
    )
    return _result(fit, start, problem, solution.x, trials)


def _trial(run: Run) -> Trial:
    if run.kind in ("drop", "model"):
        return DropTrial(run) if run.kind == "drop" else ModelTrial(run)
    of_rows = isinstance(run.body, Path) or (run.kind == "drag" and run.depth is None)
    return Trial(run) if of_rows else PushTrial(run)


def _check_bodies(runs: Sequence[Run]) -> None:
    for run in runs:
        if isinstance(run.body, Projectile):
            density, (low, high) = run.body.density, _DENSITIES
            if not low <= density <= high:
                warn_user(
                    f"run {shown(run.name)}: the {run.shape} has {density:.3g} kg/m^3: mass is in "
                    "kg, diameter and length are in m",
                    RangeWarning,
                )


def _check_enough(trials: Sequence[Trial], free: Sequence[str]) -> None:
    rows = sum(trial.rows for trial in trials)
    carried = sum(trial.carries + len(trial.series) - 1 for trial in trials)
    if len(free) > carried or len(free) >= rows:
        runs = "one run" if len(trials) == 1 else f"{len(trials)} runs"
        raise InputError(
            f"{len(free)} constants are free ({', '.join(free)}), more than {runs} with {rows} "
            f"numbers can carry, {min(carried, rows - 1)} at most: free fewer, or measure more"
        )


def _with_starts(fit: Fit, trials: Sequence[Trial]) -> Material:
    """Return the initial material; a default on a bound is replaced by the best power of ten."""
    material = fit.material
    for name in fit.free:
        if not material.has_start(name):
            costs = {}
            for value in _SCAN:
                probe = Problem(trials, material.changed({name: value}), (name,))
                cost = np.square(probe.residual(probe.start)).sum()
                costs[value] = np.inf if np.isnan(cost) else cost
            material = material.changed({name: min(costs, key=costs.__getitem__)})
    return material


def _result(
    fit: Fit, start: Material, problem: Problem, x: np.ndarray, trials: Mapping[str, Trial]
) -> FitResult:
    """Return the result at the solution `x`, with intervals and what the data determine."""
    count, names = problem.count, fit.free
    material = problem.material_at(x)
    residual, jacobian = problem.residual(x), problem.jacobian(x)
    sizes = problem.sizes(np.abs(problem.start))
    near = _ON_BOUND * sizes
    held = (x - problem.low < near) | (problem.high - x < near)
    moving = ~held | (np.arange(len(x)) < count)  # a touch on its bound cannot move
    jacobian[:, ~moving] = 0.0
    scale = np.where(np.abs(x) > near, np.abs(x), sizes)[:count]
    blocks, size = problem.blocks, problem.sizes(scale)[moving]
    half, correlation = intervals.spread_of(
        jacobian[:, moving], residual, blocks, problem.runs, size
    )
    information = intervals.information_of(jacobian, scale)
    relative = half[:count] / scale
    one_speed = intervals.trades_off(problem.trials, material, names)
    flat = (intervals.collinear(information) >= COLLINEAR) | one_speed
    good = ~flat & (relative <= WIDE)
    runs, held_out, curves = {}, {}, {}
    for name, trial in trials.items():
        fitted, shift = trial in problem.trials, problem.shift_of(x, trial)
        predicted = trial.predicted(trial.simulate(material), shift)
        (runs if fitted else held_out)[name] = trial.errors(predicted, shift)
        curves[name] = tuple(
            Curve(trial.axis, s.name, trial.since(shift), s.values, values, not fitted)
            for s, values in zip(trial.series, predicted, strict=True)
        )
    return FitResult(
        start=start,
        material=material,
        free=names,
        values={name: float(x[k]) for k, name in enumerate(names)},
        intervals={
            name: _interval(x[k], half[k], relative[k], problem.low[k], problem.high[k])
            for k, name in enumerate(names)
        },
        correlations={
            a: {b: float(correlation[i, j]) for j, b in enumerate(names) if i != j}
            for i, a in enumerate(names)
        },
        identifiable={name: bool(good[k]) for k, name in enumerate(names)},
        at_bound=tuple(name for k, name in enumerate(names) if held[k]),
        valleys=intervals.null_directions(information, names, one_speed) if flat.any() else (),
        runs=runs,
        held_out=held_out,
        curves=curves,
        residual=float(np.sqrt(np.square(residual).sum() / len(blocks))),
        evaluations=problem.evaluations,
    )


def _interval(
    value: float, half: float, relative: float, low: float, high: float
) -> tuple[float | None, float | None]:
    """Return the ends of an interval, within the law's bounds; None for no end."""
    half = half if relative < _UNKNOWN else np.inf
    below, above = (
        float(end) if np.isfinite(end) else None
        for end in (max(value - half, low), min(value + half, high))
    )
    return below, above
