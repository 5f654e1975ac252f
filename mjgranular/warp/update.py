"""Update of the heights after a step in each world: press, deposit rims, flow.

The rules are those of `relief.update`, with formulas from the same source, but all nodes are
processed at once. Each surface point requests a height at its nodes, and the lowest wins
(`press`). Each node beside a track takes its share of what the nearest body displaced (`heap`).
Sand flows in squares of four nodes, every other one along both axes: no two share one (`flow`).

`LANES` threads per world process its points or nodes, in any order.
"""

# Kernels are written in Warp's language, which Python type checkers do not understand.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportIndexIssue=false
# pyright: reportAttributeAccessIssue=false, reportAssignmentType=false

import functools
from typing import Any

import numpy as np
import warp as wp

from mjgranular.relief import update as rules
from mjgranular.relief.update import FACES_DOWN, FASTEST, FLOWS_AFTER, LEAST, PRESSED_AFTER, REST
from mjgranular.warp.grid import (
    corner_of,
    height_of_node,
    in_world,
    node_in,
    struct,
    tile_of,
    wrapped,
)
from mjgranular.warp.translate import PlainRelief, translated

LANES = 256
"""Threads per world. Chosen."""

IDLE, PRESSES, FLOWS = range(3)
"""What a world does in a step; one that flows also presses."""

NOTHING, LEFT, BESIDE = -1, -2, -3
"""Labels of nodes: no contact geom; one has just left; and, from here down, nodes beside tracks, by
contact geom and by the number of edge nodes of the track near them. Nonnegative labels are contact
geoms, plus `MOST_FEET` at edges."""

MOST_FEET = 1 << 12  # maximum number of geoms that press sand down

PRESSED, HEAPED, FORGOTTEN = range(3)
"""Volumes of each world [m^3]."""

Work = struct(
    "Work",
    {
        "task": wp.array(dtype=int),  # of each world
        "rate": wp.array(dtype=float),  # at which its sand flows
        "last": wp.array(dtype=float),  # time of its last step [s]
        "since": wp.array2d(dtype=float),  # time since it pressed, and since it flowed
        "wanted": wp.array3d(dtype=wp.int64),  # heights that surface points request (`press`)
        "foot": wp.array3d(dtype=int),  # labels of nodes
        "places": wp.array2d(dtype=wp.vec3),  # of contact geoms, along the axes of the plane [m]
        "waiting": wp.array2d(dtype=float),  # volumes that they displaced, to be deposited [m^3]
        "count": wp.array2d(dtype=int),  # number of parts in which that is deposited
        "volumes": wp.array2d(dtype=float),  # moved since the start of each world
    },
)
"""What the kernels of an update pass on to each other."""

_NEAR = 32  # more than the number of edge nodes within two cells

_is_sand, _has_edges = translated(rules.is_sand), translated(rules.has_edges)
_skin_at, _slope_to = translated(rules.skin_at), translated(rules.slope_to)
_excess_of, _gains_of = translated(rules.excess_of), translated(rules.gains_of)


@wp.func
def tile_beside(place: wp.vec3, row: int, column: int, cell: float, size: int):
    """Return the tile of the node that a place stores and that is nearest to a body."""
    i, j, a, b = corner_of(cell, place[0], place[1])
    half = size // 2
    i = i - half + wrapped(row - (i - half), size)
    j = j - half + wrapped(column - (j - half), size)
    return tile_of(i, j, size)


@wp.func
def claim(relief: Any, work: Work, tile: int, row: int, column: int):
    """Assign a place to a tile; the height stored there before is forgotten."""
    grid = relief.state
    if grid.tile[grid.world, row, column] != tile:
        lost = relief.cell * relief.cell * grid.height[grid.world, row, column]
        wp.atomic_add(work.volumes, grid.world, FORGOTTEN, lost)
        grid.height[grid.world, row, column] = 0.0
        grid.tile[grid.world, row, column] = tile


