"""The sand among the external forces on bodies: in `cfrc_ext`, and so in sensors of force.

MuJoCo works these out (`mj_rnePostConstraint`) from contacts, constraints and `xfrc_applied`. Of
passive forces it knows only what they do along joints. So for the time of one call the sand's
wrenches are in `xfrc_applied`: none of the user's code runs meanwhile, and the rows are put back to
the last bit. Everywhere else the sand stays a passive force, as `mj_inverse` takes it.

MuJoCo asks plugins after its own sensors of the acceleration stage, which have then read what is
without sand. Where there are such, they are computed again.
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
"""Value of `body_awake` for bodies that MuJoCo leaves alone."""

_header = records(HEADER_DTYPE)


@compiled
def lay_wrenches(header):
    """Adds the wrenches of a sand to `xfrc_applied`, and keeps what was there.

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
            body.own[k] = row[k]
        if states[body.body] != ASLEEP:
            for k in range(6):
                some = some or body.wrench[k] != 0.0
                row[k] += body.wrench[k]
    return some


@compiled
def lift_wrenches(header):
    """Puts back what `lay_wrenches` has kept."""
    table = table_at(header.table)
    bodies = body_records(table[BODIES], table[BODY_COUNT])
    for slot in range(len(bodies)):
        body = bodies[slot]
        row = row_of(header.xfrc, body.body, 6)
        for k in range(6):
            row[k] = body.own[k]


@cache
def external_forces(layout: Layout) -> Any:
    """A compiled function `include(model, data, first)`: forces on bodies with the sands in them.

    It takes the number of the first instance of sand, and says whether there are any of its forces.
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
        for instance in range(count - 1, first - 1, -1):  # of two on one body the last goes first
            block = find_block(data, instance) if kinds[instance] == kinds[first] else 0
            if block != 0 and _header(block, 1)[0].program != 0:
                lift_wrenches(_header(block, 1)[0])
        return some

    return include


@cache
def sensor_teller(layout: Layout) -> Any:
    """A compiled function `tell(model, data, instance, block)`: sensors get to know of the sand.

    MuJoCo calls it for each sand, after its own sensors; the first serves all.
    """
    include, plugin = external_forces(layout), layout.plugin

    @compiled
    def tell(model, data, instance, block):
        kinds = ints(longs(model + plugin, 1)[0], instance + 1)
        for other in range(instance):
            if kinds[other] == kinds[instance]:
                return
        header = _header(block, 1)[0]
        if header.senses == 0:  # nobody asks, and it takes a tenth of a small robot's step
            return
        if header.telling != 0:  # it is the call below that has led here
            header.telling = 0
            return
        if include(model, data, instance):
            header.telling = 1
            sensors_of_acceleration(model, data)
            header.telling = 0

    return tell


def rne_post_constraint(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Does what `mujoco.mj_rnePostConstraint` does, with the forces of the sand in it.

    They are those of the last `mj_forward` or `mj_step`, which leave them in `cfrc_int` and
    `cfrc_ext` by themselves where a sensor reads forces. MuJoCo's own function leaves the sand out.

    Args:
        model: with or without sand in it.
        data: the simulation.

    Raises:
        InputError: something else than a model and its data.
    """
    check_model(model, "rne_post_constraint")
    check_data(data, "rne_post_constraint")
    mujoco.mj_rnePostConstraint(model, data)
    names = sands_in(model)
    if names:
        _includer()(model._address, data._address, instance_of(model, names[0]))


@cache
def _includer() -> Callable[..., int]:
    """The compiled function that includes the forces of the sand."""
    include = external_forces(find_layout(NAME))

    @compiled
    def call(model, data, first):
        return int(include(model, data, first))

    return entry(call, "int64(int64, int64, int64)")
