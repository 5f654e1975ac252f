"""The sand's forces among the external forces on bodies: in `cfrc_ext` and in force sensors.

MuJoCo computes these (`mj_rnePostConstraint`) from contacts, constraints and `xfrc_applied`. Of
passive forces it only has the components along joints. So during one call the sand's wrenches are
in `xfrc_applied`: no user code runs meanwhile, and the rows are restored to the last bit.
Everywhere else the sand is a passive force, as `mj_inverse` expects.

MuJoCo calls plugins after its own sensors of the acceleration stage, whose values then lack the
sand. If there are such sensors, they are computed again.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import mujoco

from mjgranular._util.checks import check_data, check_model
from mjgranular.engine.block import HEADER_DTYPE
from mjgranular.engine.handles import block_finder
from mjgranular.engine.instances import NAME, instance_of, sands_in
from mjgranular.engine.layout import Layout, find_layout
from mjgranular.kernel.compiled import compiled, entry
from mjgranular.kernel.engine import forces_on_bodies, sensors_of_acceleration
from mjgranular.kernel.memory import (
    BODIES,
    BODY_COUNT,
    NBODY,
    ints,
    longs,
    records,
    row_of,
    table_at,
)
from mjgranular.kernel.options import DISABLEFLAGS_BEHIND_INTEGRATOR, NO_PASSIVE_FORCES
from mjgranular.kernel.records import body_records

ASLEEP = int(mujoco.mjtSleepState.mjS_ASLEEP) if hasattr(mujoco, "mjtSleepState") else 0
"""Value of `body_awake` for bodies that MuJoCo skips."""

_header = records(HEADER_DTYPE)


@compiled
def lay_wrenches(header):
    """Add the wrenches of a sand to `xfrc_applied`, and save what was there.

    Returns:
        Whether there are any.
    """
    table = table_at(header.table)
    bodies = body_records(table[BODIES], table[BODY_COUNT])
    states = ints(header.awake, table[NBODY])
    some = False
    for slot in range(len(bodies)):
        body = bodies[slot]
        row = row_of(header.xfrc, body.body, 6)
        for k in range(6):
            body.user_wrench[k] = row[k]
        if states[body.body] != ASLEEP:
            for k in range(6):
                some = some or body.wrench[k] != 0.0
                row[k] += body.wrench[k]
    return some


@compiled
def lift_wrenches(header):
    """Restore what `lay_wrenches` saved."""
    table = table_at(header.table)
    bodies = body_records(table[BODIES], table[BODY_COUNT])
    for slot in range(len(bodies)):
        body = bodies[slot]
        row = row_of(header.xfrc, body.body, 6)
        for k in range(6):
            row[k] = body.user_wrench[k]


@cache
def external_forces(layout: Layout) -> Any:
    """Make a compiled function `include(model, data, first)`: forces on bodies with sand.

    It takes the index of the first instance of sand, and returns whether any of its forces exist.
    """
    find_block = block_finder(layout)
    plugin, flags = layout.plugin, layout.integrator + DISABLEFLAGS_BEHIND_INTEGRATOR

    @compiled
    def include(model, data, first):
        if ints(model + flags, 1)[0] & NO_PASSIVE_FORCES == NO_PASSIVE_FORCES:
            return False
        block = find_block(data, first)
        if block == 0:
            return False
        count = _header(block, 1)[0].instances
        kinds = ints(longs(model + plugin, 1)[0], count)
        some = False
        for instance in range(first, count):
            block = find_block(data, instance) if kinds[instance] == kinds[first] else 0
            if block != 0 and _header(block, 1)[0].program != 0:
                some = lay_wrenches(_header(block, 1)[0]) or some
        if some:
            forces_on_bodies(model, data)
        for instance in range(count - 1, first - 1, -1):  # the last of two on a body goes first
            block = find_block(data, instance) if kinds[instance] == kinds[first] else 0
            if block != 0 and _header(block, 1)[0].program != 0:
                lift_wrenches(_header(block, 1)[0])
        return some

    return include


@cache
def sensor_teller(layout: Layout) -> Any:
    """Make a compiled function `tell(model, data, instance, block)` that updates force sensors.

    MuJoCo calls it for each sand, after its own sensors; the first call handles all sands.
    """
    include, plugin = external_forces(layout), layout.plugin

    @compiled
    def tell(model, data, instance, block):
        kinds = ints(longs(model + plugin, 1)[0], instance + 1)
        for other in range(instance):
            if kinds[other] == kinds[instance]:
                return
        header = _header(block, 1)[0]
        if header.senses == 0:  # not needed, and it takes a tenth of a small robot's step
            return
        if header.telling != 0:  # called from the call below
            header.telling = 0
            return
        if include(model, data, instance):
            header.telling = 1
            sensors_of_acceleration(model, data)
            header.telling = 0

    return tell


def rne_post_constraint(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Do what `mujoco.mj_rnePostConstraint` does, including the forces of the sand.

    They are those of the last `mj_forward` or `mj_step`, which write them to `cfrc_int` and
    `cfrc_ext` themselves if a sensor reads forces. MuJoCo's own function omits the sand.

    Args:
        model: with or without sand in it.
        data: the simulation.

    Raises:
        InputError: an argument is not a model or not its data.
    """
    check_model(model, "rne_post_constraint")
    check_data(data, "rne_post_constraint")
    mujoco.mj_rnePostConstraint(model, data)
    names = sands_in(model)
    if names:
        _includer()(model._address, data._address, instance_of(model, names[0]))


@cache
def _includer() -> Callable[..., int]:
    """Return the compiled function that includes the forces of the sand."""
    include = external_forces(find_layout(NAME))

    @compiled
    def call(model, data, first):
        return int(include(model, data, first))

    return entry(call, "int64(int64, int64, int64)")