@wp.kernel(enable_backward=False)
def restart(time: wp.array(dtype=float), surface: PlainRelief, work: Work):
    """Clear the sand of a world whose time decreased, before its forces are computed."""
    world, lane = wp.tid()
    if time[world] >= work.last[world]:
        return
    relief = in_world(surface, world)
    grid, size, blocks = relief.state, relief.size, relief.blocks
    for n in range(lane, size * size, LANES):
        grid.height[world, n // size, n % size] = 0.0
        grid.tile[world, n // size, n % size] = 0
        work.foot[world, n // size, n % size] = NOTHING
    for n in range(lane, blocks * blocks, LANES):
        grid.sums[world, n // blocks, n % blocks] = 0.0
    for f in range(lane, work.waiting.shape[1], LANES):
        work.waiting[world, f] = 0.0
    if lane == 0:
        grid.highest[world] = 0.0
        for n in range(work.volumes.shape[1]):
            work.volumes[world, n] = 0.0
        for n in range(work.since.shape[1]):
            work.since[world, n] = 0.0


@wp.kernel(enable_backward=False)
def begin(
    time: wp.array(dtype=float), gravity: wp.array(dtype=wp.vec3), surface: PlainRelief, work: Work
):
    """Choose the task of each world by the time that has passed."""
    world = wp.tid()
    highest = surface.state.highest
    now = time[world]
    passed = now - work.last[world]
    work.last[world] = now
    work.task[world] = IDLE
    for f in range(work.count.shape[1]):
        work.count[world, f] = 0
    g = wp.length(gravity[world % gravity.shape[0]])
    if passed <= 0.0:
        return
    passed *= wp.sqrt(g / surface.cell)
    work.since[world, 0] += passed
    work.since[world, 1] += passed
    if work.since[world, 0] > 0.0 and work.since[world, 0] < PRESSED_AFTER:
        return
    work.task[world] = PRESSES
    work.since[world, 0] = 0.0
    highest[world] = 0.0
    if work.since[world, 1] >= FLOWS_AFTER:
        work.task[world] = FLOWS
        work.rate[world] = wp.min(work.since[world, 1], FASTEST)
        work.since[world, 1] = 0.0


@wp.kernel(enable_backward=False)
def sum_up(surface: PlainRelief, work: Work):
    """Sum heights over blocks, and find the highest."""
    world, block = wp.tid()
    if work.task[world] == IDLE:
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


Skin = struct("SkinPoint", {"foot": int, "body": int, "point": wp.vec3, "normal": wp.vec3})
"""A surface point of a body, body frame; points on the axis of a rod have no normal."""

# Requested heights are compared as integers with the contact geom's index in the low digits, so the
# lowest wins in any order of threads. A nanometer is finer than single precision resolves.
_NANOMETRES = 1e9
UNWANTED = np.iinfo(np.int64).max
"""Value of a node that no contact geom presses down."""

_UNWANTED = wp.constant(wp.int64(UNWANTED))


@wp.func
def in_axes(relief: Any, away: wp.vec3):
    """Return the components of a vector along the axes of the plane under the heights."""
    return wp.vec3(
        wp.dot(away, relief.along), wp.dot(away, relief.across), wp.dot(away, relief.normal)
    )


@functools.cache
def press_kernel(relief_struct: Any, level: Any) -> Any:
    """Make the kernel in which points request heights, for a surface with that `level`."""
    level_at = translated(level)

    @wp.kernel(module="unique", enable_backward=False)
    def press(
        surface: relief_struct,
        skin: wp.array(dtype=Skin),
        work: Work,
        height: wp.array(dtype=float),
        up: wp.vec3,
        xpos: wp.array2d(dtype=wp.vec3),
        xmat: wp.array2d(dtype=wp.mat33),
    ):
        """Let each surface point request lower heights at the four nodes around it."""
        world, lane = wp.tid()
        if work.task[world] < PRESSES:
            return
        relief = in_world(surface, world)
        cell, size = relief.cell, relief.size
        lift = height[world % height.shape[0]] * up
        for n in range(lane, skin.shape[0], LANES):
            each = skin[n]
            turn, origin = xmat[world, each.body], xpos[world, each.body] - lift
            place = in_axes(relief, origin + turn * each.point - relief.origin)
            work.places[world, each.foot] = place
            u, v = place[0], place[1]
            slope_u, slope_v = float(0.0), float(0.0)
            if wp.length(each.normal) > 0.5:
                outward = turn * each.normal
                downward = wp.dot(outward, relief.normal)
                if downward > FACES_DOWN:
                    continue
                slope_u = -wp.dot(outward, relief.along) / downward
                slope_v = -wp.dot(outward, relief.across) / downward
            # NaN is not on the sand.
            if not _is_sand(relief, u, v):
                continue
            i, j, a, b = corner_of(cell, u, v)
            for di in range(2):
                for dj in range(2):
                    x, y = float(i + di) * cell, float(j + dj) * cell
                    low = _skin_at(place[2], slope_u, slope_v, x - u, y - v, cell)
                    low = low - level_at(relief, x, y)
                    there = height_of_node(relief.state, size, i + di, j + dj)
                    if low < there and _is_sand(relief, x, y):
                        number = wp.int64(wp.float64(low) * wp.float64(_NANOMETRES))
                        number = number * wp.int64(MOST_FEET) + wp.int64(each.foot)
                        row, column = wrapped(i + di, size), wrapped(j + dj, size)
                        wp.atomic_min(work.wanted, world, row, column, number)

    return press


@wp.kernel(enable_backward=False)
def settle(surface: PlainRelief, work: Work):
    """Press nodes down to the requested heights."""
    world, lane = wp.tid()
    if work.task[world] == IDLE:
        return
    relief = in_world(surface, world)
    grid, cell, size = relief.state, relief.cell, relief.size
    for n in range(lane, size * size, LANES):
        row, column = n // size, n % size
        number = work.wanted[world, row, column]
        work.foot[world, row, column] = wp.where(work.foot[world, row, column] >= 0, LEFT, NOTHING)
        if number == _UNWANTED:
            continue
        work.wanted[world, row, column] = _UNWANTED
        # Integer modulo that rounds down for either sign.
        f = int(((number % wp.int64(MOST_FEET)) + wp.int64(MOST_FEET)) % wp.int64(MOST_FEET))
        low = float(
            wp.float64((number - wp.int64(f)) // wp.int64(MOST_FEET)) / wp.float64(_NANOMETRES)
        )
        tile = tile_beside(work.places[world, f], row, column, cell, size)
        claim(relief, work, tile, row, column)
        work.foot[world, row, column] = f
        lowered = grid.height[world, row, column] - low - relief.slack
        if lowered > LEAST * relief.slack:
            grid.height[world, row, column] -= lowered
            volume = cell * cell * lowered
            wp.atomic_add(work.waiting, world, f, volume)
            wp.atomic_add(work.volumes, world, PRESSED, volume)


@wp.func
def share_of(volume: float, count: int, cell: float):
    """Return the height of one of `count` equal parts of a volume [m], at most one cell."""
    return wp.min(volume / (float(count) * cell * cell), cell)


@wp.kernel(enable_backward=False)
def edge(surface: PlainRelief, work: Work):
    """Find the track nodes that have sand beside them."""
    world, lane = wp.tid()
    if work.task[world] < PRESSES:
        return
    size = surface.size
    for n in range(lane, size * size, LANES):
        row, column = n // size, n % size
        if work.foot[world, row, column] < 0:
            continue
        has_sand = int(0)
        for di in range(-1, 2):
            for dj in range(-1, 2):
                if work.foot[world, wrapped(row + di, size), wrapped(column + dj, size)] == NOTHING:
                    has_sand = int(1)
        if has_sand == 1:
            work.foot[world, row, column] += MOST_FEET


@wp.kernel(enable_backward=False)
def surround(surface: PlainRelief, work: Work):
    """Find the nodes within two cells of a track's edge; the nearest of several tracks counts."""
    world, lane = wp.tid()
    if work.task[world] < PRESSES:
        return
    relief = in_world(surface, world)
    foot, cell, size = work.foot, relief.cell, relief.size
    has_edge = _has_edges(relief)
    for n in range(lane, size * size, LANES):
        row, column = n // size, n % size
        if foot[world, row, column] != NOTHING:
            continue
        nearest, found = int(9), int(NOTHING)
        for di in range(-2, 3):
            for dj in range(-2, 3):
                f = foot[world, wrapped(row + di, size), wrapped(column + dj, size)] - MOST_FEET
                far = di * di + dj * dj
                if f >= 0 and (far < nearest or (far == nearest and f < found)):
                    nearest = far
                    found = f
        if found < 0:
            continue
        if not (work.waiting[world, found] > 0.0):
            continue
        near = int(0)
        for di in range(-2, 3):
            for dj in range(-2, 3):
                f = foot[world, wrapped(row + di, size), wrapped(column + dj, size)] - MOST_FEET
                near += wp.where(f == found, 1, 0)
        if has_edge:
            tile = tile_beside(work.places[world, found], row, column, cell, size)
            i, j = node_in(tile, row, column, size)
            if not _is_sand(relief, float(i) * cell, float(j) * cell):
                continue
        foot[world, row, column] = BESIDE - (found * _NEAR + near)
        wp.atomic_add(work.count, world, found, near)


@wp.kernel(enable_backward=False)
def heap(surface: PlainRelief, work: Work):
    """Deposit sand beside tracks."""
    world, lane = wp.tid()
    if work.task[world] < PRESSES:
        return
    relief = in_world(surface, world)
    grid, cell, size = relief.state, relief.cell, relief.size
    for n in range(lane, size * size, LANES):
        row, column = n // size, n % size
        code = BESIDE - work.foot[world, row, column]
        if code < 0:
            continue
        f = code // _NEAR
        tile = tile_beside(work.places[world, f], row, column, cell, size)
        claim(relief, work, tile, row, column)
        share = share_of(work.waiting[world, f], work.count[world, f], cell)
        grid.height[world, row, column] += float(code % _NEAR) * share


@wp.kernel(enable_backward=False)
def keep(surface: PlainRelief, work: Work):
    """Keep volume that did not fit beside a track for later steps."""
    world, f = wp.tid()
    if work.task[world] < PRESSES or work.count[world, f] == 0:
        return
    cell, found = surface.cell, work.count[world, f]
    heaped = cell * cell * float(found) * share_of(work.waiting[world, f], found, cell)
    work.waiting[world, f] -= heaped
    wp.atomic_add(work.volumes, world, HEAPED, heaped)


@functools.cache
def flow_kernel(relief_struct: Any, level: Any) -> Any:
    """Make the kernel for flow of sand on a kind of surface with a `level` (`relief.probe`)."""
    level_at = translated(level)

    @wp.kernel(module="unique", enable_backward=False)
    def flow(
        gravity: wp.array(dtype=wp.vec3),
        surface: relief_struct,
        work: Work,
        first_row: int,
        first_column: int,
    ):
        """Level the steepest triangles of every other square along both axes.

        Sand does not flow over stored heights that belong to another tile.
        """
        world, lane = wp.tid()
        if work.task[world] != FLOWS:
            return
        relief = in_world(surface, world)
        grid, cell, size = relief.state, relief.cell, relief.size
        has_edge = _has_edges(relief)
        up = in_axes(relief, -wp.normalize(gravity[world % gravity.shape[0]]))
        if up[2] <= 0.0:  # gravity pulls out of the sand
            return
        flat_a, flat_b = -up[0] / up[2], -up[1] / up[2]
        half = size // 2
        for n in range(lane, half * half, LANES):
            row, column = 2 * (n // half) + first_row, 2 * (n % half) + first_column
            # The first node follows from which of the two moved.
            i, j = int(0), int(0)
            known = int(0)
            for k in range(4):
                di, dj = k // 2, k % 2
                x, y = wrapped(row + di, size), wrapped(column + dj, size)
                tile = grid.tile[world, x, y]
                if known == 0 and tile != 0:
                    i, j = node_in(tile, x, y, size)
                    i = i - di
                    j = j - dj
                    known = int(1)
            if known == 0:
                continue
            heights = wp.vec4()
            for k in range(4):
                di, dj = k // 2, k % 2
                x, y = wrapped(row + di, size), wrapped(column + dj, size)
                tile = grid.tile[world, x, y]
                u, v = float(i + di) * cell, float(j + dj) * cell
                height = (grid.height[world, x, y] + level_at(relief, u, v)) / cell
                if (
                    work.foot[world, x, y] >= 0
                    or (tile != 0 and tile != tile_of(i + di, j + dj, size))
                    or (has_edge and not _is_sand(relief, u, v))
                ):
                    height = wp.nan
                heights[k] = height
            steepest, corner = float(REST), int(-1)
            for k in range(4):
                di, dj = k // 2, k % 2
                s, t = 1.0 - 2.0 * float(di), 1.0 - 2.0 * float(dj)
                a = _slope_to(heights[k], heights[2 * (1 - di) + dj], s, flat_a)
                b = _slope_to(heights[k], heights[2 * di + 1 - dj], t, flat_b)
                excess = _excess_of(a, b, up, relief.repose)
                if excess > steepest and not wp.isnan(heights[k]):
                    steepest = excess
                    corner = k
            if corner < 0:
                continue
            di, dj = corner // 2, corner % 2
            ahead, beside = 2 * (1 - di) + dj, 2 * di + 1 - dj
            s, t = 1.0 - 2.0 * float(di), 1.0 - 2.0 * float(dj)
            a = _slope_to(heights[corner], heights[ahead], s, flat_a)
            b = _slope_to(heights[corner], heights[beside], t, flat_b)
            s = wp.where(wp.isnan(heights[ahead]), 0.0, s)
            t = wp.where(wp.isnan(heights[beside]), 0.0, t)
            g, h = _gains_of(a, b, up, relief.repose, s, t, work.rate[world])
            gained = wp.vec4()
            gained[corner] = -g - h
            gained[ahead] = g
            gained[beside] = h
            for k in range(4):
                if gained[k] != 0.0:
                    di, dj = k // 2, k % 2
                    x, y = wrapped(row + di, size), wrapped(column + dj, size)
                    claim(relief, work, tile_of(i + di, j + dj, size), x, y)
                    grid.height[world, x, y] += cell * gained[k]

    return flow
