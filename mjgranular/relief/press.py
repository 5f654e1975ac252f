"""Bodies press sand down and deposit it as rims beside them."""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any, NamedTuple

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.fields import rows
from mjgranular.kernel.lanes import all_of, choose
from mjgranular.kernel.memory import row_of, scratch
from mjgranular.kernel.vector import Vector, dot, read_vector
from mjgranular.relief.footprint import LANES
from mjgranular.relief.grid import (
    ACTIVE,
    COVERED,
    HEAPED,
    HEIGHT,
    HIGHEST,
    LISTS,
    UNDER,
    UNMARKED,
    WAITING,
    activate,
    add_height,
    base_at,
    base_beside,
    base_of,
    claim,
    corner_of,
    count_at,
    cover,
    listed_at,
    mark_at,
    node_of,
    own_mark,
    row_at,
    start_of,
    wrapped,
)

LEAST = 0.1
"""Least height that is pressed down at once, relative to the slack, within which force does not
change. Chosen: slowly creeping bodies then update rarely."""

FACES_DOWN = -math.sin(math.radians(1.0))
"""Largest component of a normal along the sand's for which a surface presses sand down: steeper
faces cover no area. Chosen."""


class Skin(NamedTuple):
    """A surface point, as kernels read it (`footprint.POINT_DTYPE`)."""

    point: Vector
    normal: Vector


@partial(compiled, inline=True)
def is_sand(relief, u, v):
    """Return True if a place is within the sand."""
    return abs(u) <= relief.half_along and abs(v) <= relief.half_across


@partial(compiled, inline=True)
def has_edges(relief):
    """Return True if there are places outside the sand."""
    return relief.half_along < math.inf or relief.half_across < math.inf


@partial(compiled, inline=True)
def lowest_of(foot, turn, shift):
    """Return the height of the lowest corner of the box around a body's points over the plane [m].

    The plane's axes in the body frame are `turn`; the frame's position along them is `shift` [m].
    """
    n, half = turn.z, read_vector(foot.half, 0)
    reach = abs(n.x) * half.x + abs(n.y) * half.y + abs(n.z) * half.z
    return dot(n, read_vector(foot.middle, 0)) + shift.z - reach


@partial(compiled, inline=True)
def bottom_of(relief, tile, turn, shift):
    """Return a height over the plane below which no point of a tile is [m]."""
    sphere = row_of(relief.spheres, tile, 4)
    return dot(turn.z, read_vector(sphere, 0)) + shift.z - sphere[3]


@partial(compiled, inline=True)
def skin_at(z, slope_u, slope_v, du, dv, cell):
    """Return the height of a body's surface at an offset from one of its points [m].

    It is that of the tangent plane where that rises; infinite if that is more than a cell higher,
    since nearer points determine the height there.
    """
    rise = max(slope_u * du + slope_v * dv, 0.0)
    return z + rise if rise <= cell else math.inf


