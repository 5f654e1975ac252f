"""The grid of a relief: layout of its numbers in the state of a simulation, and access to them.

All numbers are zero for untouched sand. A node (i, j) of the plane is stored at (i mod size, j mod
size), with its indices as a key: numbers with another key belong to another node. Counts and places
are treated as untrusted numbers: none may lead outside the state.
"""

import math
from functools import partial
from typing import Any

from mjgranular.kernel.compiled import compiled

# Numbers before the arrays: an upper bound of all heights [m], and one of heights that do not flow;
# the highest of the rows searched since that bound was found, and the next row; volumes that were
# pressed down, heaped up, forgotten where the grid is wrapped around, and that wait for a rim to be
# deposited on [m^3]; lengths of both lists; time since bodies last pressed, and since sand last
# flowed, in units of sqrt(cell / g); time of the last step [s], by which a `Sand` detects that a
# simulation has started over; 1 if the last update changed nothing.
HIGHEST, SETTLED, SEEN, ROW, PRESSED, HEAPED, FORGOTTEN, WAITING, COVERED, ACTIVE = range(10)
SINCE_PRESSED, SINCE_FLOWED, TIME, SETTLES = range(10, 14)

# Then the poses of bodies at the last update: position and axes of the plane, body by body.
POSES, POSE = 14, 12
MOST_POSES = 64
"""Maximum number of bodies checked for rest; with more of them no update is skipped. Chosen."""

HEADER = POSES + POSE * MOST_POSES

# Arrays of a number for each node: height of the sand over the surface [m]; key and label; lists of
# places: those under bodies from the start, those where sand may flow from the end. Then, for each
# block of nodes, the sum of their heights.
HEIGHT, KEY, LISTS = range(3)
ARRAYS = 3

# Labels: sand may flow there; a body is there; a body was there in the last step.
UNMARKED, FLOWS, UNDER, WAS_UNDER = range(4)

_BIAS, _STRIDE = 1 << 20, 1 << 21  # node numbers from -2^20 to 2^20: 10 km of cells of 10 mm


