"""Update of the heights after a step: bodies press sand down, rims are deposited, sand flows.

It runs once per step, after the forces of that step, with the present poses of bodies: forces are
those of the sand as the last step left it. So a force is a function of the state alone, however
often it is evaluated.

Sand flows down where it is steeper than its angle of repose. A slope is that of a triangle: a node
and its two neighbors along the axes. A square of four nodes has four triangles, and the steepest of
them is leveled. The steepness of a triangle is convex in its heights; they move against its
gradient, whose components sum to zero. So each move is a step of a projection onto a convex set:
the distance to every state that satisfies all bounds does not grow, and no volume is lost.
"""

import math
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from mjgranular.kernel import memory
from mjgranular.kernel.compiled import compiled, program_address
from mjgranular.kernel.fields import rows
from mjgranular.kernel.lanes import all_of, choose
from mjgranular.kernel.memory import floats, records, row_of, scratch, table_at
from mjgranular.kernel.records import NO_GRAVITY, options_at
from mjgranular.kernel.vector import (
    Vector,
    dot,
    norm,
    read_matrix,
    read_vector,
    vector,
    write_vector,
)
from mjgranular.relief import grid
from mjgranular.relief.footprint import FOOT_DTYPE, LANES, TILE
from mjgranular.relief.probe import level_kernel, state_length
from mjgranular.relief.relief import Relief
from mjgranular.surface import Surface

LEAST = 0.1
"""Least height pressed at once, relative to the slack; chosen: creeping bodies update rarely."""

FACES_DOWN = -math.sin(math.radians(1.0))
"""Largest component of a normal along the sand's with which a surface presses it down; chosen."""


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
    Upright surfaces and those that face upward press nothing down. The points are one tile.
    """
    read, write, room = rows(Skin, LANES).read, rows(float, LANES).write, scratch(5 * LANES)

    @compiled
    def press_at(state, relief, place, lane):
        """Press at one point, from its position and the slopes of the body's surface there."""
        z, u, v = place[lane], place[LANES + lane], place[2 * LANES + lane]
        slope_u, slope_v = place[3 * LANES + lane], place[4 * LANES + lane]
        if not is_sand(relief, u, v):
            return 0.0
        cell, size, blocks = relief.cell, relief.size, relief.blocks
        i, j, _, _ = grid.corner_of(cell, u, v)
        row, column, first = i % size, j % size, grid.base_of(i, j)
        area, volume, heights = cell * cell, 0.0, grid.start_of(size, grid.HEIGHT)
        for di in range(2):
            for dj in range(2):
                x, y = (i + di) * cell, (j + dj) * cell
                skin = skin_at(z, slope_u, slope_v, x - u, y - v, cell) - level(relief, x, y)
                k = grid.wrapped(row + di, size) * size + grid.wrapped(column + dj, size)
                base = grid.base_beside(first, di, dj)
                is_own = grid.own_mark(state, size, k, base) >= 0.0
                height = state[heights + k] if is_own else 0.0
                if not height > skin or not is_sand(relief, x, y):
                    continue
                if not is_own:
                    grid.claim(state, size, blocks, area, k, base)
                grid.cover(state, size, k)
                lowered = height - skin - relief.slack
                if lowered > LEAST * relief.slack:
                    grid.add_height(state, size, blocks, k, -lowered)
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
        highest = state[grid.HIGHEST] if is_flat else math.inf
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
                volume += press_at(state, relief, place, lane)
        return volume

    return press


