"""`Heights`: the stored heights of a surface around a point, as arrays for plots and drawings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mjgranular.errors import InputError, shown
from mjgranular.relief.grid import HEADER, node_keys
from mjgranular.relief.memory import Memory


@dataclass(frozen=True)
class Heights:
    """Heights of the sand over its surface, on a square of nodes.

    Attributes:
        x: coordinates of the nodes along the first axis of the surface's plane [m], shape (n,).
        y: coordinates along the second [m], shape (n,). On a level plane both are the world's.
        height: over the surface, along its normal [m], shape (n, n): `height[i, j]` at (x[i],
            y[j]). Zero where nothing has moved the sand, and where that is forgotten.
    """

    x: np.ndarray
    y: np.ndarray
    height: np.ndarray


def checked_state(saved: Any, size: int) -> np.ndarray:
    """Check a stored state of a surface that a user passes back."""
    try:
        state = np.asarray(saved, float)
    except (TypeError, ValueError):
        raise InputError(f"what the sand remembers is {size} numbers, not {shown(saved)}") from None
    if state.shape != (size,):
        raise InputError(
            f"what this sand remembers is {size} numbers, as `save_memory` gives them, not an "
            f"array of shape {state.shape}: a memory of other cells or extent has others"
        )
    wrong = np.flatnonzero(~np.isfinite(state))
    if len(wrong):
        raise InputError(
            f"what the sand remembers must be finite numbers: {len(wrong)} of {size} are not, the "
            f"first is number {wrong[0]}, {state[wrong[0]]}; nothing was changed"
        )
    return state


def heights_of(state: np.ndarray, memory: Memory, middle: tuple[float, float]) -> Heights:
    """Return the heights in a relief's state around a point of its plane [m]."""
    size = memory.size
    i, j = square_about(memory, middle)
    places = (i % size)[:, None] * size + j % size
    heights, numbers = state[HEADER:][: 2 * size * size].reshape(2, size * size)
    own = numbers[places] // 4 == node_keys(i[:, None], j)
    return Heights(memory.cell * i, memory.cell * j, np.where(own, heights[places], 0.0))


def square_about(memory: Memory, middle: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of the nodes of the square around a point that may be stored."""
    numbers = np.asarray(middle)
    if numbers.shape != (2,) or numbers.dtype.kind not in "iuf" or not np.isfinite(numbers).all():
        raise InputError(f"the middle is two numbers [m], not {shown(middle)}")
    first = [round(place / memory.cell) - memory.size // 2 for place in middle]
    i, j = (begin + np.arange(memory.size) for begin in first)
    return i, j