def state_size(size: int) -> int:
    """Return the length of the state of a grid with `size` nodes along a side."""
    return HEADER + ARRAYS * size * size + (size // 4) ** 2


def node_keys(i: Any, j: Any) -> Any:
    """Return the keys of nodes, positive numbers."""
    return (i + _BIAS) * _STRIDE + (j + _BIAS) + 1


def nodes_of(keys: Any) -> Any:
    """Return rows and columns of the nodes with these keys."""
    return (keys - 1) // _STRIDE - _BIAS, (keys - 1) % _STRIDE - _BIAS


key_of = compiled(node_keys, inline=True)  # for kernels
_node_of_key = compiled(nodes_of, inline=True)


@partial(compiled, inline=True)
def node_of(base):
    """Return the node (i, j) of a `base_of`."""
    return _node_of_key(int(0.25 * base))


@partial(compiled, inline=True)
def place_of(size, i, j):
    """Return the index of a node within each array."""
    return (i % size) * size + j % size


@partial(compiled, inline=True)
def wrapped(n, size):
    """Wrap a row or column that is at most one outside the grid: faster than a remainder."""
    if n < 0:
        return n + size
    return n - size if n >= size else n


@partial(compiled, inline=True)
def start_of(size, array):
    """Return the index of an array's first number in the state."""
    return HEADER + array * size * size


@partial(compiled, inline=True)
def base_of(i, j):
    """Return the key of a node without a label."""
    return 4.0 * key_of(i, j)


@partial(compiled, inline=True)
def base_beside(base, di, dj):
    """Return `base_of` of a node `di` rows and `dj` columns away: faster than from its indices."""
    return base + 4.0 * (di * _STRIDE + dj)


@partial(compiled, inline=True)
def base_at(state, size, k):
    """Return `base_of` of the node stored at a place; 0 for none."""
    return 4.0 * (int(state[start_of(size, KEY) + k]) >> 2)


@partial(compiled, inline=True)
def mark_at(state, size, k):
    """Return the label of a place."""
    return int(state[start_of(size, KEY) + k]) & 3


@partial(compiled, inline=True)
def own_mark(state, size, k, base):
    """Return the label of a node, as a number; -1 if its place stores another or none."""
    mark = state[start_of(size, KEY) + k] - base
    return mark if 0.0 <= mark <= 3.0 else -1.0


@partial(compiled, inline=True)
def set_mark(state, size, k, mark):
    """Set the label of a place."""
    number = int(state[start_of(size, KEY) + k])
    state[start_of(size, KEY) + k] = 1.0 * ((number & ~3) | mark)


@compiled
def corner_of(cell, u, v):
    """Return the cell that contains a point (u, v): its first node (i, j), and the place in it."""
    a, b = u / cell, v / cell
    i, j = math.floor(a), math.floor(b)
    return i, j, a - i, b - j


@compiled
def height_at(state, size, cell, u, v):
    """Return the height of the sand over the surface at a point [m], bilinear."""
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
    """Return the mean height over a square of four blocks' side around a point [m].

    Blocks at the edges count in proportion to their part in the square, so the mean is continuous
    in the point. A crater of any shape with its rim, at most a block away, adds nothing to it.
    """
    width = size // blocks
    # Block 0 has the nodes 0 to width - 1: its center is at (width - 1) / 2.
    a = (u / cell - 0.5 * (width - 1)) / width
    b = (v / cell - 0.5 * (width - 1)) / width
    i, j = math.floor(a + 0.5), math.floor(b + 0.5)
    a, b = a - i, b - j
    row, first = (i - 2) % blocks, (j - 2) % blocks
    sums, total = start_of(size, ARRAYS), 0.0
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
    """Return the part of a block, `d` after that of a point, within two blocks of the point.

    The point is `a` blocks from the center of its own block, -1/2 to 1/2; d is from -2 to 2.
    """
    if d == -2:
        return 0.5 - a
    if d == 2:
        return 0.5 + a
    return 1.0


@partial(compiled, inline=True)
def row_at(size, k):
    """Return the row of a place: faster than an integer division."""
    return int((k + 0.5) * (1.0 / size))


@partial(compiled, inline=True)
def block_of(size, blocks, k):
    """Return the block of a place."""
    row, per_node = row_at(size, k), blocks / size
    return int((row + 0.5) * per_node) * blocks + int((k - row * size + 0.5) * per_node)


@partial(compiled, inline=True)
def add_height(state, size, blocks, k, amount):
    """Add to the height at a claimed place [m]."""
    state[start_of(size, HEIGHT) + k] += amount
    state[start_of(size, ARRAYS) + block_of(size, blocks, k)] += amount


@partial(compiled, inline=True)
def count_at(state, size, number):
    """Return the length of a list: `COVERED` or `ACTIVE`."""
    return min(max(int(state[number]), 0), size * size)


@partial(compiled, inline=True)
def listed_at(state, size, n):
    """Return entry `n` of the lists, a place."""
    n = min(max(n, 0), size * size - 1)
    return min(max(int(state[start_of(size, LISTS) + n]), 0), size * size - 1)


@partial(compiled, inline=True)
def is_full(state, size):
    """Return True if the lists are full."""
    return state[COVERED] + state[ACTIVE] >= size * size


@compiled
def claim(state, size, blocks, area, k, base):
    """Assign place k to the node with the key `base`; the height that was there is forgotten."""
    height = state[start_of(size, HEIGHT) + k]
    state[FORGOTTEN] += area * height
    add_height(state, size, blocks, k, -height)
    state[start_of(size, HEIGHT) + k] = 0.0
    # A place where sand may flow is in a list.
    mark = FLOWS if mark_at(state, size, k) == FLOWS else UNMARKED
    state[start_of(size, KEY) + k] = base + mark


@compiled
def activate(state, size, k):
    """Let sand flow at a place, from the next step on."""
    if mark_at(state, size, k) == UNMARKED and not is_full(state, size):
        count = count_at(state, size, ACTIVE)
        state[start_of(size, LISTS) + size * size - 1 - count] = k
        state[ACTIVE] = count + 1.0
        set_mark(state, size, k, FLOWS)


@compiled
def cover(state, size, k):
    """Label a place as under a body; it is listed once per step."""
    mark = mark_at(state, size, k)
    if mark != UNDER and not is_full(state, size):
        count = count_at(state, size, COVERED)
        state[start_of(size, LISTS) + count] = k
        state[COVERED] = count + 1.0
        set_mark(state, size, k, UNDER)


@compiled
def begin_covering(state, size):
    """Label places that were under bodies; return their number. They are listed first."""
    before = count_at(state, size, COVERED)
    for n in range(before):
        k = listed_at(state, size, n)
        if mark_at(state, size, k) == UNDER:
            set_mark(state, size, k, WAS_UNDER)
    return before


@compiled
def end_covering(state, size, before):
    """Let sand flow where bodies have left, and keep only places that are under bodies now."""
    count, lists = count_at(state, size, COVERED), start_of(size, LISTS)
    for n in range(before):
        k = listed_at(state, size, n)
        if mark_at(state, size, k) == WAS_UNDER:
            set_mark(state, size, k, UNMARKED)
            activate(state, size, k)
    for n in range(before, count):
        state[lists + n - before] = state[lists + n]
    state[COVERED] = 1.0 * max(count - before, 0)
