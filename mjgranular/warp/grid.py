"""The grid of heights that each world stores, as kernels read it.

As on the CPU (`relief.grid`), a node (i, j) of the plane is stored at (i mod size, j mod size). The
*tile* of the plane that a node lies in, (i // size, j // size) as one integer, distinguishes it
from other nodes stored in the same place.
"""

# Kernels are written in Warp's language, which Python type checkers do not understand.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportIndexIssue=false
# pyright: reportAttributeAccessIssue=false

from typing import Any

import numpy as np
import warp as wp


def struct(name: str, fields: dict[str, Any]) -> Any:
    """Make a Warp struct."""
    return wp.struct(type(name, (), {"__annotations__": fields, "__module__": __name__}))


Grid = struct(
    "Grid",
    {
        "height": wp.array3d(dtype=float),  # of nodes over the surface [m], (nworld, size, size)
        "tile": wp.array3d(dtype=int),  # that the height in a place belongs to; 0 for none
        "sums": wp.array3d(dtype=float),  # of the heights in a block (nworld, blocks, blocks)
        "highest": wp.array(dtype=float),  # of each world [m]
        "world": int,  # index of the current world
    },
)

_BIAS, _STRIDE = 1 << 14, 1 << 15  # tiles from -2^14 to 2^14 on: 32 km of 2 m


def tiles_of(i: np.ndarray, j: np.ndarray, size: int) -> np.ndarray:
    """Return the tiles of nodes, positive integers."""
    return (i // size + _BIAS) * _STRIDE + j // size + _BIAS + 1


@wp.func
def wrapped(i: int, size: int):
    """Return the row or column that stores a node."""
    return ((i % size) + size) % size


@wp.func
def tile_of(i: int, j: int, size: int):
    """Return the tile of a node, a positive integer."""
    row, column = (i - wrapped(i, size)) // size, (j - wrapped(j, size)) // size
    return (row + _BIAS) * _STRIDE + column + _BIAS + 1


@wp.func
def node_in(tile: int, row: int, column: int, size: int):
    """Return the node (i, j) of a tile that a place stores."""
    first, second = (tile - 1) // _STRIDE - _BIAS, (tile - 1) % _STRIDE - _BIAS
    return first * size + row, second * size + column


@wp.func
def height_of_node(grid: Grid, size: int, i: int, j: int):
    """Return the height of the sand over the surface at a node [m]."""
    row, column = wrapped(i, size), wrapped(j, size)
    if grid.tile[grid.world, row, column] == tile_of(i, j, size):
        return grid.height[grid.world, row, column]
    return 0.0


@wp.func
def corner_of(cell: float, u: float, v: float):
    """See `relief.grid.corner_of`."""
    a, b = u / cell, v / cell
    i, j = int(wp.floor(a)), int(wp.floor(b))
    return i, j, a - float(i), b - float(j)


@wp.func
def height_at(grid: Grid, size: int, cell: float, u: float, v: float):
    """See `relief.grid.height_at`."""
    i, j, a, b = corner_of(cell, u, v)
    low = (1.0 - b) * height_of_node(grid, size, i, j) + b * height_of_node(grid, size, i, j + 1)
    high = (1.0 - b) * height_of_node(grid, size, i + 1, j) + b * height_of_node(
        grid, size, i + 1, j + 1
    )
    return (1.0 - a) * low + a * high


@wp.func
def _share(a: float, d: int):
    """See `relief.grid.share_of`."""
    return wp.where(d == -2, 0.5 - a, wp.where(d == 2, 0.5 + a, 1.0))


@wp.func
def mean_at(grid: Grid, size: int, blocks: int, cell: float, u: float, v: float):
    """See `relief.grid.mean_at`."""
    width = size // blocks
    a = (u / cell - 0.5 * float(width - 1)) / float(width)
    b = (v / cell - 0.5 * float(width - 1)) / float(width)
    i, j = int(wp.floor(a + 0.5)), int(wp.floor(b + 0.5))
    a, b = a - float(i), b - float(j)
    total = float(0.0)
    for di in range(-2, 3):
        row = wrapped(i + di, blocks)
        for dj in range(-2, 3):
            share = _share(a, di) * _share(b, dj)
            total += share * grid.sums[grid.world, row, wrapped(j + dj, blocks)]
    return total / (16.0 * float(width * width))


@wp.func
def highest_of(relief: Any):
    """See `relief.probe.highest_of`."""
    return relief.state.highest[relief.state.world]


@wp.func
def in_world(relief: Any, world: int):
    """Return a surface with memory as it is in one world."""
    relief.state.world = world
    return relief


@wp.func
def in_any_world(surface: Any, world: int):
    """Return a surface that is the same in all worlds."""
    return surface
