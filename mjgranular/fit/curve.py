"""Depth over time: where a curve begins, where it ends, and whether it can be what it says."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjgranular.errors import InputError

GRAVITY = 9.81  # of the bodies that are dropped (models/link.xml) [m/s^2]

_BEGINNING = 0.1  # part of the depth within which a fall is nearly uniform; chosen
_NEAR_STOP = 0.75  # part of the depth beyond which a stop is looked for; chosen
_USUAL = 0.6  # what it is of bodies that are slowed evenly
_END = 0.1  # part of the rows that the final depth is the mean of; chosen
_PLAUSIBLE = (0.02, 1.5)  # mean speed of the way down over that of a free fall; chosen, wide
_TIMES = 200  # at which a stop is tried


@dataclass(frozen=True)
class Arrest:
    """End of a fall.

    Attributes:
        depth: final depth, the mean of the last rows [m].
        time: at which the lowest point stops, after the touch [s]; None if it does not.
    """

    depth: float
    time: float | None


def find_touch(time: np.ndarray, depth: np.ndarray, speed: float) -> float:
    """Time at which the lowest point touches the sand, by the rows around it [s].

    Above the sand the body falls freely; in its first tenth of the way it loses speed evenly.

    Args:
        time: [s], shape (n,).
        depth: [m], shape (n,).
        speed: at the touch, down [m/s].
    """
    greatest = depth.max()
    beyond = np.flatnonzero(depth > 3 * _BEGINNING * greatest)[0]
    early = np.flatnonzero(depth[: beyond + 1] < _BEGINNING * greatest)
    if speed == 0:
        return float(time[0])
    rows = early if len(early) else np.array([0])
    t, d = time[rows], depth[rows]
    square = speed**2 + 2 * GRAVITY * np.minimum(d, 0.0)
    falling = square > (0.05 * speed) ** 2  # before that it was held
    if not falling.any():
        falling = np.ones(len(d), bool)
    above = (np.sqrt(np.maximum(square, 0.0)) - speed) / GRAVITY
    below = d / speed * (1 + d / (4 * greatest))
    since = np.where(d > 0, below, above)
    return float(np.median((t - since)[falling]))


def find_arrest(since: np.ndarray, depth: np.ndarray) -> Arrest:
    """Where a fall ends, alike for measurements with noise and for computed curves.

    A body that is slowed evenly at the end has `d = D - a (T - t)^2 / 2` before it stops: D, a and
    T are those that fit the last quarter of the way best. Of a body that rolls over afterwards only
    what comes before it rises again counts.

    Args:
        since: time since the touch [s], shape (n,).
        depth: [m], shape (n,).
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
    """Refuses depths and times that cannot be in meters and seconds; guesses what they are in.

    Args:
        time: [s], shape (n,).
        depth: [m], shape (n,); some of it is in the sand.
        speed: at the touch [m/s].
        size: greatest extent of the body [m]; infinite if it is not known.
        where: the run, for messages.

    Raises:
        InputError: names the unit that they look like.
    """
    greatest = float(depth.max())
    near = np.flatnonzero(depth >= 0.9 * greatest)[0]
    begin = np.flatnonzero(depth[: near + 1] <= _BEGINNING * greatest)
    took = float(time[near] - time[begin[-1] if len(begin) else 0])
    took = max(took, float(np.diff(time).min()))
    way = 0.9 * greatest
    low, high = _PLAUSIBLE
    rate = way / (speed * took + GRAVITY * took**2 / 2)
    if rate > high or greatest > 50 * size:
        guesses = [
            (abs(math.log(rate * factor / _USUAL)), unit)
            for unit, factor in (("mm", 1e-3), ("cm", 1e-2))
            if low < rate * factor < high and greatest * factor < 20 * size
        ]
        if guesses:
            unit = min(guesses)[1]
            raise InputError(
                f"{where}: a depth of {greatest:.4g} m after {took:.3g} s at {speed:g} m/s "
                f"cannot be: it looks like {unit}; name the column 'depth [{unit}]'"
            )
        raise InputError(
            f"{where}: a depth of {greatest:.4g} m after {took:.3g} s is more than a free fall "
            f"makes of {speed:g} m/s: look at the units of time, depth and speed"
        )
    if rate < low:
        short = took * 1e-3
        if low < way / (speed * short + GRAVITY * short**2 / 2) < high:
            raise InputError(
                f"{where}: {took:.4g} s for a depth of {greatest:.3g} m at {speed:g} m/s cannot "
                "be: the times look like ms; name the column 'time [ms]'"
            )
        raise InputError(
            f"{where}: {took:.4g} s for a depth of {greatest:.3g} m is far too slow for {speed:g} "
            "m/s at the touch: look at the units of time, depth and speed"
        )
