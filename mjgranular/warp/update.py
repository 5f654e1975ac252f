"""What a step leaves behind in each world: sand is pressed down, heaped up, and flows.

The rules are those of `relief.update`, their formulas the same source; what differs is that all
nodes are seen to at once. Skin that wants a node down leaves its height there, and the lowest
wins; each node beside a print takes its share of what the nearest body has displaced; and sand
flows between pairs of neighbours, one direction after the other, so that no two pairs share a node.

`LANES` threads of each world go over its points or nodes, at once or not: a world that has
nothing to do costs next to nothing.
"""

# The code of kernels is Warp's language, of which type checkers of Python know little.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportIndexIssue=false
# pyright: reportAttributeAccessIssue=false

# Without `annotations` of the future: Warp reads types of local structs where they stand.
import functools
from typing import Any

import numpy as np
import warp as wp

from mjgranular.relief.flow import REST, exchanged
from mjgranular.relief.press import FACES_DOWN, LEAST, has_edges, is_sand, skin_at
from mjgranular.relief.update import FASTEST, FLOWS_AFTER, PRESSED_AFTER
from mjgranular.warp.grid import (
    corner_of,
    height_of_node,
    in_world,
    node_in,
    tile_of,
    wrapped,
)
from mjgranular.warp.records import PlainRelief
from mjgranular.warp.structs import struct
from mjgranular.warp.translate import translated

LANES = 256
"""Threads of a world. Chosen."""

DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""To a node's neighbours; the other four are their opposites."""

IDLE, BEGINS, PRESSES, FLOWS = range(4)
"""What a world does in a step; who flows also presses."""

NOTHING, LEFT, BESIDE = -1, -2, -3
"""At a node there is no foot; one has just left; from here down, nodes beside prints, by foot and
by how many nodes at the print's edge they are near. Above are feet, at edges `MOST_FEET` more."""

Skin = struct("SkinPoint", {"foot": int, "body": int, "point": wp.vec3, "normal": wp.vec3})
"""A point of the skin, body frame; of the axis of a rod without a normal."""

# Heights that skin wants are compared as whole numbers, with the foot's number behind: the lowest
# foot's is found in any order. A nanometre is finer than single precision tells.
_NANOMETRES, _FEET = 1e9, 1 << 12
MOST_FEET = _FEET
UNWANTED = np.iinfo(np.int64).max
_UNWANTED = wp.constant(wp.int64(UNWANTED))

_NEAR = 32  # more than there are nodes at an edge within two cells

PRESSED, HEAPED, FORGOTTEN = range(3)
"""Volumes of each world [m^3]."""

_is_sand, _has_edges = translated(is_sand), translated(has_edges)
_skin_at, _exchanged = translated(skin_at), translated(exchanged)


@wp.func
def place_of(relief: Any, position: wp.vec3):
    """A point along the axes of the plane that heights are over [m]."""
    place = position - relief.origin
    return wp.vec3(
        wp.dot(place, relief.along), wp.dot(place, relief.across), wp.dot(place, relief.normal)
    )


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


@wp.func
def share_of(volume: float, count: int, cell: float):
    """Height of so many equal parts of a volume, each on a node [m]; the rest waits."""
    return wp.min(volume / (float(count) * cell * cell), cell)


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


@functools.cache
def press_kernel(relief_struct: Any, level: Any) -> Any:
    """Makes the kernel by which skin wants nodes down, for surfaces of a kind.

    Args:
        relief_struct: struct of the surface.
        level: kernel, see `relief.probe.level_kernel`.
    """
    level_at = translated(level)

    @wp.kernel(module="unique", enable_backward=False)
    def press(
        surface: relief_struct,
        skin: wp.array(dtype=Skin),
        task: wp.array(dtype=int),
        height: wp.array(dtype=float),
        up: wp.vec3,
        xpos: wp.array2d(dtype=wp.vec3),
        xmat: wp.array2d(dtype=wp.mat33),
        wanted: wp.array3d(dtype=wp.int64),
        places: wp.array2d(dtype=wp.vec3),
    ):
        """Has each point of the skin want the four nodes around it down."""
        world, lane = wp.tid()
        if task[world] < PRESSES:
            return
        relief = in_world(surface, world)
        cell, size = relief.cell, relief.size
        lift = height[world % height.shape[0]] * up
        for n in range(lane, skin.shape[0], LANES):
            each = skin[n]
            turn, origin = xmat[world, each.body], xpos[world, each.body] - lift
            place = place_of(relief, origin + turn * each.point)
            places[world, each.foot] = place
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
                    low = _skin_at(place[2], slope_u, slope_v, x - u, y - v)
                    low = low - level_at(relief, x, y)
                    there = height_of_node(relief.state, size, i + di, j + dj)
                    if low < there and _is_sand(relief, x, y):
                        number = wp.int64(wp.float64(low) * wp.float64(_NANOMETRES))
                        number = number * wp.int64(_FEET) + wp.int64(each.foot)
                        row, column = wrapped(i + di, size), wrapped(j + dj, size)
                        wp.atomic_min(wanted, world, row, column, number)

    return press


