"""What a step leaves behind: bodies press sand down, it is heaped up beside them, and flows.

Once a step, after the forces of that step, at the places where bodies are then: forces are those
of the sand as the last step has left it. So a force is a function of the state alone, however often
it is asked for.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled, program_address
from mjgranular.kernel.memory import SCENE, XMAT, XPOS, floats, records, table_at
from mjgranular.kernel.options import options_at
from mjgranular.kernel.vector import dot, read_matrix, read_vector, vector
from mjgranular.relief.grid import (
    ACTIVE,
    ACTIVE_LIST,
    COVERED,
    COVERED_LIST,
    FLOWS,
    FORGOTTEN,
    HEAPED,
    HEIGHT,
    HIGHEST,
    KEY,
    LIES_UNDER,
    MARK,
    PRESSED,
    UNMARKED,
    WAITING,
    add_height,
    corner_of,
    height_at,
    key_of,
    node_of,
    place_of,
    start_of,
)
from mjgranular.relief.probe import STEEP, Relief, level_kernel, state_length

FOOTPRINT_DTYPE = np.dtype(
    [
        ("point", np.float64, (3,)),  # of the skin [m], body frame
        ("normal", np.float64, (3,)),  # unit, outward; zero for one that has none
    ]
)
FOOT_DTYPE = np.dtype(
    [
        ("body", np.int64),
        ("end", np.int64),  # one past its last point
        ("reach", np.float64),  # of its points from the origin of its frame [m]
    ]
)
_points, _feet = records(FOOTPRINT_DTYPE), records(FOOT_DTYPE)

_STEEPEST = 1.0  # of the skin that a point stands for, between nodes; that of STEEP
_REST = 1e-3  # height that may be left over the angle of repose [cells]; chosen
_EIGHT = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))


@compiled
def claim(state, size, blocks, area, i, j):
    """The place of a node, which is its own from now on: what was there is forgotten."""
    k = place_of(size, i, j)
    keys, key = start_of(size, KEY), key_of(i, j)
    if state[keys + k] != key:
        heights = start_of(size, HEIGHT)
        state[FORGOTTEN] += area * state[heights + k]
        add_height(state, size, blocks, i, j, -state[heights + k])
        state[heights + k] = 0.0
        state[keys + k] = key
    return k


@compiled
def activate(state, size, k):
    """Has sand flow at a place."""
    mark = start_of(size, MARK) + k
    if state[mark] == UNMARKED:
        count = int(state[ACTIVE])
        state[start_of(size, ACTIVE_LIST) + count] = k
        state[ACTIVE] = count + 1.0
        state[mark] = FLOWS


@compiled
def is_under(state, size, k):
    """Tells whether a place lies under a body."""
    return state[start_of(size, MARK) + k] >= LIES_UNDER


@compiled
def uncover(state, size):
    """Takes the marks of all places under bodies; sand may flow there."""
    marks = start_of(size, MARK)
    covered = start_of(size, COVERED_LIST)
    for n in range(int(state[COVERED])):
        k = int(state[covered + n])
        was_active = state[marks + k] == LIES_UNDER + FLOWS
        state[marks + k] = FLOWS if was_active else UNMARKED
        activate(state, size, k)
    state[COVERED] = 0.0


@compiled
def press_node(state, size, blocks, area, i, j, target):
    """Marks a node as under a body, and presses it down to a height; gives the volume."""
    k = claim(state, size, blocks, area, i, j)
    heights, mark = start_of(size, HEIGHT), start_of(size, MARK) + k
    if state[mark] < LIES_UNDER:
        count = int(state[COVERED])
        state[start_of(size, COVERED_LIST) + count] = k
        state[COVERED] = count + 1.0
        state[mark] += LIES_UNDER
    lowered = state[heights + k] - target
    if not lowered > 0.0:
        return 0.0
    add_height(state, size, blocks, i, j, -lowered)
    return area * lowered


@cache
def update_kernel(probe: Any, is_plane: bool, scene_dtype: np.dtype) -> Any:
    """Makes the program `update(table)`: 1 if done.

    Args:
        probe: of the surface without memory.
        is_plane: whether it is plane where it is.
        scene_dtype: record of law and surface.
    """
    level, scene_records = level_kernel(probe, is_plane), records(scene_dtype)

    @compiled
    def press(state, relief, position, rotation, point):
        """Presses the nodes around a point of the skin down; the volume [m^3]."""
        cell, size, blocks = relief.cell, relief.size, relief.blocks
        n = read_vector(relief.normal, 0)
        along, across = read_vector(relief.along, 0), read_vector(relief.across, 0)
        place = position + rotation @ read_vector(point.point, 0)
        place = place - read_vector(relief.origin, 0)
        u, v, z = dot(place, along), dot(place, across), dot(place, n)
        if not (abs(u) <= relief.half_along and abs(v) <= relief.half_across):
            return 0.0
        height = height_at(state, size, cell, u, v)
        if not z < level(relief, u, v) + height:
            return 0.0
        outward = rotation @ read_vector(point.normal, 0)
        down = dot(outward, n)
        slope_u, slope_v = 0.0, 0.0
        if dot(outward, outward) > 0.5:
            if down * down < 1.0 - STEEP * STEEP or down > 0.0:
                return 0.0
            slope_u, slope_v = -dot(outward, along) / down, -dot(outward, across) / down
        i, j, _, _ = corner_of(cell, u, v)
        area, volume = cell * cell, 0.0
        for di in range(2):
            for dj in range(2):
                x, y = (i + di) * cell, (j + dj) * cell
                if abs(x) <= relief.half_along and abs(y) <= relief.half_across:
                    skin = z + slope_u * (x - u) + slope_v * (y - v) + relief.slack
                    volume += press_node(
                        state, size, blocks, area, i + di, j + dj, skin - level(relief, x, y)
                    )
        return volume

    @compiled
    def heap(state, relief, first, volume):
        """Heaps up what a body has displaced on the nodes around it, as much on each."""
        cell, size, blocks = relief.cell, relief.size, relief.blocks
        heights, keys = start_of(size, HEIGHT), start_of(size, KEY)
        covered, last = start_of(size, COVERED_LIST), int(state[COVERED])
        volume += state[WAITING]
        state[WAITING] = 0.0
        if not volume > 0.0:
            return
        share = 0.0
        for turn in range(2):
            count = 0
            for m in range(first, last):
                i, j = node_of(state[keys + int(state[covered + m])])
                for di, dj in _EIGHT:
                    a, b = i + di, j + dj
                    u, v = a * cell, b * cell
                    if not (abs(u) <= relief.half_along and abs(v) <= relief.half_across):
                        continue
                    k = place_of(size, a, b)
                    if state[keys + k] == key_of(a, b) and is_under(state, size, k):
                        continue
                    count += 1
                    if turn == 1:
                        k = claim(state, size, blocks, cell * cell, a, b)
                        add_height(state, size, blocks, a, b, share)
                        state[HIGHEST] = max(state[HIGHEST], state[heights + k])
                        activate(state, size, k)
            if count == 0:
                state[WAITING] += volume
                return
            share = volume / (count * cell * cell)
        state[HEAPED] += volume

    @compiled
    def flow(state, relief, rate):
        """Has sand flow down between neighbours that are steeper than repose."""
        cell, size, blocks = relief.cell, relief.size, relief.blocks
        heights, keys, marks = start_of(size, HEIGHT), start_of(size, KEY), start_of(size, MARK)
        active = start_of(size, ACTIVE_LIST)
        up = vector(
            read_vector(relief.along, 0).z, read_vector(relief.across, 0).z,
            read_vector(relief.normal, 0).z,
        )  # fmt: skip
        count = int(state[ACTIVE])
        kept = 0
        for m in range(count):
            k = int(state[active + m])
            i, j = node_of(state[keys + k])
            moved = False
            if not is_under(state, size, k):
                base = level(relief, i * cell, j * cell)
                for di, dj in _EIGHT:
                    a, b = i + di, j + dj
                    u, v = a * cell, b * cell
                    if not (abs(u) <= relief.half_along and abs(v) <= relief.half_across):
                        continue
                    q = place_of(size, a, b)
                    owned = state[keys + q] == key_of(a, b)
                    if owned and is_under(state, size, q):
                        continue
                    other = level(relief, u, v) + (state[heights + q] if owned else 0.0)
                    away = vector(di * cell, dj * cell, other - base - state[heights + k])
                    rise = dot(up, away)
                    run = math.sqrt(max(dot(away, away) - rise * rise, 0.0))
                    excess = abs(rise) - relief.repose * run
                    if excess > _REST * cell:
                        moved = True
                        q = claim(state, size, blocks, cell * cell, a, b)
                        amount = math.copysign(0.25 * rate * excess, rise)
                        add_height(state, size, blocks, i, j, amount)
                        add_height(state, size, blocks, a, b, -amount)
                        state[HIGHEST] = max(
                            state[HIGHEST], max(state[heights + q], state[heights + k])
                        )
                        activate(state, size, q)
            if moved:
                state[active + kept] = k
                kept += 1
            else:
                state[marks + k] -= FLOWS
        # Those that were activated on the way stand behind.
        for m in range(count, int(state[ACTIVE])):
            state[active + kept] = state[active + m]
            kept += 1
        state[ACTIVE] = 1.0 * kept

    @compiled
    def update(address, lead):
        table = table_at(address)
        relief = scene_records(table[SCENE], 1)[0].surface
        size = relief.size
        state = floats(relief.state, state_length(size, relief.blocks))
        feet = _feet(relief.bodies, relief.body_count)
        points = _points(relief.footprint, feet[len(feet) - 1].end)
        n, origin = read_vector(relief.normal, 0), read_vector(relief.origin, 0)
        uncover(state, size)
        first = 0
        for number in range(len(feet)):
            foot = feet[number]
            position = read_vector(floats(table[XPOS] + 24 * foot.body, 3), 0)
            above = dot(position - origin, n) - foot.reach
            if above > state[HIGHEST] and is_plane:
                first = foot.end
                continue
            rotation = read_matrix(floats(table[XMAT] + 72 * foot.body, 9), 0)
            begin, volume = int(state[COVERED]), 0.0
            for m in range(first, foot.end):
                volume += press(state, relief, position, rotation, points[m])
            first = foot.end
            state[PRESSED] += volume
            heap(state, relief, begin, relief.bulking * volume)
        options = options_at(table)
        g = options.gravity
        g = math.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
        rate = min(options.timestep * math.sqrt(g / relief.cell), 1.0)
        if rate > 0.0:
            flow(state, relief, rate)
        return 1

    return update


def update_program(surface: Any, scene_dtype: np.dtype) -> int:
    """The address of the update's program; 0 for a surface without memory."""
    if not isinstance(surface, Relief):
        return 0
    update = update_kernel(type(surface.base).probe, surface.is_flat, scene_dtype)
    return program_address(update, "int64(int64, float64)", "relief")
