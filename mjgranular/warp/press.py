"""Surface points of bodies press sand down in each world."""

# Kernels are written in Warp's language, which Python type checkers do not understand.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportIndexIssue=false
# pyright: reportAttributeAccessIssue=false, reportAssignmentType=false

# No `from __future__ import annotations`: Warp reads the types of local structs in place.
import functools
from typing import Any

import numpy as np
import warp as wp

from mjgranular.relief.press import FACES_DOWN, LEAST, is_sand, skin_at
from mjgranular.warp.grid import corner_of, height_of_node, in_world, wrapped
from mjgranular.warp.records import PlainRelief
from mjgranular.warp.structs import struct
from mjgranular.warp.translate import translated
from mjgranular.warp.update import (
    BEGINS,
    IDLE,
    LANES,
    LEFT,
    MOST_FEET,
    NOTHING,
    PRESSED,
    PRESSES,
    claim,
    tile_beside,
)

Skin = struct("SkinPoint", {"foot": int, "body": int, "point": wp.vec3, "normal": wp.vec3})
"""A surface point of a body, body frame; points on the axis of a rod have no normal."""

# Requested heights are compared as integers with the contact geom's index in the low digits, so the
# lowest wins in any order of threads. A nanometer is finer than single precision resolves.
_NANOMETRES = 1e9
UNWANTED = np.iinfo(np.int64).max
"""Value of a node that no contact geom presses down."""

_UNWANTED = wp.constant(wp.int64(UNWANTED))
_is_sand, _skin_at = translated(is_sand), translated(skin_at)


@wp.func
def place_of(relief: Any, position: wp.vec3):
    """Return a point along the axes of the plane under the heights [m]."""
    place = position - relief.origin
    return wp.vec3(
        wp.dot(place, relief.along), wp.dot(place, relief.across), wp.dot(place, relief.normal)
    )


@functools.cache
def press_kernel(relief_struct: Any, level: Any) -> Any:
    """Make the kernel in which points request heights, for a surface with that `level`."""
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
        """Let each surface point request lower heights at the four nodes around it."""
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
                    low = _skin_at(place[2], slope_u, slope_v, x - u, y - v, cell)
                    low = low - level_at(relief, x, y)
                    there = height_of_node(relief.state, size, i + di, j + dj)
                    if low < there and _is_sand(relief, x, y):
                        number = wp.int64(wp.float64(low) * wp.float64(_NANOMETRES))
                        number = number * wp.int64(MOST_FEET) + wp.int64(each.foot)
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
    """Press nodes down to the requested heights; clear everything where a world restarts."""
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
        # Integer modulo that rounds down for either sign.
        f = int(((number % wp.int64(MOST_FEET)) + wp.int64(MOST_FEET)) % wp.int64(MOST_FEET))
        low = float(
            wp.float64((number - wp.int64(f)) // wp.int64(MOST_FEET)) / wp.float64(_NANOMETRES)
        )
        claim(relief, tile_beside(places[world, f], row, column, cell, size), row, column, volumes)
        foot[world, row, column] = f
        lowered = grid.height[world, row, column] - low - relief.slack
        if lowered > LEAST * relief.slack:
            grid.height[world, row, column] -= lowered
            volume = cell * cell * lowered
            wp.atomic_add(waiting, world, f, relief.bulking * volume)
            wp.atomic_add(volumes, world, PRESSED, volume)
