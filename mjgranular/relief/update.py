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
    ROW,
    SEEN,
    SETTLED,
    SINCE_FLOWED,
    SINCE_PRESSED,
    UNDER,
    UNMARKED,
    WAITING,
    add_height,
    corner_of,
    key_at,
    key_of,
    mark_at,
    node_of,
    set_mark,
    start_of,
    wrapped,
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
_REST = 5e-3  # height that may be left over the angle of repose [cells]: 0.2 degrees; chosen
# Time that goes by until bodies press and sand flows again, in units of sqrt(cell / g), 32 ms for
# cells of 10 mm: what is done once in several steps costs a part of it. Chosen: with half of it
# the way of a walking hexapod is the same within 1 %.
_PRESSED_AFTER, _FLOWS_AFTER = 0.2, 0.6
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
def press_kernel(level: Any, is_flat: bool) -> Any:
    """Makes a kernel `press(state, relief, turn, shift, point)`: the volume pressed down [m^3].

    Where sand reaches the skin it is pressed down: at the four nodes around a point of it, to the
    height of the point or, where the skin rises beside it, to its tangent plane. Steep skin presses
    nothing down, nor does skin that faces upward.

    Args:
        level: see `level_kernel`.
        is_flat: whether the surface is plane where it is.
    """

    @compiled
    def press(state, relief, turn, shift, point):
        outward, middle = read_vector(point.normal, 0), read_vector(point.point, 0)
        has_face = dot(outward, outward) > 0.5
        if has_face and dot(turn.z, outward) > _FACES_DOWN:
            return 0.0
        z = dot(turn.z, middle) + shift.z
        if is_flat and z > state[HIGHEST]:
            return 0.0
        u, v = dot(turn.x, middle) + shift.x, dot(turn.y, middle) + shift.y
        if not is_sand(relief, u, v):
            return 0.0
        normal = turn @ outward
        cell, size, blocks = relief.cell, relief.size, relief.blocks
        slope_u = -normal.x / normal.z if has_face else 0.0
        slope_v = -normal.y / normal.z if has_face else 0.0
        i, j, _, _ = corner_of(cell, u, v)
        row, column = i % size, j % size
        area, volume, heights = cell * cell, 0.0, start_of(size, HEIGHT)
        for di in range(2):
            for dj in range(2):
                x, y = (i + di) * cell, (j + dj) * cell
                rise = max(slope_u * (x - u) + slope_v * (y - v), 0.0)
                skin = z + rise - level(relief, x, y)
                k = wrapped(row + di, size) * size + wrapped(column + dj, size)
                key = key_of(i + di, j + dj)
                height = state[heights + k] if key_at(state, size, k) == key else 0.0
                if not height > skin or not is_sand(relief, x, y):
                    continue
                claim(state, size, blocks, area, k, key)
                cover(state, size, k)
                lowered = height - skin - relief.slack
                if lowered > 0.0:
                    add_height(state, size, blocks, k, -lowered)
                    volume += area * lowered
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
    cell, size, blocks = relief.cell, relief.size, relief.blocks
    heights, lists = start_of(size, HEIGHT), start_of(size, LISTS)
    last = count_at(state, size, COVERED)
    room = size * size - last - count_at(state, size, ACTIVE)
    found = 0  # written down between the lists, with room for these places in the second
    for n in range(first, last):
        k = listed_at(state, size, n)
        row, column = k // size, k % size
        i, j = node_of(key_at(state, size, k))
        at_edge = False
        for number in range(8):
            di, dj = _EIGHT[number]
            q = wrapped(row + di, size) * size + wrapped(column + dj, size)
            if key_at(state, size, q) != key_of(i + di, j + dj) or mark_at(state, size, q) < UNDER:
                at_edge = True
        if not at_edge:
            continue
        for di in range(-2, 3):
            for dj in range(-2, 3):
                q = wrapped(row + di, size) * size + wrapped(column + dj, size)
                key = key_of(i + di, j + dj)
                # Where a body was in the last step it most likely is, though its turn has not come.
                if key_at(state, size, q) == key and mark_at(state, size, q) >= UNDER:
                    continue
                if is_sand(relief, (i + di) * cell, (j + dj) * cell) and 3 * found + 3 < room:
                    state[lists + last + 2 * found] = q
                    state[lists + last + 2 * found + 1] = key
                    found += 1
    if found == 0:
        state[WAITING] = volume
        return
    area = cell * cell
    share = min(volume / (found * area), cell)  # the rest waits
    for n in range(found):
        q = int(state[lists + last + 2 * n])
        key = int(state[lists + last + 2 * n + 1])
        claim(state, size, blocks, area, q, key)
        add_height(state, size, blocks, q, share)
        state[HIGHEST] = max(state[HIGHEST], state[heights + q])
        activate(state, size, q)
    state[HEAPED] += found * area * share
    state[WAITING] = volume - found * area * share


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
        count, kept, highest = count_at(state, size, ACTIVE), 0, 0.0
        for n in range(count):
            k = listed_at(state, size, size * size - 1 - n)
            if mark_at(state, size, k) != FLOWS:
                continue
            row, column = k // size, k % size
            i, j = node_of(key_at(state, size, k))
            base, moved = level(relief, i * cell, j * cell), False
            for number in range(8):
                di, dj = _EIGHT[number]
                q = wrapped(row + di, size) * size + wrapped(column + dj, size)
                key = key_of(i + di, j + dj)
                owned = key_at(state, size, q) == key
                if owned:
                    mark = mark_at(state, size, q)
                    # Of two active neighbours one sees to both.
                    if mark == UNDER or (mark == FLOWS and number >= 4):
                        continue
                if not is_sand(relief, (i + di) * cell, (j + dj) * cell):
                    continue
                other = level(relief, (i + di) * cell, (j + dj) * cell) - base
                other += (state[heights + q] if owned else 0.0) - state[heights + k]
                rise = (up.x * di + up.y * dj) * cell + up.z * other
                run = (di * di + dj * dj) * area + other * other - rise * rise
                if not rise * rise > steeper * run:
                    continue
                excess = abs(rise) - tangent * math.sqrt(max(run, 0.0))
                if excess > _REST * cell:
                    moved = True
                    claim(state, size, blocks, area, q, key)
                    amount = math.copysign(0.25 * rate * excess, rise)
                    add_height(state, size, blocks, k, amount)
                    add_height(state, size, blocks, q, -amount)
                    highest = max(highest, state[heights + q])
                    activate(state, size, q)
            highest = max(highest, state[heights + k])
            if moved:
                state[end - kept] = k
                kept += 1
            else:
                set_mark(state, size, k, UNMARKED)
                state[SETTLED] = max(state[SETTLED], state[heights + k])
                state[SEEN] = max(state[SEEN], state[heights + k])
        # Those that were activated on the way stand behind.
        for n in range(count, count_at(state, size, ACTIVE)):
            state[end - kept] = state[end - n]
            kept += 1
        state[ACTIVE] = 1.0 * kept
        state[HIGHEST] = max(state[SETTLED], highest)

    return flow