@compiled
def heap(state, relief, first, volume):
    """Deposit a volume [m^3] around a body: each edge node of its track on nodes within two cells.

    `first` is the first of the listed places under the body, which are the last in the list.
    """
    volume += state[grid.WAITING]
    if not volume > 0.0:
        return
    cell, size, blocks, has_edge = relief.cell, relief.size, relief.blocks, has_edges(relief)
    heights, lists = grid.start_of(size, grid.HEIGHT), grid.start_of(size, grid.LISTS)
    area = cell * cell
    last = grid.count_at(state, size, grid.COVERED)
    # Nodes found are stored between the lists, with space for all of them in the second.
    room, found = (size * size - last - grid.count_at(state, size, grid.ACTIVE)) // 2, 0
    for n in range(first, last):
        k = grid.listed_at(state, size, n)
        row, middle = grid.row_at(size, k), grid.base_at(state, size, k)
        column = k - row * size
        at_edge = False
        for di in range(-1, 2):
            begin = grid.wrapped(row + di, size) * size
            for dj in range(-1, 2):
                q = begin + grid.wrapped(column + dj, size)
                mark = grid.own_mark(state, size, q, grid.base_beside(middle, di, dj))
                at_edge = at_edge or mark < grid.UNDER
        if not at_edge:
            continue
        i, j = grid.node_of(middle)
        for di in range(-2, 3):
            begin = grid.wrapped(row + di, size) * size
            for dj in range(-2, 3):
                q, base = begin + grid.wrapped(column + dj, size), grid.base_beside(middle, di, dj)
                mark = grid.own_mark(state, size, q, base)
                # A place with a body in the last step most likely has one, not yet processed.
                if mark >= grid.UNDER or found == room:
                    continue
                if has_edge and not is_sand(relief, (i + di) * cell, (j + dj) * cell):
                    continue
                if mark < 0.0:
                    grid.claim(state, size, blocks, area, q, base)
                state[lists + last + found] = q
                found += 1
    if found == 0:
        state[grid.WAITING] = volume
        return
    share = min(volume / (found * area), cell)  # the rest waits
    for n in range(found):
        q = int(state[lists + last + n])
        grid.add_height(state, size, blocks, q, share)
        state[grid.HIGHEST] = max(state[grid.HIGHEST], state[heights + q])
        if grid.mark_at(state, size, q) == grid.UNMARKED:
            grid.activate(state, size, q)
    state[grid.HEAPED] += found * area * share
    state[grid.WAITING] = volume - found * area * share


REST = 5e-3  # slope that may remain above that of repose: 0.2 degrees; chosen


# Below, a and b are the slopes of a triangle along the first and the second axis of the plane, `up`
# is the upward direction along the plane's axes, `tangent` that of the angle of repose.


@partial(compiled, inline=True)
def slope_to(height, other, sign, level):
    """Return the slope along an axis between heights of neighbors [cells].

    The other is NaN where nothing flows: then it is level. The sign is 1 if it is ahead, else -1.
    """
    return sign * (other - height) if other == other else level


@partial(compiled, inline=True)
def excess_of(a, b, up, tangent):
    """Return by how much a triangle is steeper than repose; convex in its slopes."""
    rise = up.z - a * up.x - b * up.y  # of the normal (-a, -b, 1) along gravity
    return math.sqrt(max(1.0 + a * a + b * b - rise * rise, 0.0)) - tangent * rise


@partial(compiled, inline=True)
def gains_of(a, b, up, tangent, ahead, beside, rate):
    """Return the heights that the node of a steep triangle loses to its two neighbors [cells].

    `ahead` is 1 if the first neighbor is ahead, -1 if behind, 0 if nothing flows there, `beside`
    the same of the second. The rate is a fraction of the step that would end the excess; below 2.
    """
    excess = excess_of(a, b, up, tangent)
    rise = up.z - a * up.x - b * up.y
    across = excess + tangent * rise
    first = ahead * ((a + rise * up.x) / across + tangent * up.x)
    second = beside * ((b + rise * up.y) / across + tangent * up.y)
    both = first + second
    scale = -rate * excess / (first * first + second * second + both * both)
    return scale * first, scale * second


