"""Update of the heights after a step in each world: press, deposit rims, flow.

The rules are those of `relief.update`, with formulas from the same source, but all nodes are
processed at once. Each surface point requests a height at its nodes, and the lowest wins
(`warp.press`). Each node beside a track takes its share of what the nearest body displaced
(`warp.heap`). Sand flows in squares of four nodes, every other one along both axes, so that no two
share a node (`warp.flow`).

`LANES` threads per world process its points or nodes, in any order. A world with nothing to do
costs almost nothing.
"""

# Kernels are written in Warp's language, which Python type checkers do not understand.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportIndexIssue=false
# pyright: reportAttributeAccessIssue=false, reportAssignmentType=false

# No `from __future__ import annotations`: Warp reads the types of local structs in place.
from typing import Any

import warp as wp

from mjgranular.relief.update import FASTEST, FLOWS_AFTER, PRESSED_AFTER
from mjgranular.warp.grid import corner_of, in_world, tile_of, wrapped
from mjgranular.warp.records import PlainRelief

LANES = 256
"""Threads per world. Chosen."""

IDLE, BEGINS, PRESSES, FLOWS = range(4)
"""What a world does in a step; one that flows also presses."""

NOTHING, LEFT, BESIDE = -1, -2, -3
"""Labels of nodes: no contact geom; one has just left; and, from here down, nodes beside tracks, by
contact geom and by the number of edge nodes of the track near them. Nonnegative labels are contact
geoms, plus `MOST_FEET` at edges."""

MOST_FEET = 1 << 12
"""Maximum number of geoms that press sand down."""

PRESSED, HEAPED, FORGOTTEN = range(3)
"""Volumes of each world [m^3]."""


@wp.func
def tile_beside(place: wp.vec3, row: int, column: int, cell: float, size: int):
    """Return the tile of the node that a place stores and that is nearest to a body."""
    i, j, a, b = corner_of(cell, place[0], place[1])
    half = size // 2
    i = i - half + wrapped(row - (i - half), size)
    j = j - half + wrapped(column - (j - half), size)
    return tile_of(i, j, size)


@wp.func
def claim(relief: Any, tile: int, row: int, column: int, volumes: wp.array2d(dtype=float)):
    """Assign a place to a tile; the height stored there before is forgotten."""
    grid = relief.state
    if grid.tile[grid.world, row, column] != tile:
        lost = relief.cell * relief.cell * grid.height[grid.world, row, column]
        wp.atomic_add(volumes, grid.world, FORGOTTEN, lost)
        grid.height[grid.world, row, column] = 0.0
        grid.tile[grid.world, row, column] = tile


@wp.kernel(enable_backward=False)
def begin(
    time: wp.array(dtype=float),
    gravity: wp.array(dtype=wp.vec3),
    cell: float,
    last: wp.array(dtype=float),
    since: wp.array2d(dtype=float),
    task: wp.array(dtype=int),
    rate: wp.array(dtype=float),
    waiting: wp.array2d(dtype=float),
    count: wp.array2d(dtype=int),
    volumes: wp.array2d(dtype=float),
    highest: wp.array(dtype=float),
):
    """Choose the task of each world by its time: a world whose time decreased has restarted."""
    world = wp.tid()
    now = time[world]
    passed = now - last[world]
    last[world] = now
    task[world] = IDLE
    for f in range(count.shape[1]):
        count[world, f] = 0
    if passed < 0.0:
        task[world] = BEGINS
        since[world, 0] = 0.0
        since[world, 1] = 0.0
        highest[world] = 0.0
        for f in range(count.shape[1]):
            waiting[world, f] = 0.0
        for n in range(volumes.shape[1]):
            volumes[world, n] = 0.0
        return
    g = wp.length(gravity[world % gravity.shape[0]])
    passed *= wp.sqrt(g / cell)
    if passed == 0.0:
        return
    since[world, 0] += passed
    since[world, 1] += passed
    if since[world, 0] < PRESSED_AFTER:
        return
    task[world] = PRESSES
    since[world, 0] = 0.0
    highest[world] = 0.0
    if since[world, 1] >= FLOWS_AFTER:
        task[world] = FLOWS
        rate[world] = wp.min(since[world, 1], FASTEST)
        since[world, 1] = 0.0


@wp.kernel(enable_backward=False)
def sum_up(surface: PlainRelief, task: wp.array(dtype=int)):
    """Sum heights over blocks, and find the highest."""
    world, block = wp.tid()
    if task[world] == IDLE:
        return
    relief = in_world(surface, world)
    grid, width = relief.state, relief.size // relief.blocks
    row, column = width * (block // relief.blocks), width * (block % relief.blocks)
    total, highest = float(0.0), float(0.0)
    for di in range(width):
        for dj in range(width):
            height = grid.height[world, row + di, column + dj]
            total += height
            highest = wp.max(highest, height)
    grid.sums[world, block // relief.blocks, block % relief.blocks] = total
    wp.atomic_max(grid.highest, world, highest)
