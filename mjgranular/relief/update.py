"""Update of the heights after a step: bodies press sand down, rims are deposited, sand flows.

It runs once per step, after the forces of that step, with the present poses of bodies: forces are
those of the sand as the last step left it. So a force is a function of the state alone, however
often it is evaluated.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled, program_address
from mjgranular.kernel.memory import (
    SCENE,
    SURFACE,
    XMAT,
    XPOS,
    floats,
    records,
    row_of,
    table_at,
)
from mjgranular.kernel.options import NO_GRAVITY, options_at
from mjgranular.kernel.vector import norm, read_matrix, read_vector, vector, write_vector
from mjgranular.relief.flow import flow_kernel, look_through
from mjgranular.relief.footprint import FOOT_DTYPE, TILE
from mjgranular.relief.grid import (
    ACTIVE,
    COVERED,
    HIGHEST,
    MOST_POSES,
    POSE,
    POSES,
    PRESSED,
    SETTLES,
    SINCE_FLOWED,
    SINCE_PRESSED,
    WAITING,
    begin_covering,
    count_at,
    end_covering,
)
from mjgranular.relief.press import bottom_of, heap, lowest_of, press_kernel
from mjgranular.relief.probe import level_kernel, state_length
from mjgranular.relief.relief import Relief
from mjgranular.surface import Surface

_feet = records(FOOT_DTYPE)

# Rates depend on elapsed time, so not on the time step.
PRESSED_AFTER, FLOWS_AFTER = 0.3, 1.0
"""Time until bodies press and sand flows again, in units of sqrt(cell / g), 32 ms for cells of 10
mm: an update every few steps costs less. Chosen: with half of it the path of a walking hexapod is
the same within 1 %."""

STILL = 1e-3
"""How far a surface point may move until bodies press again [cells], while nothing flows. Chosen: a
tenth of the height that is not pressed down at once (`press.LEAST`)."""

FASTEST = 1.5
"""Greatest rate of flow. Chosen below 2, where sand would not come to rest."""


@partial(compiled, inline=True)
def pose_in_plane(table, relief, body):
    """Return the plane's axes in a body frame, a matrix, and that frame's position on them [m]."""
    axes = vector(
        read_vector(relief.along, 0), read_vector(relief.across, 0), read_vector(relief.normal, 0)
    )
    away = read_vector(floats(table[XPOS] + 24 * body, 3), 0) - read_vector(relief.origin, 0)
    return axes @ read_matrix(floats(table[XMAT] + 72 * body, 9), 0), axes @ away


@compiled
def are_still(table, state, relief, feet):
    """Return True if no surface point has moved since its pose was stored; store changed poses."""
    number, body, result = -1, -1, True
    for n in range(len(feet)):
        foot = feet[n]
        if foot.body != body:
            number, body = number + 1, foot.body
        if number >= MOST_POSES:
            return False
        turn, shift = pose_in_plane(table, relief, body)
        first = POSES + POSE * number
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
        relief = reliefs(table[SCENE] + table[SURFACE], 1)[0]
        size = relief.size
        state = floats(relief.state, state_length(size))
        feet = _feet(relief.feet, relief.foot_count)
        options = options_at(table)
        g = options.gravity
        g = 0.0 if options.disableflags & NO_GRAVITY else math.sqrt(
            g[0] * g[0] + g[1] * g[1] + g[2] * g[2]
        )  # fmt: skip
        passed = options.timestep * math.sqrt(g / relief.cell)
        state[SINCE_PRESSED] += passed
        state[SINCE_FLOWED] += passed
        if 0.0 < state[SINCE_PRESSED] < PRESSED_AFTER:
            return 1
        state[SINCE_PRESSED] = 0.0
        flows = state[SINCE_FLOWED] >= FLOWS_AFTER
        if are_still(table, state, relief, feet) and state[SETTLES] == 1.0:
            state[SINCE_FLOWED] = 0.0 if flows else state[SINCE_FLOWED]
            return 1
        pressed, before = state[PRESSED], begin_covering(state, size)
        begin = 0
        for number in range(len(feet)):
            foot = feet[number]
            turn, shift = pose_in_plane(table, relief, foot.body)
            if not is_flat or lowest_of(foot, turn, shift) < state[HIGHEST]:
                first, volume = count_at(state, size, COVERED), 0.0
                for n in range(begin, foot.end):
                    if not is_flat or bottom_of(relief, n, turn, shift) < state[HIGHEST]:
                        points = row_of(relief.points, n, TILE)
                        volume += press(state, relief, turn, shift, points)
                state[PRESSED] += volume
                heap(state, relief, first, relief.bulking * volume)
            begin = foot.end
        end_covering(state, size, before)
        look_through(state, size)
        has_changed = state[PRESSED] > pressed or state[WAITING] > 0.0 or state[ACTIVE] > 0.0
        state[SETTLES] = 0.0 if has_changed else 1.0
        if flows:
            flow(state, relief, min(state[SINCE_FLOWED], FASTEST))
            state[SINCE_FLOWED] = 0.0
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
