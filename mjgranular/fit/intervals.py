"""Intervals that are honest about errors that hang together.

Errors along one trajectory are not independent: a camera that is off stays off, a law that is wrong
is wrong for a while. Of each series the integrated autocorrelation time of its residuals (the sum
over lags up to the first pair that is not positive, C. J. Geyer, Statistical Science 7 (1992)) says
how many rows count for one. Of few rows that comes out too small: where neighbors are alike beyond
chance, that of a first-order process is taken if it is longer, its coefficient corrected for the
bias of short series (M. G. Kendall, Biometrika 41 (1954)).

The covariance is that of the sandwich, with the weight of each series as it was taken and not as it
should have been, and with errors as large as they were found in each row; what is larger, that or
one size of error for the whole series, is taken. Few rows that count make Student's t wide.

What is off for a whole run, the height of the surface say, no statistic of that run can see. From
four runs on each is left out in turn, to first order (the jackknife), and the interval is at least
what runs differ by.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

_FLAT = 1e-4  # singular value, likewise: no measurement is as good as that; chosen
_TAKES_PART = 0.05  # of a flat direction; chosen
_RUNS = 4  # from which on runs are held against each other; chosen
SMALLEST = 1e-7  # singular value, in parts of the greatest, below which nothing is told; chosen


@dataclass(frozen=True)
class Spread:
    """How uncertain the unknowns are.

    Attributes:
        half: half widths of the 95 % intervals, shape (unknowns,).
        correlation: of the estimates, shape (unknowns, unknowns).
        freedom: degrees of freedom that are left.
    """

    half: np.ndarray
    correlation: np.ndarray
    freedom: float


def correlation_time(errors: np.ndarray) -> float:
    """Rows that count for one: 1 of errors that are independent."""
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
    special: Any,
) -> Spread:
    """How uncertain unknowns are at the least squares.

    Args:
        jacobian: shape (rows, unknowns).
        residual: shape (rows,).
        blocks: where each series stands.
        runs: where each run stands.
        scale: size of each unknown, shape (unknowns,).
        special: the module `scipy.special`.
    """
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
    return Spread(half, np.clip(inverse / np.outer(size, size), -1.0, 1.0), freedom)


def _jackknife(J: np.ndarray, residual: np.ndarray, runs: list[slice]) -> np.ndarray:
    """Variances by what changes where a run is left out, to first order, shape (unknowns,)."""
    changes = []
    for run in runs:
        others = np.ones(len(J), bool)
        others[run] = False
        # What is left over without the run is brought to nothing again; its own touch stays.
        kept = np.flatnonzero(np.abs(J[others]).max(axis=0) > 0)
        change = np.zeros(J.shape[1])
        change[kept], *_ = np.linalg.lstsq(J[others][:, kept], -residual[others], rcond=SMALLEST)
        changes.append(change)
    spread = np.array(changes) - np.mean(changes, axis=0)
    return (len(runs) - 1) / len(runs) * np.square(spread).sum(axis=0)
