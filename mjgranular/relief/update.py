"""What a step leaves behind: bodies press sand down, it is heaped up beside them, and flows.

Once a step, after the forces of that step, at the places where bodies are then: forces are those
of the sand as the last step has left it. So a force is a function of the state alone, however often
it is asked for.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled, program_address
from mjgranular.kernel.memory import SCENE, XMAT, XPOS, floats, records, table_at
from mjgranular.kernel.options import NO_GRAVITY, options_at
from mjgranular.kernel.vector import dot, read_matrix, read_vector, vector
from mjgranular.relief.footprint import FOOT_DTYPE, POINT_DTYPE
from mjgranular.relief.grid import (
    ACTIVE,
    COVERED,
    FLOWS,
    HEAPED,
    HEIGHT,
    HIGHEST,
    LISTS,
    PRESSED,
    UNDER,
    UNMARKED,
    WAITING,
    add_height,
    corner_of,
    height_at,
    key_at,
    key_of,
    mark_at,
    node_of,
    place_of,
    set_mark,
    start_of,
)
from mjgranular.relief.lists import (
    activate,
    begin_covering,
    claim,
    count_at,
    cover,
    end_covering,
    listed_at,
)
from mjgranular.relief.probe import STEEP, level_kernel, state_length
from mjgranular.relief.relief import Relief
from mjgranular.surface import Surface

_points, _feet = records(POINT_DTYPE), records(FOOT_DTYPE)

_FACES_DOWN = -math.sqrt(1.0 - STEEP * STEEP)  # the normal's part along that of the sand
_REST = 1e-3  # height that may be left over the angle of repose [cells]; chosen
_EIGHT = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))


@partial(compiled, inline=True)
def is_sand(relief, u, v):
    """Tells whether a place is not beside the sand."""
    return abs(u) <= relief.half_along and abs(v) <= relief.half_across


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


@cache
def press_kernel(level: Any) -> Any:
    """Makes a kernel `press(state, relief, turn, shift, point)`: the volume pressed down [m^3].

    It presses the four nodes around a point of the skin down to it and, where the skin rises beside
    it, to its tangent plane. Steep skin presses nothing down, nor does skin that faces upward.

    Args:
        level: see `level_kernel`.
    """

    @compiled
    def press(state, relief, turn, shift, point):
        normal = turn @ read_vector(point.normal, 0)
        has_face = dot(normal, normal) > 0.5
        if has_face and normal.z > _FACES_DOWN:
            return 0.0
        place = turn @ read_vector(point.point, 0) + shift
        u, v, z = place.x, place.y, place.z
        cell, size, blocks = relief.cell, relief.size, relief.blocks
        if not is_sand(relief, u, v):
            return 0.0
        if not z < level(relief, u, v) + height_at(state, size, cell, u, v):
            return 0.0
        slope_u = -normal.x / normal.z if has_face else 0.0
        slope_v = -normal.y / normal.z if has_face else 0.0
        i, j, _, _ = corner_of(cell, u, v)
        area, volume, heights = cell * cell, 0.0, start_of(size, HEIGHT)
        for di in range(2):
            for dj in range(2):
                x, y = (i + di) * cell, (j + dj) * cell
                if not is_sand(relief, x, y):
                    continue
                k = claim(state, size, blocks, area, i + di, j + dj)
                cover(state, size, k)
                rise = max(slope_u * (x - u) + slope_v * (y - v), 0.0)
                skin = z + rise + relief.slack - level(relief, x, y)
                lowered = state[heights + k] - skin
                if lowered > 0.0:
                    add_height(state, size, blocks, i + di, j + dj, -lowered)
                    volume += area * lowered
        return volume

    return press


@compiled
def heap(state, relief, first, volume):
    """Heaps sand up on the nodes around a body, as much on each; without any it waits.

    Args:
        state: of the simulation.
        relief: record of the surface.
        first: of the listed places that lie under the body, the last of all.
        volume: of the sand [m^3].
    """
    volume += state[WAITING]
    if not volume > 0.0:
        return
    cell, size, blocks = relief.cell, relief.size, relief.blocks
    last, heights = count_at(state, size, COVERED), start_of(size, HEIGHT)
    share = 0.0
    for turn in range(2):  # once to count them, once to heap up
        count = 0
        for n in range(first, last):
            i, j = node_of(key_at(state, size, listed_at(state, size, n)))
            for di, dj in _EIGHT:
                a, b = i + di, j + dj
                k = place_of(size, a, b)
                if not is_sand(relief, a * cell, b * cell):
                    continue
                if key_at(state, size, k) == key_of(a, b) and mark_at(state, size, k) == UNDER:
                    continue
                count += 1
                if turn == 1:
                    k = claim(state, size, blocks, cell * cell, a, b)
                    add_height(state, size, blocks, a, b, share)
                    state[HIGHEST] = max(state[HIGHEST], state[heights + k])
                    activate(state, size, k)
        if count == 0:
            state[WAITING] = volume
            return
        share = volume / (count * cell * cell)
    state[HEAPED] += volume
    state[WAITING] = 0.0


@cache
def flow_kernel(level: Any) -> Any:
    """Makes a kernel `flow(state, relief, rate)`: sand flows down where it is too steep.

    Two neighbours whose slope is steeper than repose exchange `rate` of a quarter of the excess;
    from and to a node under a body nothing flows.

    Args:
        level: see `level_kernel`.
    """

    @compiled
    def flow(state, relief, rate):
        cell, size, blocks, tangent = relief.cell, relief.size, relief.blocks, relief.repose
        heights, lists = start_of(size, HEIGHT), start_of(size, LISTS)
        end = lists + size * size - 1  # where the list of active places begins, backwards
        area, steeper = cell * cell, tangent * tangent
        # What is up along the axes of the plane.
        up = vector(relief.along[2], relief.across[2], relief.normal[2])
        count, kept = count_at(state, size, ACTIVE), 0
        for n in range(count):
            k = listed_at(state, size, size * size - 1 - n)
            if mark_at(state, size, k) != FLOWS:
                continue
            i, j = node_of(key_at(state, size, k))
            base, moved = level(relief, i * cell, j * cell), False
            for di, dj in _EIGHT:
                a, b = i + di, j + dj
                if not is_sand(relief, a * cell, b * cell):
                    continue
                q = place_of(size, a, b)
                owned = key_at(state, size, q) == key_of(a, b)
                if owned and mark_at(state, size, q) == UNDER:
                    continue
                other = level(relief, a * cell, b * cell) - base
                other += (state[heights + q] if owned else 0.0) - state[heights + k]
                away = vector(di * cell, dj * cell, other)
                rise = dot(up, away)
                run = dot(away, away) - rise * rise
                if not rise * rise > steeper * run:
                    continue
                excess = abs(rise) - tangent * math.sqrt(max(run, 0.0))
                if excess > _REST * cell:
                    moved = True
                    q = claim(state, size, blocks, area, a, b)
                    amount = math.copysign(0.25 * rate * excess, rise)
                    add_height(state, size, blocks, i, j, amount)
                    add_height(state, size, blocks, a, b, -amount)
                    higher = max(state[heights + q], state[heights + k])
                    state[HIGHEST] = max(state[HIGHEST], higher)
                    activate(state, size, q)
            if moved:
                state[end - kept] = k
                kept += 1
            else:
                set_mark(state, size, k, UNMARKED)
        # Those that were activated on the way stand behind.
        for n in range(count, count_at(state, size, ACTIVE)):
            state[end - kept] = state[end - n]
            kept += 1
        state[ACTIVE] = 1.0 * kept

    return flow


@cache
def update_kernel(probe: Any, is_flat: bool, scene_dtype: np.dtype) -> Any:
    """Makes the program `update(table, lead)`: 1 if done.

    Args:
        probe: of the surface without memory.
        is_flat: whether it is plane where it is.
        scene_dtype: record of law and surface.
    """
    level, scene_records = level_kernel(probe, is_flat), records(scene_dtype)
    press, flow = press_kernel(level), flow_kernel(level)

    @compiled
    def update(address, lead):
        table = table_at(address)
        relief = scene_records(table[SCENE], 1)[0].surface
        size = relief.size
        state = floats(relief.state, state_length(size))
        feet = _feet(relief.feet, relief.foot_count)
        points = _points(relief.points, feet[len(feet) - 1].end)
        origin = read_vector(relief.origin, 0)
        axes = vector(
            read_vector(relief.along, 0), read_vector(relief.across, 0),
            read_vector(relief.normal, 0),
        )  # fmt: skip
        before = begin_covering(state, size)
        begin = 0
        for number in range(len(feet)):
            foot = feet[number]
            turn = axes @ read_matrix(floats(table[XMAT] + 72 * foot.body, 9), 0)
            shift = axes @ (read_vector(floats(table[XPOS] + 24 * foot.body, 3), 0) - origin)
            if not is_flat or lowest_of(foot, turn, shift) < state[HIGHEST]:
                first, volume = count_at(state, size, COVERED), 0.0
                for n in range(begin, foot.end):
                    volume += press(state, relief, turn, shift, points[n])
                state[PRESSED] += volume
                heap(state, relief, first, relief.bulking * volume)
            begin = foot.end
        end_covering(state, size, before)
        options = options_at(table)
        g = options.gravity
        g = 0.0 if options.disableflags & NO_GRAVITY else math.sqrt(
            g[0] * g[0] + g[1] * g[1] + g[2] * g[2]
        )  # fmt: skip
        flow(state, relief, min(options.timestep * math.sqrt(g / relief.cell), 1.0))
        return 1

    return update


def update_program(surface: Surface, scene_dtype: np.dtype) -> int:
    """The address of the program that updates a relief; 0 for a surface without memory.

    Args:
        surface: the surface.
        scene_dtype: record of law and surface.
    """
    if not isinstance(surface, Relief):
        return 0
    update = update_kernel(type(surface.base).probe, surface.is_flat, scene_dtype)
    return program_address(update, "int64(int64, float64)", f"memory, {surface.base}")
