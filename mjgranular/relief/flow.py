"""Sand flows down where it is steeper than its angle of repose.

A slope is that of a triangle: a node and its two neighbors along the axes. A square of four nodes
has four triangles, and the steepest of them is leveled. The steepness of a triangle is convex in
its heights; they move against its gradient, whose components sum to zero. So each move is a step of
a projection onto a convex set: the distance to every state that satisfies all bounds does not grow,
and no volume is lost.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import scratch
from mjgranular.kernel.vector import vector
from mjgranular.relief.grid import (
    ACTIVE,
    FLOWS,
    HEIGHT,
    HIGHEST,
    LISTS,
    ROW,
    SEEN,
    SETTLED,
    UNDER,
    UNMARKED,
    activate,
    add_height,
    base_at,
    base_beside,
    claim,
    count_at,
    listed_at,
    mark_at,
    node_of,
    own_mark,
    row_at,
    set_mark,
    start_of,
    wrapped,
)
from mjgranular.relief.press import has_edges, is_sand

REST = 5e-3
"""Slope that may remain above that of repose: 0.2 degrees. Chosen."""


@partial(compiled, inline=True)
def slope_to(height, other, sign, level):
    """Return the slope along an axis from a node to its neighbor; `level` if that is NaN.

    Args:
        height: height of the node over the plane [cells].
        other: height of the neighbor; NaN where nothing flows.
        sign: 1 if the neighbor is ahead along the axis, -1 if behind.
        level: slope of level sand.
    """
    return sign * (other - height) if other == other else level


@partial(compiled, inline=True)
def excess_of(a, b, up, tangent):
    """Return by how much a triangle is steeper than repose; convex in its slopes.

    Args:
        a: slope along the first axis of the plane.
        b: slope along the second.
        up: upward direction along the axes of the plane, a vector.
        tangent: tangent of the angle of repose.
    """
    rise = up.z - a * up.x - b * up.y  # of the normal (-a, -b, 1) along gravity
    return math.sqrt(max(1.0 + a * a + b * b - rise * rise, 0.0)) - tangent * rise


@partial(compiled, inline=True)
def gains_of(a, b, up, tangent, ahead, beside, rate):
    """Return the heights that the node of a steep triangle loses to its two neighbors [cells].

    Args:
        a: slope along the first axis of the plane.
        b: slope along the second.
        up: upward direction along the axes of the plane, a vector.
        tangent: tangent of the angle of repose.
        ahead: 1 if the first neighbor is ahead, -1 if behind, 0 if nothing flows there.
        beside: the same of the second.
        rate: fraction of the step that would end the excess; below 2.
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
    """Make a kernel `flow(state, relief, rate)`: sand flows down where it is too steep.

    Nothing flows from or to a node under a body.

    Args:
        level: see `level_kernel`.
        is_flat: whether the surface is locally plane.
    """
    room = scratch(18)

    @partial(compiled, inline=True)
    def flow_in_square(around, gained, first, up, tangent, rate):
        """Level the steepest triangle of a square.

        Args:
            around: heights of nine nodes [cells], row by row.
            gained: heights that they have gained [cells].
            first: the first node of the square.
            up: upward direction along the axes of the plane.
            tangent: tangent of the angle of repose.
            rate: see `gains_of`.
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
    def flow(state, relief, rate):
        cell, size, blocks, tangent = relief.cell, relief.size, relief.blocks, relief.repose
        has_edge, heights, per_cell = has_edges(relief), start_of(size, HEIGHT), 1.0 / relief.cell
        # Start of the list of active places, which runs backward.
        end = start_of(size, LISTS) + size * size - 1
        area, up = cell * cell, vector(relief.along[2], relief.across[2], relief.normal[2])
        numbers = room()
        around, gained = numbers[:9], numbers[9:]
        count, kept, highest = count_at(state, size, ACTIVE), 0, 0.0
        for n in range(count):
            k = listed_at(state, size, size * size - 1 - n)
            if mark_at(state, size, k) != FLOWS:
                continue
            row, middle = row_at(size, k), base_at(state, size, k)
            column = k - row * size
            i, j = node_of(middle)
            flowing = 0
            for di in range(-1, 2):
                begin = wrapped(row + di, size) * size
                for dj in range(-1, 2):
                    q, place = 3 * di + dj + 4, begin + wrapped(column + dj, size)
                    mark = own_mark(state, size, place, base_beside(middle, di, dj))
                    height = per_cell * state[heights + place] if mark >= 0.0 else 0.0
                    if not is_flat:
                        height += per_cell * level(relief, (i + di) * cell, (j + dj) * cell)
                    if mark == UNDER or (
                        has_edge and not is_sand(relief, (i + di) * cell, (j + dj) * cell)
                    ):
                        height = math.nan
                    around[q], gained[q] = height, 0.0
                    flowing |= (1 << q) if mark == FLOWS else 0
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
                place = wrapped(row + di, size) * size + wrapped(column + dj, size)
                base = base_beside(middle, di, dj)
                mark = own_mark(state, size, place, base)
                if mark < 0.0:
                    claim(state, size, blocks, area, place, base)
                add_height(state, size, blocks, place, cell * gained[q])
                highest = max(highest, state[heights + place])
                if q != 4 and mark <= 0.0:
                    activate(state, size, place)
            height = state[heights + k]
            if gained[4] != 0.0:
                state[end - kept] = k
                kept += 1
            else:
                set_mark(state, size, k, UNMARKED)
                state[SETTLED] = max(state[SETTLED], height)
                state[SEEN] = max(state[SEEN], height)
            highest = max(highest, height)
        # Nodes activated meanwhile follow in the list.
        for n in range(count, count_at(state, size, ACTIVE)):
            state[end - kept] = state[end - n]
            kept += 1
        state[ACTIVE] = 1.0 * kept
        state[HIGHEST] = max(state[SETTLED], highest)

    return flow


@compiled
def look_through(state, size):
    """Search one row per step for the highest node, since the last one found may be lower now."""
    row = min(max(int(state[ROW]), 0), size - 1)
    first, highest = start_of(size, HEIGHT) + row * size, 0.0
    for n in range(first, first + size):
        highest = max(highest, state[n])
    state[SEEN] = max(state[SEEN], highest)
    state[ROW] = row + 1.0
    if row + 1 == size:
        state[SETTLED] = state[SEEN]
        state[SEEN] = state[ROW] = 0.0
