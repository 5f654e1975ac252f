"""Depth over time: beginning and end of a curve, and a check of its units."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjgranular.errors import InputError

GRAVITY = 9.81  # as for all dropped bodies (models/link.xml) [m/s^2]

_BEGINNING = 0.1  # part of the depth within which a fall is nearly uniform; chosen
_NEAR_STOP = 0.75  # part of the depth beyond which a stop is searched; chosen
_USUAL = 0.6  # ratio of `_PLAUSIBLE` for a body with constant deceleration
_END = 0.1  # part of the rows over which the final depth is averaged; chosen
_PLAUSIBLE = (0.02, 1.5)  # mean speed on the way down over that of a free fall; chosen, wide
_OTHER_UNITS = (("depth", "mm", 1e-3, 1.0), ("depth", "cm", 1e-2, 1.0), ("time", "ms", 1.0, 1e-3))
_TIMES = 200  # number of stopping times tried
_STAYS = 0.03  # parts of its range within which a curve counts as settled; chosen


@dataclass(frozen=True)
class Arrest:
    """End of a fall.

    Attributes:
        depth: final depth, the mean of the last rows [m].
        time: time after the touch at which the lowest point stops [s]; None if it does not.
    """

    depth: float
    time: float | None


def find_touch(time: np.ndarray, depth: np.ndarray, speed: float) -> float:
    """Return the time at which the lowest point touches the sand, from the rows around it [s].

    Above the sand the body falls freely; in the first tenth of its path the deceleration is
    constant.
    """
    greatest = depth.max()
    beyond = np.flatnonzero(depth > 3 * _BEGINNING * greatest)[0]
    early = np.flatnonzero(depth[: beyond + 1] < _BEGINNING * greatest)
    if speed == 0:
        return float(time[0])
    rows = early if len(early) else np.array([0])
    t, d = time[rows], depth[rows]
    square = speed**2 + 2 * GRAVITY * np.minimum(d, 0.0)
    falling = square > (0.05 * speed) ** 2  # before that the body was held
    if not falling.any():
        falling = np.ones(len(d), bool)
    above = (np.sqrt(np.maximum(square, 0.0)) - speed) / GRAVITY
    below = d / speed * (1 + d / (4 * greatest))
    since = np.where(d > 0, below, above)
    return float(np.median((t - since)[falling]))


def find_arrest(since: np.ndarray, depth: np.ndarray) -> Arrest:
    """Find where a fall ends, in the same way for measurements with noise and for computed curves.

    With constant deceleration at the end, `d = D - a (T - t)^2 / 2` before the body stops: D, a and
    T are fitted to the last quarter of the path. If the body rolls over afterwards, only the part
    before it rises again counts.
    """
    count = max(1, round(_END * len(depth)))
    final = float(depth[-count:].mean())
    width = max(1, len(depth) // 25)
    smooth = np.convolve(depth, np.ones(width) / width, mode="valid")
    middle = since[width // 2 : width // 2 + len(smooth)]
    top = smooth.max()
    first = int(np.argmax(smooth > _NEAR_STOP * top))
    low = np.flatnonzero(smooth[int(np.argmax(smooth)) :] < 0.97 * top)
    end = middle[min(len(middle) - 1, int(np.argmax(smooth)) + int(low[0]))] if len(low) else None
    rows = (since >= middle[first]) & (since <= (since[-1] if end is None else end))
    t, d = since[rows], depth[rows]
    if len(t) < 5:
        return Arrest(final, None)
    best, at = math.inf, None
    for stop in np.linspace(t[0], t[-1], _TIMES)[1:]:
        basis = np.column_stack([np.ones(len(t)), np.maximum(stop - t, 0.0) ** 2])
        solution, *_ = np.linalg.lstsq(basis, d, rcond=None)
        error = float(((basis @ solution - d) ** 2).sum())
        if error < best:
            best, at = error, stop
    last = t[-1] - 1.5 * (t[-1] - t[0]) / _TIMES
    return Arrest(final, None if at is None or at >= last else float(at))


def check_units(time: np.ndarray, depth: np.ndarray, speed: float, size: float, where: str) -> None:
    """Check that depths and times are plausible in meters and seconds; guess the unit if not.

    Args:
        time: [s], shape (n,).
        depth: [m], shape (n,); some of it is in the sand.
        speed: speed at the touch [m/s].
        size: largest extent of the body [m]; infinite if unknown.
        where: name of the run, for messages.

    Raises:
        InputError: they are not; names the likely unit.
    """
    greatest = float(depth.max())
    near = np.flatnonzero(depth >= 0.9 * greatest)[0]
    begin = np.flatnonzero(depth[: near + 1] <= _BEGINNING * greatest)
    took = float(time[near] - time[begin[-1] if len(begin) else 0])
    took = max(took, float(np.diff(time).min()))
    low, high = _PLAUSIBLE

    def ratio(meter: float = 1.0, second: float = 1.0) -> float:
        """Return the mean speed over that of a free fall, with other units of the file."""
        t = took * second
        return 0.9 * greatest * meter / (speed * t + GRAVITY * t**2 / 2)

    if low <= ratio() <= high and greatest <= 50 * size:
        return
    guesses = [
        (abs(math.log(ratio(meter, second) / _USUAL)), f"{column} [{unit}]")
        for column, unit, meter, second in _OTHER_UNITS
        if low < ratio(meter, second) < high and greatest * meter < 20 * size
    ]
    hint = "check the units of time, depth and speed"
    if guesses:
        column = min(guesses)[1]
        hint = f"it looks like {column.split('[')[1][:-1]}; name the column '{column}'"
    raise InputError(
        f"{where}: a depth of {greatest:.4g} m after {took:.3g} s at {speed:g} m/s is not "
        f"plausible: {hint}"
    )


def settling(since: np.ndarray, values: np.ndarray) -> float:
    """Return when a curve has settled to its end value but for noise, else its last time."""
    width = max(1, len(values) // 20)
    smooth = np.convolve(values, np.ones(width) / width, mode="valid")
    away = np.flatnonzero(np.abs(smooth - smooth[-1]) > _STAYS * np.ptp(smooth))
    last = min(len(since) - 1, int(away[-1]) + width) if len(away) else 0
    return float(since[last])


def check_record(time: np.ndarray, depth: np.ndarray, where: str) -> None:
    """Check that a record has enough rows, increasing times and contact.

    Raises:
        InputError: it does not; says which is missing.
    """
    if len(time) < 4:
        raise InputError(f"{where}: a trajectory needs at least 4 rows, got {len(time)}")
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        row = int(back[0])
        raise InputError(
            f"{where}: times must grow from row to row, got {time[row + 1]:g} s after "
            f"{time[row]:g} s in row {row + 2}"
        )
    if depth.max() <= 0:
        raise InputError(
            f"{where}: no contact, the depth is at most {depth.max():.4g} m: depths are positive "
            "below the surface"
        )
