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

# Arrays of a number for each node: height of the sand over the surface [m], the key, marks. Then
# lists of nodes: those under bodies, those where sand may flow. Behind them, for each block of
# nodes, the sum of their heights.
HEIGHT, KEY, MARK = range(3)
COVERED_LIST, ACTIVE_LIST = 3, 4
ARRAYS = 5

# Marks.
UNMARKED, FLOWS, LIES_UNDER = 0.0, 1.0, 2.0

_BIAS, _STRIDE = 1 << 20, 1 << 21  # node numbers from -2^20 to 2^20: 10 km of cells of 10 mm


def state_size(size: int, blocks: int) -> int:
    """Number of numbers of the state of a grid with so many cells and blocks along a side."""
    return HEADER + ARRAYS * size * size + blocks * blocks


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
def height_at(state, size, cell, u, v):
    """Height of the sand over the surface at a place [m], bilinear."""
    i, j, a, b = corner_of(cell, u, v)
    heights, keys = start_of(size, HEIGHT), start_of(size, KEY)
    height = 0.0
    for di in range(2):
        for dj in range(2):
            k = place_of(size, i + di, j + dj)
            if state[keys + k] == key_of(i + di, j + dj):
                weight = (a if di else 1.0 - a) * (b if dj else 1.0 - b)
                height += weight * state[heights + k]
    return height


@compiled
def mean_at(state, size, blocks, cell, u, v):
    """Mean height around a place [m]: of nine blocks, with the weights of a quadratic spline."""
    width = size // blocks
    # Block 0 has the nodes 0 to width - 1: its middle is at (width - 1) / 2.
    a = (u / cell - 0.5 * (width - 1)) / width
    b = (v / cell - 0.5 * (width - 1)) / width
    i, j = int(math.floor(a + 0.5)), int(math.floor(b + 0.5))
    a, b = a - i, b - j
    sums = start_of(size, ARRAYS)
    total = 0.0
    for di in range(-1, 2):
        for dj in range(-1, 2):
            k = ((i + di) % blocks) * blocks + (j + dj) % blocks
            total += spline(a, di) * spline(b, dj) * state[sums + k]
    return total / (width * width)


@partial(compiled, inline=True)
def spline(a, d):
    """Weight of the block before (-1), at (0) and behind (1) a place at -1/2 to 1/2 of it."""
    if d == 0:
        return 0.75 - a * a
    return 0.5 * (0.5 + d * a) * (0.5 + d * a)


@partial(compiled, inline=True)
def add_height(state, size, blocks, i, j, amount):
    """Adds to the height of a node that has been claimed [m]."""
    k = place_of(size, i, j)
    state[start_of(size, HEIGHT) + k] += amount
    width = size // blocks
    block = ((i % size) // width) * blocks + (j % size) // width
    state[start_of(size, ARRAYS) + block] += amount
