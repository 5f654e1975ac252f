"""Sand flows down where it is steeper than it can rest."""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.fields import rows
from mjgranular.kernel.lanes import bits_in, lowest_bit
from mjgranular.kernel.memory import scratch
from mjgranular.kernel.vector import vector
from mjgranular.relief.grid import (
    ACTIVE,
    ARRAYS,
    FLOWS,
    HEIGHT,
    HIGHEST,
    LISTS,
    ROW,
    SEEN,
    SETTLED,
    UNDER,
    UNMARKED,
    base_at,
    base_beside,
    block_of,
    mark_at,
    node_of,
    own_mark,
    row_at,
    set_mark,
    start_of,
    wrapped,
)
from mjgranular.relief.lists import activate, claim, count_at, listed_at
from mjgranular.relief.press import has_edges, is_sand

REST = 5e-3
"""Height that may be left over the angle of repose [cells]: 0.2 degrees. Chosen."""


@partial(compiled, inline=True)
def exchanged(rise, run, tangent, rest, rate):
    """Height that the higher of two neighbours gives to the lower; with the sign of `rise` [m].

    Args:
        rise: how much higher the other is, along gravity [m].
        run: square of how far away it is, across gravity [m^2].
        tangent: of the angle of repose.
        rest: height that may be left over it [m].
        rate: part of a quarter of the excess.
    """
    excess = abs(rise) - tangent * math.sqrt(max(run, 0.0))
    return math.copysign(0.25 * rate * excess, rise) if excess > rest else 0.0


@cache
def flow_kernel(level: Any, is_flat: bool) -> Any:
    """Makes a kernel `flow(state, relief, rate)`: sand flows down where it is too steep.

    Two neighbours whose slope is steeper than repose exchange `rate` of a quarter of the excess;
    from and to a node under a body nothing flows.

    Args:
        level: see `level_kernel`.
        is_flat: whether the surface is plane where it is.
    """
    read, room = rows(float, 8).read, scratch(5 * 8)

    @compiled
    def flow(state, relief, rate):
        cell, size, blocks, tangent = relief.cell, relief.size, relief.blocks, relief.repose
        has_edge = has_edges(relief)
        heights, sums = start_of(size, HEIGHT), start_of(size, ARRAYS)
        # Where the list of active places begins, backwards.
        end = start_of(size, LISTS) + size * size - 1
        area, steeper, rest = cell * cell, tangent * tangent, REST * cell
        # What is up along the axes of the plane.
        up = vector(relief.along[2], relief.across[2], relief.normal[2])
        # Of the eight neighbours: how much higher and how far away they would be on the bare plane,
        # where they are from here, and how much higher they are over the plane.
        around, lane = room(), 0
        for di in range(-1, 2):
            for dj in range(-1, 2):
                if di != 0 or dj != 0:
                    around[lane] = (up.x * di + up.y * dj) * cell
                    around[8 + lane] = (di * di + dj * dj) * area
                    around[16 + lane], around[24 + lane] = di, dj
                    lane += 1
        count, kept, highest = count_at(state, size, ACTIVE), 0, 0.0
        for n in range(count):
            k = listed_at(state, size, size * size - 1 - n)
            if mark_at(state, size, k) != FLOWS:
                continue
            row, middle = row_at(size, k), base_at(state, size, k)
            column = k - row * size
            i, j = node_of(middle)
            ground = level(relief, i * cell, j * cell)
            # The node's own height is written when all its neighbours have been seen to.
            height, moved, lane = state[heights + k], False, 0
            for di in range(-1, 2):
                begin = wrapped(row + di, size) * size
                for dj in range(-1, 2):
                    if di != 0 or dj != 0:
                        q = begin + wrapped(column + dj, size)
                        mark = own_mark(state, size, q, base_beside(middle, di, dj))
                        other = state[heights + q]
                        other = (other if mark >= 0.0 else 0.0) - height
                        if not is_flat:
                            other += level(relief, (i + di) * cell, (j + dj) * cell) - ground
                        # Of two active neighbours one sees to both.
                        first = 3 * di + dj < 0
                        idle = mark == UNDER or (mark == FLOWS and first)
                        around[32 + lane] = math.nan if idle else other
                        lane += 1
            others = read(around, 32)
            rises = read(around, 0) + up.z * others
            runs = read(around, 8) + others * others - rises * rises
            steep = bits_in(rises * rises > steeper * runs)
            while steep != 0:
                lane = lowest_bit(steep)
                steep &= steep - 1
                di, dj = int(around[16 + lane]), int(around[24 + lane])
                other = around[32 + lane] + (state[heights + k] - height)
                rise = around[lane] + up.z * other
                run = around[8 + lane] + other * other - rise * rise
                amount = exchanged(rise, run, tangent, rest, rate)
                if amount == 0.0:
                    continue
                if has_edge and not is_sand(relief, (i + di) * cell, (j + dj) * cell):
                    continue
                q = wrapped(row + di, size) * size + wrapped(column + dj, size)
                base = base_beside(middle, di, dj)
                mark = own_mark(state, size, q, base)
                if mark < 0.0:
                    claim(state, size, blocks, area, q, base)
                moved = True
                height += amount
                state[heights + q] -= amount
                state[sums + block_of(size, blocks, q)] -= amount
                highest = max(highest, state[heights + q])
                if mark <= 0.0:
                    activate(state, size, q)
            highest = max(highest, height)
            if moved:
                state[sums + block_of(size, blocks, k)] += height - state[heights + k]
                state[heights + k] = height
                state[end - kept] = k
                kept += 1
            else:
                set_mark(state, size, k, UNMARKED)
                state[SETTLED] = max(state[SETTLED], height)
                state[SEEN] = max(state[SEEN], height)
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
