"""Confidence intervals, and which constants the data determine.

Errors along one trajectory are not independent: a misaligned camera stays misaligned, and a law
that is wrong is wrong for a while. For each series, the integrated autocorrelation time of its
residuals (the sum over lags up to the first pair that is not positive, C. J. Geyer, Statistical
Science 7 (1992)) is the number of rows that count as one. For few rows this estimate is too small:
if the correlation of neighbors is significant, that of a first-order process is used if it is
longer, its coefficient corrected for the bias of short series (M. G. Kendall, Biometrika 41
(1954)).

The covariance is the sandwich estimator, with the actual weight of each series, not the ideal one,
and with the error found in each row or one error for the whole series, whichever is larger. Few
effective rows make Student's t wide.

No statistic of one run can reveal an error that is constant over it, in the height of the surface
for example. With four runs or more, each is omitted in turn, to first order (the jackknife), and
the interval is at least the spread between runs.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from mjgranular._util.extras import require
from mjgranular.calibrate.material import Material
from mjgranular.calibrate.runs import Body, Run
from mjgranular.calibrate.trial import GRAVITY, DropTrial, Problem, PushTrial, Trial, find_arrest
from mjgranular.errors import GranularError

_FLAT = 1e-4  # singular value below which a direction is flat: no measurement is that good; chosen
_LEAST_FLAT = 0.05  # least part of a flat direction; chosen
_RUNS = 4  # least number of runs for the jackknife; chosen
SMALLEST = 1e-7  # singular value, in parts of the largest, below which nothing is reported; chosen


def correlation_time(errors: np.ndarray) -> float:
    """Return the number of rows that count as one: 1 for independent errors."""
    n = len(errors)
    power = float(errors @ errors)
    if n < 4 or power == 0:
        return 1.0
    size = 2 ** int(np.ceil(np.log2(2 * n)))
    spectrum = np.fft.rfft(errors, size)
    rho = np.fft.irfft(spectrum * spectrum.conj(), size)[:n] / power
    pairs = rho[1 : n - (n - 1) % 2].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0)
    total = pairs[: ends[0] if len(ends) else None].sum()
    if rho[1] <= 0:
        return 1.0
    first_order = 1.0
    if rho[1] > 2 / np.sqrt(n):
        next_alike = min(rho[1] + (1 + 4 * rho[1]) / n, 1 - 1 / n)
        first_order = (1 + next_alike) / (1 - next_alike)
    return float(np.clip(max(1 + 2 * total, first_order), 1.0, n))


def spread_of(
    jacobian: np.ndarray,
    residual: np.ndarray,
    blocks: list[slice],
    runs: list[slice],
    scale: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return half widths of the 95 % intervals of the unknowns, and correlations of the estimates.

    Given are the derivatives, shape (rows, unknowns), and residuals at the least-squares solution,
    the rows of each series (`blocks`) and of each run, and the size of each unknown.
    """
    special = require("scipy.special", extra="fit", purpose="Fitting")
    J = jacobian * scale
    _, s, Vt = np.linalg.svd(J, full_matrices=False)
    inverse = (Vt.T / np.maximum(s, SMALLEST * max(s[0], 1e-300)) ** 2) @ Vt
    leverage = np.clip(np.einsum("ij,jk,ik->i", J, inverse, J), 0.0, 0.9)
    alike, each = np.zeros_like(inverse), np.zeros_like(inverse)
    count = 0.0
    for block in blocks:
        e, Jb = residual[block], J[block]
        time = correlation_time(e)
        count += len(e) / time
        alike += time * float(e @ e) / len(e) * Jb.T @ Jb
        weighted = Jb * (e / (1 - leverage[block]))[:, None]
        each += time * weighted.T @ weighted
    freedom = max(1.0, count - len(scale))
    alike *= count / freedom
    variance = np.maximum(np.diag(inverse @ alike @ inverse), np.diag(inverse @ each @ inverse))
    half = float(special.stdtrit(freedom, 0.975)) * np.sqrt(variance)
    if len(runs) >= _RUNS:
        between = np.sqrt(_jackknife(J, residual, runs))
        half = np.maximum(half, float(special.stdtrit(len(runs) - 1, 0.975)) * between)
    flat = Vt[s < _FLAT * s[0]]
    half = np.where((np.abs(flat) > _LEAST_FLAT).any(axis=0), np.inf, half * scale)
    size = np.sqrt(np.diag(inverse))
    return half, np.clip(inverse / np.outer(size, size), -1.0, 1.0)


