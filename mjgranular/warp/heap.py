"""Displaced sand is deposited as rims beside tracks, in each world."""

# Kernels are written in Warp's language, which Python type checkers do not understand.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportIndexIssue=false
# pyright: reportAttributeAccessIssue=false, reportAssignmentType=false

# No `from __future__ import annotations`: Warp reads the types of local structs in place.
import warp as wp

from mjgranular.relief.press import has_edges, is_sand
from mjgranular.warp.grid import in_world, node_in, wrapped
from mjgranular.warp.records import PlainRelief
from mjgranular.warp.translate import translated
from mjgranular.warp.update import (
    BESIDE,
    HEAPED,
    LANES,
    MOST_FEET,
    NOTHING,
    PRESSES,
    claim,
    tile_beside,
)

_NEAR = 32  # more than the number of edge nodes within two cells
_is_sand, _has_edges = translated(is_sand), translated(has_edges)


@wp.func
def share_of(volume: float, count: int, cell: float):
    """Return the height of one of `count` equal parts of a volume [m], at most one cell."""
    return wp.min(volume / (float(count) * cell * cell), cell)


@wp.kernel(enable_backward=False)
def edge(surface: PlainRelief, task: wp.array(dtype=int), foot: wp.array3d(dtype=int)):
    """Find the track nodes that have sand beside them."""
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
            foot[world, row, column] += MOST_FEET


@wp.kernel(enable_backward=False)
def surround(
    surface: PlainRelief,
    task: wp.array(dtype=int),
    places: wp.array2d(dtype=wp.vec3),
    foot: wp.array3d(dtype=int),
    waiting: wp.array2d(dtype=float),
    count: wp.array2d(dtype=int),
):
    """Find the nodes within two cells of a track's edge; the nearest of several tracks counts."""
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
                f = foot[world, wrapped(row + di, size), wrapped(column + dj, size)] - MOST_FEET
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
                f = foot[world, wrapped(row + di, size), wrapped(column + dj, size)] - MOST_FEET
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
    """Deposit sand beside tracks."""
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
    """Keep volume that did not fit beside a track for later steps."""
    world, f = wp.tid()
    if task[world] < PRESSES or count[world, f] == 0:
        return
    cell, found = surface.cell, count[world, f]
    heaped = cell * cell * float(found) * share_of(waiting[world, f], found, cell)
    waiting[world, f] -= heaped
    wp.atomic_add(volumes, world, HEAPED, heaped)
