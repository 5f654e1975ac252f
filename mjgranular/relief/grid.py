"""The grid of a relief: where its numbers are in the state of a simulation, and how they are read.

All of it is zero for untouched sand. A node of the plane, numbered (i, j), is kept at
(i mod size, j mod size), with its number as a key: what another node has left there is not its own.
"""

from __future__ import annotations

import math
from functools import partial

from mjgranular.kernel.compiled import compiled

# Numbers before the arrays: the highest that anything has risen above the surface; volumes that
# were pressed down, heaped up, forgotten where the grid is wrapped around [m^3], and that wait for
# a rim to be heaped up on; lengths of both lists.
HIGHEST, PRESSED, HEAPED, FORGOTTEN, WAITING, COVERED, ACTIVE = range(7)
HEADER = 8

# Arrays of a number for each node: height of the sand over the surface [m], of the sand around a
# body over that under it [m], the key, marks. Then lists of nodes: those under bodies, those where
# sand may flow.
HEIGHT, FILL, KEY, MARK = range(4)
COVERED_LIST, ACTIVE_LIST = 4, 5
ARRAYS = 6

# Marks.
UNMARKED, FLOWS, LIES_UNDER = 0.0, 1.0, 2.0

_BIAS, _STRIDE = 1 << 20, 1 << 21  # node numbers from -2^20 to 2^20: 10 km of cells of 10 mm


def state_size(size: int) -> int:
    """Number of numbers of the state of a grid with so many cells along a side."""
    return HEADER + ARRAYS * size * size


@partial(compiled, inline=True)
def key_of(i, j):
    """The key of a node; no number but 0 is none."""
    return np_float((i + _BIAS) * _STRIDE + (j + _BIAS) + 1)


@partial(compiled, inline=True)
def np_float(number):
    """An integer below 2^53 as a float."""
    return 1.0 * number


@partial(compiled, inline=True)
def place_of(size, i, j):
    """Where a node is kept among its array's."""
    return (i % size) * size + j % size


@partial(compiled, inline=True)
def start_of(size, array):
    """Index of an array's first number in the state."""
    return HEADER + array * size * size


@partial(compiled, inline=True)
def node_of(key):
    """The node (i, j) of a key."""
    number = int(key) - 1
    return number // _STRIDE - _BIAS, number % _STRIDE - _BIAS


@compiled
def corner_of(cell, u, v):
    """The cell that a place is in: its first node, and the place's part of the way to the last.

    Args:
        cell: side of a cell [m].
        u: along the first axis [m].
        v: along the second [m].

    Returns:
        (i, j, a, b).
    """
    a, b = u / cell, v / cell
    i, j = math.floor(a), math.floor(b)
    return int(i), int(j), a - i, b - j


@compiled
def heights_at(state, size, cell, u, v):
    """Height of the sand, and of the sand around, over the surface at a place [m], bilinear."""
    i, j, a, b = corner_of(cell, u, v)
    heights, fills = start_of(size, HEIGHT), start_of(size, FILL)
    keys = start_of(size, KEY)
    height, around = 0.0, 0.0
    for di in range(2):
        for dj in range(2):
            k = place_of(size, i + di, j + dj)
            if state[keys + k] == key_of(i + di, j + dj):
                weight = (a if di else 1.0 - a) * (b if dj else 1.0 - b)
                height += weight * state[heights + k]
                around += weight * (state[heights + k] + state[fills + k])
    return height, around