def _jackknife(J: np.ndarray, residual: np.ndarray, runs: list[slice]) -> np.ndarray:
    """Return jackknife variances from omitting runs, to first order, shape (unknowns,)."""
    changes = []
    for run in runs:
        others = np.ones(len(J), bool)
        others[run] = False
        # The remaining residual without the run is solved to zero again; the run's own touch stays.
        kept = np.flatnonzero(np.abs(J[others]).max(axis=0) > 0)
        change = np.zeros(J.shape[1])
        change[kept], *_ = np.linalg.lstsq(J[others][:, kept], -residual[others], rcond=SMALLEST)
        changes.append(change)
    spread = np.array(changes) - np.mean(changes, axis=0)
    return (len(runs) - 1) / len(runs) * np.square(spread).sum(axis=0)


COLLINEAR = 0.96
"""Multiple correlation of a constant with the others above which it is not identifiable.

Chosen: strength and inertia have 0.98 in drops of one sphere at any one speed, and 0.94 in drops at
two speeds with a ratio of two.
"""
WIDE = 0.5
"""Half width of an interval in parts of the value, above which it is not identifiable; chosen."""

_OTHER_SPEED = 1.5  # least ratio of two different speeds; chosen
_TAKES_PART = 0.15  # least part in a null direction, relative to its largest; chosen
_FASTEST = 6.0  # a fall of 1.8 m [m/s]
_OTHER = 3.0  # factor for faster, slower, heavier; chosen
_SHOWN = 4
_ROWS = 60  # rows of a planned record


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

    With `one_speed`, all runs have the same speed: then a narrow interval assumes an exact law, and
    does not hold at other speeds.
    """

    change: Mapping[str, float]  # relative changes along it; the largest is 1
    effect: float  # RMS change of the curves at 10 %, in parts of their largest values
    one_speed: bool = False


def trades_off(trials: Sequence[Trial], material: Material, names: Sequence[str]) -> bool:
    """Return True if constants trade off because all runs have one speed.

    Static and rate-dependent resistance are then separated only by the shape of one kind of curve,
    which assumes an exact law. A comparison with discrete elements (docs/calibration.md): constants
    that fit a sphere at 1 m/s within 0.3 % are 29 % wrong at 3 m/s.
    """
    speeds = [speed for trial in trials for speed in trial.speeds]
    by_speed = [material.by_speed(name) for name in names]
    one_speed = max(speeds) <= _OTHER_SPEED * min(speeds)
    return one_speed and any(by_speed) and not all(by_speed)


@dataclass(frozen=True)
class Information:
    """Information of runs about constants: derivatives for relative changes, touches eliminated."""

    matrix: np.ndarray

    @classmethod
    def of(cls, jacobian: np.ndarray, scale: np.ndarray) -> Self:
        """Return that of a problem's derivatives; the first columns are the constants."""
        constants = jacobian[:, : len(scale)] * scale
        touches = jacobian[:, len(scale) :]
        touches = touches[:, np.abs(touches).max(axis=0, initial=0.0) > 0]
        if touches.shape[1]:
            Q, _ = np.linalg.qr(touches)
            constants = constants - Q @ (Q.T @ constants)
        return cls(constants.T @ constants)

    @property
    def inverse(self) -> np.ndarray:
        """The covariance of the constants up to a factor."""
        values, vectors = np.linalg.eigh(self.matrix)
        least = max(values.max(), 1e-300) * SMALLEST**2
        return (vectors / np.maximum(values, least)) @ vectors.T

    def collinear(self) -> np.ndarray:
        """Return the multiple correlation of each constant with the others, shape (constants,)."""
        own = np.diag(self.matrix)
        square = 1 - 1 / np.maximum(own * np.diag(self.inverse), 1.0)
        silent = own <= SMALLEST**2 * max(own.max(), 1e-300)
        return np.where(silent, 1.0, np.sqrt(np.maximum(square, 0.0)))

    def null_directions(self, names: Sequence[str], one_speed: bool) -> tuple[NullDirection, ...]:
        """Return the flattest direction, and all others that are flat."""
        values, vectors = np.linalg.eigh(self.matrix)
        found = []
        for k, value in enumerate(values):
            if k > 0 and value > SMALLEST * values.max():
                break
            v = vectors[:, k] / vectors[np.argmax(np.abs(vectors[:, k])), k]
            change = {n: float(c) for n, c in zip(names, v, strict=True) if abs(c) >= _TAKES_PART}
            effect = 0.1 * float(np.sqrt(max(v @ self.matrix @ v, 0.0)))
            found.append(NullDirection(change, effect, one_speed))
        return tuple(found)


