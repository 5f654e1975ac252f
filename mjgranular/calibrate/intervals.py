"""Confidence intervals, and which constants the data determine.

Errors along one trajectory are not independent: a misaligned camera stays misaligned, and a law
that is wrong is wrong for a while. For each series, the integrated autocorrelation time of its
residuals (the sum over lags up to the first pair that is not positive, C. J. Geyer, Statistical
Science 7 (1992)) is the number of rows that count as one. For few rows this estimate is too small:
if the correlation of neighbors is significant, that of a first-order process is used if it is
longer, its coefficient corrected for short series (M. G. Kendall, Biometrika 41 (1954)).

The covariance is the sandwich estimator, with the actual weight of each series, not the ideal one,
and with the error found in each row or one error for the whole series, whichever is larger. Few
effective rows make Student's t wide.

No statistic of one run can reveal an error that is constant over it, in the height of the surface
for example. With four runs or more, each is omitted in turn, to first order (the jackknife), and
the interval is at least the spread between runs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mjgranular._util.checks import require
from mjgranular.calibrate.material import Material
from mjgranular.calibrate.trial import Trial

_FLAT = 1e-4  # singular value below which a direction is flat: no measurement is that good; chosen
_LEAST_FLAT = 0.05  # least part of a flat direction; chosen
_RUNS = 4  # least number of runs for the jackknife; chosen
SMALLEST = 1e-7  # singular value, in parts of the largest, below which nothing is reported; chosen


def correlation_time(errors: np.ndarray) -> float:
    """Return the number of rows that count as one: 1 for independent errors."""
    n, power = len(errors), float(errors @ errors)
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
    inverse = (Vt.T / np.maximum(s, SMALLEST * max(s[0], 1e-140)) ** 2) @ Vt
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
    flat = Vt[s <= _FLAT * s[0]]
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


@dataclass(frozen=True)
class NullDirection:
    """Constants that trade off against each other: along it curves hardly change.

    With `one_speed`, a narrow interval assumes an exact law, and does not hold at other speeds.
    """

    change: Mapping[str, float]  # relative changes along it; the largest is 1
    effect: float  # RMS change of the curves at 10 %, in parts of their largest values
    one_speed: bool = False


def trades_off(trials: Sequence[Trial], material: Material, names: Sequence[str]) -> bool:
    """Return True if constants trade off because all runs have one speed.

    Static and rate-dependent resistance are then separated only by the shape of one kind of curve,
    which assumes an exact law (docs/calibration.md).
    """
    speeds = [speed for trial in trials for speed in trial.speeds]
    by_speed = [material.by_speed(name) for name in names]
    one_speed = max(speeds) <= _OTHER_SPEED * min(speeds)
    return one_speed and any(by_speed) and not all(by_speed)


def information_of(jacobian: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return the information of runs about relative changes of constants, touches eliminated.

    The first columns of the derivatives are those by the constants, of sizes `scale`.
    """
    constants = jacobian[:, : len(scale)] * scale
    touches = jacobian[:, len(scale) :]
    touches = touches[:, np.abs(touches).max(axis=0, initial=0.0) > 0]
    if touches.shape[1]:
        Q, _ = np.linalg.qr(touches)
        constants = constants - Q @ (Q.T @ constants)
    return constants.T @ constants


def collinear(information: np.ndarray) -> np.ndarray:
    """Return the multiple correlation of each constant with the others, shape (constants,)."""
    values, vectors = np.linalg.eigh(information)
    least = max(values.max(), 1e-140) * SMALLEST**2
    covariance = (vectors / np.maximum(values, least)) @ vectors.T
    own = np.diag(information)
    square = 1 - 1 / np.maximum(own * np.diag(covariance), 1.0)
    silent = own <= SMALLEST**2 * max(own.max(), 1e-140)
    return np.where(silent, 1.0, np.sqrt(np.maximum(square, 0.0)))


def null_directions(
    information: np.ndarray, names: Sequence[str], one_speed: bool
) -> tuple[NullDirection, ...]:
    """Return the flattest direction, and all others that are flat."""
    values, vectors = np.linalg.eigh(information)
    found = []
    for k, value in enumerate(values):
        if k > 0 and value > SMALLEST * values.max():
            break
        v = vectors[:, k] / vectors[np.argmax(np.abs(vectors[:, k])), k]
        change = {n: float(c) for n, c in zip(names, v, strict=True) if abs(c) >= _TAKES_PART}
        effect = 0.1 * float(np.sqrt(max(v @ information @ v, 0.0)))
        found.append(NullDirection(change, effect, one_speed))
    return tuple(found)
