"""What a step leaves behind in each world: sand is pressed down, heaped up, and flows.

The rules are those of `relief.update`, their formulas the same source; what differs is that all
nodes are seen to at once. Skin that wants a node down leaves its height there, and the lowest
wins (`warp.press`); each node beside a print takes its share of what the nearest body has displaced
(`warp.heap`); and sand flows in squares of four nodes, every other one along both axes, so
that no two share a node (`warp.flow`).

`LANES` threads of each world go over its points or nodes, at once or not: a world that has
nothing to do costs next to nothing.
"""

# The code of kernels is Warp's language, of which type checkers of Python know little.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportIndexIssue=false
# pyright: reportAttributeAccessIssue=false, reportAssignmentType=false

# Without `annotations` of the future: Warp reads types of local structs where they stand.
from typing import Any

import warp as wp

from mjgranular.relief.update import FASTEST, FLOWS_AFTER, PRESSED_AFTER
from mjgranular.warp.grid import corner_of, in_world, tile_of, wrapped
from mjgranular.warp.records import PlainRelief

LANES = 256
"""Threads of a world. Chosen."""

IDLE, BEGINS, PRESSES, FLOWS = range(4)
"""What a world does in a step; who flows also presses."""

NOTHING, LEFT, BESIDE = -1, -2, -3
"""At a node there is no foot; one has just left; from here down, nodes beside prints, by foot and
by how many nodes at the print's edge they are near. Above are feet, at edges `MOST_FEET` more."""

MOST_FEET = 1 << 12
"""Geoms that press sand down, at most."""

PRESSED, HEAPED, FORGOTTEN = range(3)
"""Volumes of each world [m^3]."""


@wp.func
def tile_beside(place: wp.vec3, row: int, column: int, cell: float, size: int):
    """The tile of the node that is kept in a place and lies nearest to a body."""
    i, j, a, b = corner_of(cell, place[0], place[1])
    half = size // 2
    i = i - half + wrapped(row - (i - half), size)
    j = j - half + wrapped(column - (j - half), size)
    return tile_of(i, j, size)


@wp.func
def claim(relief: Any, tile: int, row: int, column: int, volumes: wp.array2d(dtype=float)):
    """Makes a place that of a tile: what was there before is forgotten."""
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
    """Finds what each world does now, by its own time: one whose time is less has begun anew."""
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
    """Sums heights up over blocks, and finds the highest."""
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