@compiled
def look_through(state, size):
    """Looks through one row a step for the highest node: what was higher once may be gone."""
    row = min(max(int(state[ROW]), 0), size - 1)
    first, highest = start_of(size, HEIGHT) + row * size, 0.0
    for n in range(first, first + size):
        highest = max(highest, state[n])
    state[SEEN] = max(state[SEEN], highest)
    state[ROW] = row + 1.0
    if row + 1 == size:
        state[SETTLED] = state[SEEN]
        state[SEEN] = state[ROW] = 0.0


@cache
def update_kernel(probe: Any, is_flat: bool, scene_dtype: np.dtype) -> Any:
    """Makes the program `update(table, lead)`: 1 if done.

    Args:
        probe: of the surface without memory.
        is_flat: whether it is plane where it is.
        scene_dtype: record of law and surface.
    """
    level, scene_records = level_kernel(probe, is_flat), records(scene_dtype)
    press, flow = press_kernel(level, is_flat), flow_kernel(level)

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
        options = options_at(table)
        g = options.gravity
        g = 0.0 if options.disableflags & NO_GRAVITY else math.sqrt(
            g[0] * g[0] + g[1] * g[1] + g[2] * g[2]
        )  # fmt: skip
        passed = options.timestep * math.sqrt(g / relief.cell)
        state[SINCE_PRESSED] += passed
        state[SINCE_FLOWED] += passed
        if 0.0 < state[SINCE_PRESSED] < _PRESSED_AFTER:
            return 1
        state[SINCE_PRESSED] = 0.0
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
        look_through(state, size)
        if state[SINCE_FLOWED] >= _FLOWS_AFTER:
            flow(state, relief, min(state[SINCE_FLOWED], 1.0))
            state[SINCE_FLOWED] = 0.0
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