@cache
def flow_kernel(level: Any, is_flat: bool) -> Any:
    """Make a kernel `flow(state, relief, up, rate)`: sand flows down where it is too steep.

    Nothing flows from or to a node under a body. The kernel `level` is of `level_kernel`.
    """
    room = scratch(18)

    @partial(compiled, inline=True)
    def flow_in_square(around, gained, first, up, tangent, rate):
        """Level the steepest triangle of a square, whose first node is `first`.

        `around` has the heights of nine nodes [cells], row by row, `gained` what they have gained.
        """
        steepest, corner = REST, -1
        flat_a, flat_b = -up.x / up.z, -up.y / up.z
        for k in range(4):
            # Rows are three apart.
            di, dj = k >> 1, k & 1
            height = around[first + 3 * di + dj]
            a = slope_to(height, around[first + 3 * (1 - di) + dj], 1.0 - 2.0 * di, flat_a)
            b = slope_to(height, around[first + 3 * di + 1 - dj], 1.0 - 2.0 * dj, flat_b)
            excess = excess_of(a, b, up, tangent)
            if excess > steepest and height == height:
                steepest, corner = excess, k
        if corner < 0:
            return
        di, dj = corner >> 1, corner & 1
        node, ahead, beside = 3 * di + dj, 3 * (1 - di) + dj, 3 * di + 1 - dj
        node, ahead, beside = first + node, first + ahead, first + beside
        s, t = 1.0 - 2.0 * di, 1.0 - 2.0 * dj
        a = slope_to(around[node], around[ahead], s, flat_a)
        b = slope_to(around[node], around[beside], t, flat_b)
        s = s if around[ahead] == around[ahead] else 0.0
        t = t if around[beside] == around[beside] else 0.0
        g, h = gains_of(a, b, up, tangent, s, t, rate)
        around[node] -= g + h
        gained[node] -= g + h
        around[ahead] += g
        gained[ahead] += g
        around[beside] += h
        gained[beside] += h

    @compiled
    def flow(state, relief, up, rate):
        cell, size, blocks, tangent = relief.cell, relief.size, relief.blocks, relief.repose
        has_edge, per_cell = has_edges(relief), 1.0 / cell
        heights = grid.start_of(size, grid.HEIGHT)
        # Start of the list of active places, which runs backward.
        end = grid.start_of(size, grid.LISTS) + size * size - 1
        area, numbers = cell * cell, room()
        around, gained = numbers[:9], numbers[9:]
        count, kept, highest = grid.count_at(state, size, grid.ACTIVE), 0, 0.0
        for n in range(count):
            k = grid.listed_at(state, size, size * size - 1 - n)
            if grid.mark_at(state, size, k) != grid.FLOWS:
                continue
            row, middle = grid.row_at(size, k), grid.base_at(state, size, k)
            column = k - row * size
            i, j = grid.node_of(middle)
            flowing = 0
            for di in range(-1, 2):
                begin = grid.wrapped(row + di, size) * size
                for dj in range(-1, 2):
                    q, place = 3 * di + dj + 4, begin + grid.wrapped(column + dj, size)
                    mark = grid.own_mark(state, size, place, grid.base_beside(middle, di, dj))
                    height = per_cell * state[heights + place] if mark >= 0.0 else 0.0
                    if not is_flat:
                        height += per_cell * level(relief, (i + di) * cell, (j + dj) * cell)
                    if mark == grid.UNDER or (
                        has_edge and not is_sand(relief, (i + di) * cell, (j + dj) * cell)
                    ):
                        height = math.nan
                    around[q], gained[q] = height, 0.0
                    flowing |= (1 << q) if mark == grid.FLOWS else 0
            # The first active node of a square handles it.
            if flowing & 0b000001011 == 0:
                flow_in_square(around, gained, 0, up, tangent, rate)
            if flowing & 0b000000110 == 0:
                flow_in_square(around, gained, 1, up, tangent, rate)
            if flowing & 0b000001000 == 0:
                flow_in_square(around, gained, 3, up, tangent, rate)
            flow_in_square(around, gained, 4, up, tangent, rate)
            for q in range(9):
                if gained[q] == 0.0:
                    continue
                di, dj = q // 3 - 1, q % 3 - 1
                place = grid.wrapped(row + di, size) * size + grid.wrapped(column + dj, size)
                base = grid.base_beside(middle, di, dj)
                mark = grid.own_mark(state, size, place, base)
                if mark < 0.0:
                    grid.claim(state, size, blocks, area, place, base)
                grid.add_height(state, size, blocks, place, cell * gained[q])
                highest = max(highest, state[heights + place])
                if q != 4 and mark <= 0.0:
                    grid.activate(state, size, place)
            height = state[heights + k]
            if gained[4] != 0.0:
                state[end - kept] = k
                kept += 1
            else:
                grid.set_mark(state, size, k, grid.UNMARKED)
                state[grid.SETTLED] = max(state[grid.SETTLED], height)
                state[grid.SEEN] = max(state[grid.SEEN], height)
            highest = max(highest, height)
        # Nodes activated meanwhile follow in the list.
        for n in range(count, grid.count_at(state, size, grid.ACTIVE)):
            state[end - kept] = state[end - n]
            kept += 1
        state[grid.ACTIVE] = 1.0 * kept
        state[grid.HIGHEST] = max(state[grid.SETTLED], highest)

    return flow


@compiled
def look_through(state, size):
    """Search one row per step for the highest node, since the last one found may be lower now."""
    row = min(max(int(state[grid.ROW]), 0), size - 1)
    first, highest = grid.start_of(size, grid.HEIGHT) + row * size, 0.0
    for n in range(first, first + size):
        highest = max(highest, state[n])
    state[grid.SEEN] = max(state[grid.SEEN], highest)
    state[grid.ROW] = row + 1.0
    if row + 1 == size:
        state[grid.SETTLED] = state[grid.SEEN]
        state[grid.SEEN] = state[grid.ROW] = 0.0


_feet = records(FOOT_DTYPE)

# Rates depend on elapsed time, so not on the time step.
PRESSED_AFTER, FLOWS_AFTER = 0.3, 1.0
"""Time until bodies press and sand flows again, in units of sqrt(cell / g), 32 ms for cells of 10
mm. Chosen: with half of it the path of a walking hexapod is the same within 1 %."""

STILL = 1e-3
"""How far a point may move until bodies press again [cells], if nothing flows; chosen: a tenth of
`LEAST`."""