@cache
def press_kernel(level: Any, is_flat: bool) -> Any:
    """Make a kernel `press(state, relief, turn, shift, points)`: the volume pressed down [m^3].

    Sand that reaches the surface of a body is pressed down: at the four nodes around a surface
    point, to the height of the point or, where the surface rises beside it, to its tangent plane.
    Upright surfaces press nothing down, nor do those that face upward. The points are one tile,
    `LANES` of them.
    """
    read, write, room = rows(Skin, LANES).read, rows(float, LANES).write, scratch(5 * LANES)

    @compiled
    def press_at(state, relief, z, u, v, slope_u, slope_v):
        """Press at one point, from its position and the slopes of the body's surface there."""
        if not is_sand(relief, u, v):
            return 0.0
        cell, size, blocks = relief.cell, relief.size, relief.blocks
        i, j, _, _ = corner_of(cell, u, v)
        row, column, first = i % size, j % size, base_of(i, j)
        area, volume, heights = cell * cell, 0.0, start_of(size, HEIGHT)
        for di in range(2):
            for dj in range(2):
                x, y = (i + di) * cell, (j + dj) * cell
                skin = skin_at(z, slope_u, slope_v, x - u, y - v, cell) - level(relief, x, y)
                k = wrapped(row + di, size) * size + wrapped(column + dj, size)
                base = base_beside(first, di, dj)
                is_own = own_mark(state, size, k, base) >= 0.0
                height = state[heights + k] if is_own else 0.0
                if not height > skin or not is_sand(relief, x, y):
                    continue
                if not is_own:
                    claim(state, size, blocks, area, k, base)
                cover(state, size, k)
                lowered = height - skin - relief.slack
                if lowered > LEAST * relief.slack:
                    add_height(state, size, blocks, k, -lowered)
                    volume += area * lowered
        return volume

    @compiled
    def press(state, relief, turn, shift, points):
        skin, place = read(points, 0), room()
        z = dot(turn.z, skin.point) + shift.z
        # The axis of a rod has no face; it acts in all directions.
        has_face = dot(skin.normal, skin.normal) > 0.5
        downward = choose(has_face, dot(turn.z, skin.normal), -1.0)
        reach = choose(downward <= FACES_DOWN, z, math.inf)
        highest = state[HIGHEST] if is_flat else math.inf
        if all_of(reach >= highest):
            return 0.0
        write(place, 0, reach)
        write(place, LANES, dot(turn.x, skin.point) + shift.x)
        write(place, 2 * LANES, dot(turn.y, skin.point) + shift.y)
        normal = turn @ skin.normal
        scale = choose(has_face, -1.0 / normal.z, 0.0)
        write(place, 3 * LANES, choose(has_face, scale * normal.x, 0.0))
        write(place, 4 * LANES, choose(has_face, scale * normal.y, 0.0))
        volume = 0.0
        for lane in range(LANES):
            if place[lane] < highest:
                volume += press_at(
                    state,
                    relief,
                    place[lane],
                    place[LANES + lane],
                    place[2 * LANES + lane],
                    place[3 * LANES + lane],
                    place[4 * LANES + lane],
                )
        return volume

    return press


@compiled
def heap(state, relief, first, volume):
    """Deposit sand around a body: each edge node of its track on all nodes within two cells.

    `first` is the first of the listed places under the body, which are the last in the list; the
    volume is in m^3.
    """
    volume += state[WAITING]
    if not volume > 0.0:
        return
    cell, size, blocks, has_edge = relief.cell, relief.size, relief.blocks, has_edges(relief)
    heights, lists, area = start_of(size, HEIGHT), start_of(size, LISTS), cell * cell
    last = count_at(state, size, COVERED)
    # Nodes found are stored between the lists, with space for all of them in the second.
    room, found = (size * size - last - count_at(state, size, ACTIVE)) // 2, 0
    for n in range(first, last):
        k = listed_at(state, size, n)
        row, middle = row_at(size, k), base_at(state, size, k)
        column = k - row * size
        at_edge = False
        for di in range(-1, 2):
            begin = wrapped(row + di, size) * size
            for dj in range(-1, 2):
                q = begin + wrapped(column + dj, size)
                mark = own_mark(state, size, q, base_beside(middle, di, dj))
                at_edge = at_edge or mark < UNDER
        if not at_edge:
            continue
        i, j = node_of(middle)
        for di in range(-2, 3):
            begin = wrapped(row + di, size) * size
            for dj in range(-2, 3):
                q, base = begin + wrapped(column + dj, size), base_beside(middle, di, dj)
                mark = own_mark(state, size, q, base)
                # A place with a body in the last step most likely still has one, if not yet
                # processed.
                if mark >= UNDER or found == room:
                    continue
                if has_edge and not is_sand(relief, (i + di) * cell, (j + dj) * cell):
                    continue
                if mark < 0.0:
                    claim(state, size, blocks, area, q, base)
                state[lists + last + found] = q
                found += 1
    if found == 0:
        state[WAITING] = volume
        return
    share = min(volume / (found * area), cell)  # the rest waits
    for n in range(found):
        q = int(state[lists + last + n])
        add_height(state, size, blocks, q, share)
        state[HIGHEST] = max(state[HIGHEST], state[heights + q])
        if mark_at(state, size, q) == UNMARKED:
            activate(state, size, q)
    state[HEAPED] += found * area * share
    state[WAITING] = volume - found * area * share
