"""Bodies press sand down and heap it up beside them."""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any, NamedTuple

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.fields import rows
from mjgranular.kernel.lanes import all_of, choose
from mjgranular.kernel.memory import scratch
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
    add_height,
    base_at,
    base_beside,
    base_of,
    corner_of,
    mark_at,
    node_of,
    own_mark,
    row_at,
    start_of,
    wrapped,
)
from mjgranular.relief.lists import activate, claim, count_at, cover, listed_at

LEAST = 0.1
"""Least height that is pressed down at once, in parts of the slack, within which force does not
change. Chosen: who creeps heaps up seldom."""

FACES_DOWN = -math.sin(math.radians(1.0))
"""The part of a normal along that of the sand, at most, of skin that presses sand down: what is
closer to upright covers none. Chosen."""


class Skin(NamedTuple):
    """A point of the skin, as kernels read it (`footprint.POINT_DTYPE`)."""

    point: Vector
    normal: Vector


@partial(compiled, inline=True)
def is_sand(relief, u, v):
    """Tells whether a place is not beside the sand."""
    return abs(u) <= relief.half_along and abs(v) <= relief.half_across


@partial(compiled, inline=True)
def has_edges(relief):
    """Tells whether there are places beside the sand."""
    return relief.half_along < math.inf or relief.half_across < math.inf


@partial(compiled, inline=True)
def lowest_of(foot, turn, shift):
    """Height of the lowest corner of the box around a body's skin over the plane [m].

    Args:
        foot: record of `FOOT_DTYPE`.
        turn: axes of the plane in the body's frame, a matrix.
        shift: place of the body's frame along them [m].
    """
    n, half = turn.z, read_vector(foot.half, 0)
    reach = abs(n.x) * half.x + abs(n.y) * half.y + abs(n.z) * half.z
    return dot(n, read_vector(foot.middle, 0)) + shift.z - reach


@partial(compiled, inline=True)
def skin_at(z, slope_u, slope_v, du, dv, cell):
    """Height of the skin so far beside a point of it [m]: its tangent plane's, where that rises.

    Nothing, at infinity, where that is more than a cell higher: nearer points show what is there.
    """
    rise = max(slope_u * du + slope_v * dv, 0.0)
    return z + rise if rise <= cell else math.inf


@cache
def press_kernel(level: Any, is_flat: bool) -> Any:
    """Makes a kernel `press(state, relief, turn, shift, points)`: the volume pressed down [m^3].

    Where sand reaches the skin it is pressed down: at the four nodes around a point of it, to the
    height of the point or, where the skin rises beside it, to its tangent plane. Upright skin
    presses nothing down, nor does skin that faces upward. The points are one tile, `LANES` of them.

    Args:
        level: see `level_kernel`.
        is_flat: whether the surface is plane where it is.
    """
    read, write, room = rows(Skin, LANES).read, rows(float, LANES).write, scratch(5 * LANES)

    @compiled
    def press_at(state, relief, z, u, v, slope_u, slope_v):
        """Presses at one point: its place, and the slopes of the skin there."""
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
        # The axis of a rod has no face, and faces anywhere.
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
    """Heaps sand up around a body: each node at the edge of its print on all within two cells.

    Args:
        state: of the simulation.
        relief: record of the surface.
        first: of the listed places that lie under the body, the last of all.
        volume: of the sand [m^3].
    """
    volume += state[WAITING]
    if not volume > 0.0:
        return
    cell, size, blocks, has_edge = relief.cell, relief.size, relief.blocks, has_edges(relief)
    heights, lists, area = start_of(size, HEIGHT), start_of(size, LISTS), cell * cell
    last = count_at(state, size, COVERED)
    # What is found is written down between the lists, with room for all of it in the second.
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
                # Where a body was in the last step it most likely is, if not yet seen to.
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
