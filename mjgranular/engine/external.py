"""The sand's forces among the external forces on bodies: in `cfrc_ext` and in force sensors.

MuJoCo computes these (`mj_rnePostConstraint`) from contacts, constraints and `xfrc_applied`. Of
passive forces it only has the components along joints. So during one call the sand's wrenches are
in `xfrc_applied`: no user code runs meanwhile, and the rows are restored to the last bit.
Everywhere else the sand is a passive force, as `mj_inverse` expects.

MuJoCo calls plugins after its own sensors of the acceleration stage, whose values then lack the
sand. If there are such sensors, they are computed again.
"""

import mujoco

from mjgranular._util.checks import check_kind
from mjgranular.engine.block import header_at
from mjgranular.engine.handles import find_block
from mjgranular.engine.instances import instance_of, sands_in
from mjgranular.kernel.compiled import compiled, entry
from mjgranular.kernel.engine import forces_on_bodies, sensors_of_acceleration
from mjgranular.kernel.memory import NBODY, field, ints, row_of, table_at
from mjgranular.kernel.records import bodies_of, has_passive_forces

ASLEEP = int(mujoco.mjtSleepState.mjS_ASLEEP)
"""Value of `body_awake` for bodies that MuJoCo skips."""

_plugins = field("mjModel", "plugin")


@compiled
def add_wrenches_of(header):
    """Add the wrenches of a sand to `xfrc_applied`, after saving it; return if there are any."""
    table = table_at(header.table)
    bodies = bodies_of(table)
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
def remove_wrenches_of(header):
    """Restore what `add_wrenches_of` saved."""
    bodies = bodies_of(table_at(header.table))
    for slot in range(len(bodies)):
        body = bodies[slot]
        row = row_of(header.xfrc, body.body, 6)
        for k in range(6):
            row[k] = body.user_wrench[k]


@compiled
def include_sand(model, data, first):
    """Include the wrenches of all sands in the external forces; return whether there are any.

    The first of their instances has the index `first`.
    """
    block = find_block(data, first)
    if block == 0 or not has_passive_forces(model):
        return False
    count = header_at(block).instances
    kinds = ints(_plugins(model), count)
    some = False
    for instance in range(first, count):
        block = find_block(data, instance) if kinds[instance] == kinds[first] else 0
        if block != 0 and header_at(block).program != 0:
            some = add_wrenches_of(header_at(block)) or some
    if some:
        forces_on_bodies(model, data)
    for instance in range(count - 1, first - 1, -1):  # the last of two on a body goes first
        block = find_block(data, instance) if kinds[instance] == kinds[first] else 0
        if block != 0 and header_at(block).program != 0:
            remove_wrenches_of(header_at(block))
    return some


@compiled
def update_sensors(model, data, instance, block):
    """Compute force sensors again, with the forces of the sand.

    MuJoCo calls this for each sand, after its own sensors; the first call handles all sands.
    """
    kinds = ints(_plugins(model), instance + 1)
    for other in range(instance):
        if kinds[other] == kinds[instance]:
            return
    header = header_at(block)
    if header.senses == 0:  # not needed, and it takes a tenth of a small robot's step
        return
    if header.updating != 0:  # called from the call below
        header.updating = 0
        return
    if include_sand(model, data, instance):
        header.updating = 1
        sensors_of_acceleration(model, data)
        header.updating = 0


def rne_post_constraint(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Do what `mujoco.mj_rnePostConstraint` does, including the forces of the sand.

    They are those of the last `mj_forward` or `mj_step`, which write them to `cfrc_int` and
    `cfrc_ext` themselves if a sensor reads forces. MuJoCo's own function omits the sand.

    Raises:
        InputError: an argument is not a model or not its data.
    """
    check_kind(model, mujoco.MjModel, "rne_post_constraint")
    check_kind(data, mujoco.MjData, "rne_post_constraint")
    mujoco.mj_rnePostConstraint(model, data)
    names = sands_in(model)
    if names:
        include = entry(include_sand, "boolean(int64, int64, int64)")
        include(model._address, data._address, instance_of(model, names[0]))