@wp.kernel(enable_backward=False)
def settle(
    surface: PlainRelief,
    task: wp.array(dtype=int),
    places: wp.array2d(dtype=wp.vec3),
    foot: wp.array3d(dtype=int),
    wanted: wp.array3d(dtype=wp.int64),
    waiting: wp.array2d(dtype=float),
    volumes: wp.array2d(dtype=float),
):
    """Presses nodes down as far as skin wants them; forgets all where a world begins anew."""
    world, lane = wp.tid()
    if task[world] == IDLE:
        return
    relief = in_world(surface, world)
    grid, cell, size = relief.state, relief.cell, relief.size
    for n in range(lane, size * size, LANES):
        row = n // size
        column = n - row * size
        number = wanted[world, row, column]
        foot[world, row, column] = wp.where(foot[world, row, column] >= 0, LEFT, NOTHING)
        if task[world] == BEGINS:
            grid.height[world, row, column] = 0.0
            grid.tile[world, row, column] = 0
        if number == _UNWANTED:
            continue
        wanted[world, row, column] = _UNWANTED
        # Whole numbers are divided downward, whatever their sign.
        f = int(((number % wp.int64(_FEET)) + wp.int64(_FEET)) % wp.int64(_FEET))
        low = float(wp.float64((number - wp.int64(f)) // wp.int64(_FEET)) / wp.float64(_NANOMETRES))
        claim(relief, tile_beside(places[world, f], row, column, cell, size), row, column, volumes)
        foot[world, row, column] = f
        lowered = grid.height[world, row, column] - low - relief.slack
        if lowered > LEAST * relief.slack:
            grid.height[world, row, column] -= lowered
            volume = cell * cell * lowered
            wp.atomic_add(waiting, world, f, relief.bulking * volume)
            wp.atomic_add(volumes, world, PRESSED, volume)


@wp.kernel(enable_backward=False)
def edge(surface: PlainRelief, task: wp.array(dtype=int), foot: wp.array3d(dtype=int)):
    """Finds the nodes of prints that have sand beside them."""
    world, lane = wp.tid()
    if task[world] < PRESSES:
        return
    size = surface.size
    for n in range(lane, size * size, LANES):
        row = n // size
        column = n - row * size
        if foot[world, row, column] < 0:
            continue
        has_sand = int(0)
        for di in range(-1, 2):
            for dj in range(-1, 2):
                if foot[world, wrapped(row + di, size), wrapped(column + dj, size)] == NOTHING:
                    has_sand = int(1)
        if has_sand == 1:
            foot[world, row, column] += _FEET


@wp.kernel(enable_backward=False)
def surround(
    surface: PlainRelief,
    task: wp.array(dtype=int),
    places: wp.array2d(dtype=wp.vec3),
    foot: wp.array3d(dtype=int),
    waiting: wp.array2d(dtype=float),
    count: wp.array2d(dtype=int),
):
    """Finds the nodes within two cells of a print's edge: of the nearest of several prints."""
    world, lane = wp.tid()
    if task[world] < PRESSES:
        return
    relief = in_world(surface, world)
    cell, size = relief.cell, relief.size
    has_edge = _has_edges(relief)
    for n in range(lane, size * size, LANES):
        row = n // size
        column = n - row * size
        if foot[world, row, column] != NOTHING:
            continue
        nearest, found = int(9), int(NOTHING)
        for di in range(-2, 3):
            for dj in range(-2, 3):
                f = foot[world, wrapped(row + di, size), wrapped(column + dj, size)] - _FEET
                far = di * di + dj * dj
                if f >= 0 and (far < nearest or (far == nearest and f < found)):
                    nearest = far
                    found = f
        if found < 0:
            continue
        if not (waiting[world, found] > 0.0):
            continue
        near = int(0)
        for di in range(-2, 3):
            for dj in range(-2, 3):
                f = foot[world, wrapped(row + di, size), wrapped(column + dj, size)] - _FEET
                near += wp.where(f == found, 1, 0)
        if has_edge:
            tile = tile_beside(places[world, found], row, column, cell, size)
            i, j = node_in(tile, row, column, size)
            if not _is_sand(relief, float(i) * cell, float(j) * cell):
                continue
        foot[world, row, column] = BESIDE - (found * _NEAR + near)
        wp.atomic_add(count, world, found, near)


@wp.kernel(enable_backward=False)
def heap(
    surface: PlainRelief,
    task: wp.array(dtype=int),
    places: wp.array2d(dtype=wp.vec3),
    foot: wp.array3d(dtype=int),
    waiting: wp.array2d(dtype=float),
    count: wp.array2d(dtype=int),
    volumes: wp.array2d(dtype=float),
):
    """Heaps sand up beside prints."""
    world, lane = wp.tid()
    if task[world] < PRESSES:
        return
    relief = in_world(surface, world)
    grid, cell, size = relief.state, relief.cell, relief.size
    for n in range(lane, size * size, LANES):
        row = n // size
        column = n - row * size
        code = BESIDE - foot[world, row, column]
        if code < 0:
            continue
        f = code // _NEAR
        claim(relief, tile_beside(places[world, f], row, column, cell, size), row, column, volumes)
        share = share_of(waiting[world, f], count[world, f], cell)
        grid.height[world, row, column] += float(code % _NEAR) * share


@wp.kernel(enable_backward=False)
def keep(
    surface: PlainRelief,
    task: wp.array(dtype=int),
    waiting: wp.array2d(dtype=float),
    count: wp.array2d(dtype=int),
    volumes: wp.array2d(dtype=float),
):
    """Keeps what has found no room beside a print for later."""
    world, f = wp.tid()
    if task[world] < PRESSES or count[world, f] == 0:
        return
    cell, found = surface.cell, count[world, f]
    heaped = cell * cell * float(found) * share_of(waiting[world, f], found, cell)
    waiting[world, f] -= heaped
    wp.atomic_add(volumes, world, HEAPED, heaped)


@functools.cache
def flow_kernel(relief_struct: Any, level: Any) -> Any:
    """Makes the kernel by which sand flows, for surfaces of a kind.

    Args:
        relief_struct: struct of the surface.
        level: kernel, see `relief.probe.level_kernel`.
    """
    level_at = translated(level)

    @wp.kernel(module="unique", enable_backward=False)
    def flow(
        surface: relief_struct,
        task: wp.array(dtype=int),
        rate: wp.array(dtype=float),
        foot: wp.array3d(dtype=int),
        di: int,
        dj: int,
        parity: int,
        volumes: wp.array2d(dtype=float),
    ):
        """Has sand flow between nodes and their neighbours in a direction, every other pair.

        It does not flow over what is remembered of a place that lies a tile away.
        """
        world, lane = wp.tid()
        if task[world] != FLOWS:
            return
        relief = in_world(surface, world)
        grid, cell, size = relief.state, relief.cell, relief.size
        has_edge = _has_edges(relief)
        up = wp.vec3(relief.along[2], relief.across[2], relief.normal[2])
        for n in range(lane, size * size // 2, LANES):
            # Of rows, or along a row of columns, those of one parity begin a pair.
            row = wp.where(di == 1, 2 * (n // size) + parity, n // (size // 2))
            column = wp.where(di == 1, n % size, 2 * (n % (size // 2)) + parity)
            other_row, other_column = wrapped(row + di, size), wrapped(column + dj, size)
            tile = grid.tile[world, row, column]
            other_tile = grid.tile[world, other_row, other_column]
            if tile == 0 and other_tile == 0:
                continue
            if foot[world, row, column] >= 0 or foot[world, other_row, other_column] >= 0:
                continue
            # One of the two may not have been moved yet; not both belong to what lies farther off.
            if tile != 0:
                i, j = node_in(tile, row, column, size)
                beside = tile_of(i + di, j + dj, size)
                if other_tile != beside and other_tile != 0:
                    continue
                other_tile = beside
            else:
                k, m = node_in(other_tile, other_row, other_column, size)
                tile = tile_of(k - di, m - dj, size)
            i, j = node_in(tile, row, column, size)
            x, y = float(i) * cell, float(j) * cell
            far_x, far_y = float(i + di) * cell, float(j + dj) * cell
            higher = grid.height[world, other_row, other_column] - grid.height[world, row, column]
            higher += level_at(relief, far_x, far_y) - level_at(relief, x, y)
            rise = (up[0] * float(di) + up[1] * float(dj)) * cell + up[2] * higher
            run = float(di * di + dj * dj) * cell * cell + higher * higher - rise * rise
            amount = _exchanged(rise, run, relief.repose, REST * cell, rate[world])
            if amount == 0.0:
                continue
            if has_edge and not (_is_sand(relief, x, y) and _is_sand(relief, far_x, far_y)):
                continue
            claim(relief, tile, row, column, volumes)
            claim(relief, other_tile, other_row, other_column, volumes)
            grid.height[world, row, column] += amount
            grid.height[world, other_row, other_column] -= amount

    return flow


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