def further_tests(
    problem: Problem, material: Material, now: Information, half: np.ndarray, scale: np.ndarray
) -> tuple[FurtherTest, ...]:
    """Propose further tests, simulated with the fitted law; the most useful first."""
    names = problem.free
    before = np.sqrt(np.diag(now.inverse))
    # From derivatives to intervals, as in the fit.
    unit = float(np.median(np.where(np.isfinite(half), half, 0.1) / before))
    found = []
    for what, run in _candidates(problem.trials):
        try:
            trial = _planned(run, material)
            planned = Problem([trial], material, names)
            jacobian = planned.jacobian(planned.start())
        except GranularError:
            continue  # for example, the law has no elements for that body
        # Strength is a factor on the fitted material.
        added = Information.of(jacobian, np.where(scale != 0, scale, 1.0))
        both = Information(now.matrix + added.matrix)
        after = unit * np.sqrt(np.diag(both.inverse))
        good = (
            not trades_off((*problem.trials, trial), material, names)
            and bool((both.collinear() < COLLINEAR).all())
            and bool((after <= WIDE).all())
        )
        width = {name: float(w) for name, w in zip(names, after, strict=True)}
        found.append((float(np.max(after)), FurtherTest(what, width, good)))
    found.sort(key=lambda pair: (not pair[1].identifiable, pair[0]))
    return tuple(test for _, test in found[:_SHOWN])


def _candidates(trials: Sequence[Trial]) -> Iterator[tuple[str, Run]]:
    """Yield tests with the available bodies, with descriptions."""
    drops = [t for t in trials if isinstance(t, DropTrial)]
    pushes = [t for t in trials if isinstance(t, PushTrial)]
    bodies = [t.run.body for t in (*drops, *pushes)]
    if not bodies:
        return
    body = bodies[0]
    if body.is_heavy:
        yield from _drops(drops, body)
    depths = [float(t.arrest.depth) for t in drops]
    depths += [float(t.places.max()) if t.run.depth is None else t.run.depth for t in pushes]
    depth = max(min(depths), 0.2 * body.diameter)
    plain = replace(body, mass=None, density=None)
    size = plain.describe()
    if not any(t.axis == "depth" for t in pushes):
        slow = "pushed down slowly, force against depth"
        yield f"the {size} {slow}", _push(plain, depth)
        if plain.shape != "plate":
            side = plain.diameter if plain.length is None else plain.length / 2
            plate = Body("plate", side / 5, side)
            yield f"a {plate.describe()} {slow}", _push(plate, depth)
    what = (
        f"the {size} drawn along at a depth of {depth * 1e3:.2g} mm, force against speed to 1 m/s"
    )
    record = {"speed": np.linspace(0.01, 1.0, 15), "force": np.ones(15)}
    yield what, Run("planned", "drag", record, body=plain, depth=depth)


def _drops(drops: Sequence[DropTrial], body: Body) -> Iterator[tuple[str, Run]]:
    """Yield drops that are slower, faster or heavier than the measured ones."""
    speeds = [t.run.speed or 0.0 for t in drops if t.run.body == body]
    angle = drops[0].run.angle if drops else 0.0
    duration = 3 * max([t.arrest.time or 0.05 for t in drops], default=0.1)
    wanted = (min(speeds) / _OTHER, min(max(speeds) * _OTHER, _FASTEST)) if speeds else (1.0, 3.0)
    found = [
        (body, speed)
        for speed in wanted
        if all(not 1 / _OTHER_SPEED < speed / max(v, 1e-9) < _OTHER_SPEED for v in speeds)
    ]
    mass = _OTHER * body.projectile.mass
    found += [(replace(body, mass=mass, density=None), speeds[0])] if speeds else []
    time = np.linspace(0.0, duration, 4)
    for dropped, speed in found:
        record = {"time": time, "depth": speed * time + 0.1 * GRAVITY * time**2}
        article = "the" if dropped is body else "a"
        yield (
            f"a drop of {article} {dropped.describe()} at {speed:.2g} m/s",
            Run("planned", "drop", record, body=dropped, speed=speed, angle=angle),
        )


def _push(body: Body, depth: float) -> Run:
    record = {"depth": np.linspace(depth / _ROWS, depth, _ROWS), "force": np.ones(_ROWS)}
    return Run("planned", "intrude", record, body=body)


def _planned(run: Run, material: Material) -> Trial:
    """Return a run with what would be measured; a drop ends when it rests, or with its record."""
    if run.kind != "drop":
        force = PushTrial(run).simulate(material).force
        return PushTrial(replace(run, data=run.measured() | {"force": force}))
    fall = DropTrial(run).simulate(material)
    assert fall.time is not None
    arrest = find_arrest(fall.time, fall.depth)
    longest = 1.3 * (arrest.time or float(run.measured()["time"][-1]))
    time = np.linspace(0.0, min(longest, fall.time[-1]), _ROWS)
    return DropTrial(
        replace(run, data={"time": time, "depth": np.interp(time, fall.time, fall.depth)})
    )