FASTEST = 1.5  # greatest rate of flow; chosen below 2, where sand would not come to rest


@partial(compiled, inline=True)
def pose_in_plane(table, relief, body):
    """Return the plane's axes in a body frame, a matrix, and that frame's position on them [m]."""
    axes = vector(
        read_vector(relief.along, 0), read_vector(relief.across, 0), read_vector(relief.normal, 0)
    )
    away = read_vector(floats(table[memory.XPOS] + 24 * body, 3), 0) - read_vector(relief.origin, 0)
    return axes @ read_matrix(floats(table[memory.XMAT] + 72 * body, 9), 0), axes @ away


@compiled
def are_still(table, state, relief, feet):
    """Return True if no surface point has moved since its pose was stored; store changed poses."""
    number, body, result = -1, -1, True
    for n in range(len(feet)):
        foot = feet[n]
        if foot.body != body:
            number, body = number + 1, foot.body
        if number >= grid.MOST_POSES:
            return False
        turn, shift = pose_in_plane(table, relief, body)
        first = grid.POSES + grid.POSE * number
        turned = turn - read_matrix(state, first)
        moved = norm(shift - read_vector(state, first + 9))
        moved += foot.far * (norm(turned.x) + norm(turned.y) + norm(turned.z))
        if not moved <= STILL * relief.cell:
            for row, part in enumerate((turn.x, turn.y, turn.z, shift)):
                write_vector(state, first + 3 * row, part)
            result = False
    return result


@cache
def update_kernel(probe: Any, is_flat: bool, dtype: np.dtype) -> Any:
    """Make the program `update(table, lead)`, which returns 1 when done."""
    level, reliefs = level_kernel(probe, is_flat), records(dtype)
    press, flow = press_kernel(level, is_flat), flow_kernel(level, is_flat)

    @compiled
    def update(address, lead):
        table = table_at(address)
        relief = reliefs(table[memory.SCENE] + table[memory.SURFACE], 1)[0]
        size = relief.size
        state = floats(relief.state, state_length(size))
        feet = _feet(relief.feet, relief.foot_count)
        options = options_at(table)
        gravity = read_vector(options.gravity, 0)
        g = 0.0 if options.disableflags & NO_GRAVITY else norm(gravity)
        passed = options.timestep * math.sqrt(g / relief.cell)
        state[grid.SINCE_PRESSED] += passed
        state[grid.SINCE_FLOWED] += passed
        if 0.0 < state[grid.SINCE_PRESSED] < PRESSED_AFTER:
            return 1
        state[grid.SINCE_PRESSED] = 0.0
        flows = state[grid.SINCE_FLOWED] >= FLOWS_AFTER
        if are_still(table, state, relief, feet) and state[grid.SETTLES] == 1.0:
            state[grid.SINCE_FLOWED] = 0.0 if flows else state[grid.SINCE_FLOWED]
            return 1
        pressed, before = state[grid.PRESSED], grid.begin_covering(state, size)
        begin = 0
        for number in range(len(feet)):
            foot = feet[number]
            turn, shift = pose_in_plane(table, relief, foot.body)
            if not is_flat or lowest_of(foot, turn, shift) < state[grid.HIGHEST]:
                first, volume = grid.count_at(state, size, grid.COVERED), 0.0
                for n in range(begin, foot.end):
                    if not is_flat or bottom_of(relief, n, turn, shift) < state[grid.HIGHEST]:
                        points = row_of(relief.points, n, TILE)
                        volume += press(state, relief, turn, shift, points)
                state[grid.PRESSED] += volume
                heap(state, relief, first, volume)
            begin = foot.end
        grid.end_covering(state, size, before)
        look_through(state, size)
        has_sand_to_move = state[grid.WAITING] > 0.0 or state[grid.ACTIVE] > 0.0
        has_changed = state[grid.PRESSED] > pressed or has_sand_to_move
        state[grid.SETTLES] = 0.0 if has_changed else 1.0
        if flows:
            axes, _ = pose_in_plane(table, relief, 0)
            up = axes @ (-1.0 / norm(gravity) * gravity)
            if up.z > 0.0:  # else gravity pulls out of the sand
                flow(state, relief, up, min(state[grid.SINCE_FLOWED], FASTEST))
            state[grid.SINCE_FLOWED] = 0.0
        return 1

    return update


def update_program(surface: Surface, dtype: np.dtype) -> int:
    """Return the address of the program that updates a relief, from its surface and its record.

    It is 0 for a surface without memory.
    """
    if not isinstance(surface, Relief):
        return 0
    update = update_kernel(type(surface.base).probe, surface.is_flat, dtype)
    return program_address(update, "int64(int64, float64)", f"memory, {surface.base}")
