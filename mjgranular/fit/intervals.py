"""Intervals that are honest about errors that hang together.

Errors along one trajectory are not independent: a camera that is off stays off, a law that is wrong
is wrong for a while. Of each series the integrated autocorrelation time of its residuals (the sum
over lags up to the first pair that is not positive, C. J. Geyer, Statistical Science 7 (1992)) says
how many rows count for one. The covariance is that of the sandwich, with the weight of each series
as it was taken and not as it should have been, and with errors as large as they were found in each
row; what is larger, that or one size of error for the whole series, is taken. Few rows that count
make Student's t wide.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

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
    return float(np.clip(1 + 2 * total, 1.0, n))


def spread_of(
    jacobian: np.ndarray, residual: np.ndarray, blocks: list[slice], scale: np.ndarray, stats: Any
) -> Spread:
    """How uncertain unknowns are at the least squares.

    Args:
        jacobian: shape (rows, unknowns).
        residual: shape (rows,).
        blocks: where each series stands.
        scale: size of each unknown, shape (unknowns,).
        stats: the module `scipy.stats`.
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
    half = float(stats.t.ppf(0.975, freedom)) * np.sqrt(variance) * scale
    size = np.sqrt(np.diag(inverse))
    return Spread(half, np.clip(inverse / np.outer(size, size), -1.0, 1.0), freedom)
