"""The grid of a relief: where its numbers are in the state of a simulation, and how they are read.

All of it is zero for untouched sand. A node of the plane, numbered (i, j), is kept at
(i mod size, j mod size), with its number as a key: what another node has left there is not its own.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from mjgranular.kernel.compiled import compiled

# Numbers before the arrays: a height that nothing is above [m], and one that nothing is above that
# does not flow; the highest of the rows that were looked through since that was found, and the
# next row; volumes that were pressed down, heaped up, forgotten where the grid is wrapped around,
# and that wait for a rim to be heaped up on [m^3]; lengths of both lists; how much time has gone by
# since bodies last pressed, and since sand last flowed, in units of sqrt(cell / g); time of the
# last step [s], by which a `Sand` knows that a simulation has started over; 1 where the last update
# has changed nothing, so that another at the same poses would not either.
HIGHEST, SETTLED, SEEN, ROW, PRESSED, HEAPED, FORGOTTEN, WAITING, COVERED, ACTIVE = range(10)
SINCE_PRESSED, SINCE_FLOWED, TIME, SETTLES = range(10, 14)

# Behind them the poses of bodies at the last update: place and axes of the plane, body by body.
POSES, POSE = 14, 12
MOST_POSES = 64
"""Bodies that may be found at rest; with more of them nothing is skipped. Chosen."""

HEADER = POSES + POSE * MOST_POSES

# Arrays of a number for each node: height of the sand over the surface [m]; key and mark; lists of
# places: those under bodies from the begin on, those where sand may flow from the end. Behind them,
# for each block of nodes, the sum of their heights.
HEIGHT, KEY, LISTS = range(3)
ARRAYS = 3

# Marks: sand may flow there; a body is there; a body was there in the last step.
UNMARKED, FLOWS, UNDER, WAS_UNDER = range(4)

_BIAS, _STRIDE = 1 << 20, 1 << 21  # node numbers from -2^20 to 2^20: 10 km of cells of 10 mm


def state_size(size: int) -> int:
    """Number of numbers of the state of a grid with so many nodes along a side."""
    return HEADER + ARRAYS * size * size + (size // 4) ** 2


def node_keys(i: Any, j: Any) -> Any:
    """Keys of nodes, each a number above 0."""
    return (i + _BIAS) * _STRIDE + (j + _BIAS) + 1


key_of = compiled(node_keys, inline=True)
"""`node_keys` for kernels."""


@partial(compiled, inline=True)
def node_of(base):
    """The node (i, j) of a `base_of`."""
    key = int(0.25 * base)
    return (key - 1) // _STRIDE - _BIAS, (key - 1) % _STRIDE - _BIAS


@partial(compiled, inline=True)
def place_of(size, i, j):
    """Where a node is kept among its array's."""
    return (i % size) * size + j % size


@partial(compiled, inline=True)
def wrapped(n, size):
    """A row or column that is one beside the grid at most, within it: quicker than a remainder."""
    if n < 0:
        return n + size
    return n - size if n >= size else n


@partial(compiled, inline=True)
def start_of(size, array):
    """Index of an array's first number in the state."""
    return HEADER + array * size * size


@partial(compiled, inline=True)
def base_of(i, j):
    """What is written in the place of a node that has no mark."""
    return 4.0 * key_of(i, j)


@partial(compiled, inline=True)
def base_beside(base, di, dj):
    """`base_of` of a node so many rows and columns away: quicker than to work it out anew."""
    return base + 4.0 * (di * _STRIDE + dj)


@partial(compiled, inline=True)
def base_at(state, size, k):
    """What `base_of` is of the node that is kept at a place; 0 for none."""
    return 4.0 * (int(state[start_of(size, KEY) + k]) >> 2)


@partial(compiled, inline=True)
def mark_at(state, size, k):
    """The mark of a place."""
    return int(state[start_of(size, KEY) + k]) & 3


@partial(compiled, inline=True)
def own_mark(state, size, k, base):
    """The mark of a node, as a number; -1 where another is kept in its place, or none."""
    mark = state[start_of(size, KEY) + k] - base
    return mark if 0.0 <= mark <= 3.0 else -1.0


@partial(compiled, inline=True)
def set_mark(state, size, k, mark):
    """Marks a place."""
    number = int(state[start_of(size, KEY) + k])
    state[start_of(size, KEY) + k] = 1.0 * ((number & ~3) | mark)


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
    return i, j, a - i, b - j


@compiled
def height_at(state, size, cell, u, v):
    """Height of the sand over the surface at a place [m], bilinear."""
    i, j, a, b = corner_of(cell, u, v)
    heights, row, column = start_of(size, HEIGHT), i % size, j % size
    height, base = 0.0, base_of(i, j)
    for di in range(2):
        for dj in range(2):
            k = wrapped(row + di, size) * size + wrapped(column + dj, size)
            if own_mark(state, size, k, base_beside(base, di, dj)) >= 0.0:
                weight = (a if di else 1.0 - a) * (b if dj else 1.0 - b)
                height += weight * state[heights + k]
    return height


@compiled
def mean_at(state, size, blocks, cell, u, v):
    """Mean height over a square of four blocks' side around a place [m].

    The blocks at the edges count by how far the square reaches into them, so the mean changes
    steadily with the place. A crater with its heap that lies no farther away than a block, whatever
    their shapes, adds nothing to it.
    """
    width = size // blocks
    # Block 0 has the nodes 0 to width - 1: its middle is at (width - 1) / 2.
    a = (u / cell - 0.5 * (width - 1)) / width
    b = (v / cell - 0.5 * (width - 1)) / width
    i, j = math.floor(a + 0.5), math.floor(b + 0.5)
    a, b = a - i, b - j
    row, first = (i - 2) % blocks, (j - 2) % blocks
    sums = start_of(size, ARRAYS)
    total = 0.0
    for di in range(-2, 3):
        begin, column, part = sums + row * blocks, first, 0.0
        for dj in range(-2, 3):
            part += share_of(b, dj) * state[begin + column]
            column = wrapped(column + 1, blocks)
        total += share_of(a, di) * part
        row = wrapped(row + 1, blocks)
    return total / (16.0 * width * width)


@partial(compiled, inline=True)
def share_of(a, d):
    """Share of a block, `d` behind that of a place, that lies within two blocks of the place.

    Args:
        a: how far the place is from the middle of its own block [blocks], -1/2 to 1/2.
        d: -2 to 2.
    """
    if d == -2:
        return 0.5 - a
    if d == 2:
        return 0.5 + a
    return 1.0


@partial(compiled, inline=True)
def row_at(size, k):
    """The row that a place is in: quicker than a division of integers."""
    return int((k + 0.5) * (1.0 / size))


@partial(compiled, inline=True)
def block_of(size, blocks, k):
    """The block that a place is in."""
    row, per_node = row_at(size, k), blocks / size
    return int((row + 0.5) * per_node) * blocks + int((k - row * size + 0.5) * per_node)


@partial(compiled, inline=True)
def add_height(state, size, blocks, k, amount):
    """Adds to the height at a place that has been claimed [m]."""
    state[start_of(size, HEIGHT) + k] += amount
    state[start_of(size, ARRAYS) + block_of(size, blocks, k)] += amount
