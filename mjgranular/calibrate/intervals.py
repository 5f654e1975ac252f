"""Confidence intervals for correlated errors.

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

from __future__ import annotations

import numpy as np

from mjgranular._util.extras import require

_FLAT = 1e-4  # singular value below which a direction is flat: no measurement is that good; chosen
_TAKES_PART = 0.05  # least part of a flat direction; chosen
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
    half = np.where((np.abs(flat) > _TAKES_PART).any(axis=0), np.inf, half * scale)
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
