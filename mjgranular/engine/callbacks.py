"""Callbacks of the engine: compiled, without Python, without the GIL, without allocation."""

import math
from functools import partial
from typing import Any

import numpy as np

from mjgranular.engine import tuning
from mjgranular.engine.block import (
    HEADER_DTYPE,
    POINTER_IN_MODEL,
    REFUSAL_SIZE,
    RELOCATION_DTYPE,
    SHAPE_DTYPE,
    header_at,
)
from mjgranular.engine.draw import draw
from mjgranular.engine.external import ASLEEP, update_sensors
from mjgranular.engine.handles import ROW_COUNT, find_block, find_row, row_records, rows_address
from mjgranular.engine.sensor import compute_sensors
from mjgranular.engine.trampolines import FAIL, FORGET, UNPREPARED
from mjgranular.kernel import memory
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.intrinsics import c_function, call_step
from mjgranular.kernel.memory import field, floats, ints, longs, records, row_of, table_at
from mjgranular.kernel.records import bodies_of, contacts_of, has_passive_forces, options_of
from mjgranular.kernel.vector import cross, read_vector
from mjgranular.scheme.scheme import BAD_TIMESTEP, REFUSED

Callbacks = dict[str, tuple[Any, str]]
"""Compiled functions by their fields in `mjpPlugin`, and their signatures."""

_ACTUATOR, _SENSOR, _PASSIVE = 1 << 0, 1 << 1, 1 << 2  # mjPLUGIN_ACTUATOR, ...
EXPECTED, EARLY = -1, 2
"""Of `current`: other passive forces are being computed; and those have called this sand first."""
_BEGIN = HEADER_DTYPE.itemsize
_APPLIED = int(HEADER_DTYPE.fields["applied"][1])  # pyright: ignore[reportOptionalSubscript]

_tunings = records(tuning.TUNING_DTYPE)
_states, _addresses = field("mjData", "plugin_state"), field("mjModel", "plugin_stateadr")
_relocations = records(RELOCATION_DTYPE)
_shapes = records(SHAPE_DTYPE)
_bytes = records(np.dtype(np.uint8))
_state_sizes = field("mjModel", "plugin_statenum")
_fail = c_function(FAIL, "void", "int64")
_unprepared = c_function(UNPREPARED, "void", "int64", "int64", "int32", "int32")
_forget = c_function(FORGET, "void", "int64", "int32")


@compiled
def is_reasonable(state):
    """Return True if all numbers of a state are finite, and none but the height negative."""
    for k in range(tuning.STATE_SIZE):
        if not math.isfinite(state[k]) or (k != tuning.HEIGHT and state[k] < 0.0):
            return False
    return True


@compiled
def invalidate_forces(header):
    """Set forces to NaN: MuJoCo finds them, warns and resets, as with any bad state."""
    table = table_at(header.table)
    bodies = bodies_of(table)
    forces = floats(header.qfrc, table[memory.NV])
    for slot in range(len(bodies)):
        forces[bodies[slot].last_dof] = math.nan


@compiled
def clear_results(header):
    """Clear the results for sensors and drawings."""
    table = table_at(header.table)
    bodies = bodies_of(table)
    for slot in range(len(bodies)):
        for k in range(6):
            bodies[slot].wrench[k] = 0.0
    contacts = contacts_of(table)
    for i in range(len(contacts)):
        contacts[i].depth = 0.0


@compiled
def rescale(header, state):
    """Scale the block's scene from its initial values, so that changes do not accumulate."""
    tunings = _tunings(header.tunings, header.tuning_count)
    scene = table_at(header.table)[memory.SCENE]
    for i in range(len(tunings)):
        number, value = tunings[i].number, tunings[i].base
        if number == tuning.HEIGHT:
            value += tunings[i].rate * state[tuning.HEIGHT]
        else:
            value *= state[number]
        floats(scene + 8 * tunings[i].word, 1)[0] = value


@compiled
def state_of(model, data, instance):
    """Return the address of the state of a plugin instance."""
    return _states(data) + 8 * ints(_addresses(model), instance + 1)[instance]


@compiled
def adjust(block, model, data, instance):
    """Apply the state of a tunable instance; return False if it is unreasonable.

    One `mjData` may serve many simulations in turn: each call compares with the last state applied.
    """
    header = header_at(block)
    address = state_of(model, data, instance)
    state, bits = floats(address, tuning.STATE_SIZE), longs(address, tuning.STATE_SIZE)
    applied = longs(block + _APPLIED, tuning.STATE_SIZE)
    known = header.tuned != 0
    for k in range(tuning.STATE_SIZE):
        known = known and bits[k] == applied[k]
    if not known:
        if not is_reasonable(state):
            header.tuned = 0
            clear_results(header)
            invalidate_forces(header)
            return False
        rescale(header, state)
        if state[tuning.ACTIVE] == 0.0:
            clear_results(header)
        table_at(header.table)[memory.OFF] = state[tuning.ACTIVE] == 0.0
        for k in range(tuning.STATE_SIZE):
            applied[k] = bits[k]
        header.tuned = 1
    return True


@compiled
def expect_later(header, data):
    """Flag the later sands: a sand solved before them calls them first, by its actuation."""
    number = header.later
    while number != 0:
        block = find_block(data, number)
        if block == 0:
            return
        later = header_at(block)
        later.current, number = EXPECTED, later.later


@compiled
def is_solved_later(header, data):
    """Return True if a later sand is solved, and then this one and those before it with it."""
    number = header.later
    while number != 0:
        block = find_block(data, number)
        if block == 0:
            return False
        later = header_at(block)
        if later.refused != 0 or later.program == 0:
            return False
        if later.whole != 0:
            table = table_at(header.table)
            table_at(later.table)[memory.BESIDE] = (
                table[memory.BESIDE] if table[memory.OFF] != 0 else header.table
            )
            return True
        number = later.later
    return False


@partial(compiled, inline=True)
def link_model(block, model, header):
    """Fill in the addresses of a block that point into the model."""
    relocations = _relocations(header.of_model, header.of_model_count)
    for i in range(len(relocations)):
        relocation = relocations[i]
        place = model + relocation.offset
        if relocation.kind == POINTER_IN_MODEL:
            place = longs(place, 1)[0] + relocation.delta
        longs(block + 8 * relocation.word, 1)[0] = place


@partial(compiled, inline=True)
def is_of_that_shape(header):
    """Return True if the arrays of the model have the sizes that the sand assumes."""
    shapes = _shapes(header.shape, header.shape_count)
    alike = True
    for i in range(len(shapes)):
        alike = alike and ints(shapes[i].address, 1)[0] == shapes[i].value
    return alike


@compiled
def add_wrenches(table, qfrc, awake, sign):
    """Add the bodies' wrenches to generalized forces: their power along each degree of freedom.

    Columns of `cdof` are velocities (angular, linear) about the center of mass of the tree, so the
    moment is taken there. Sleeping trees are skipped, as MuJoCo does.

    `qfrc` is the address of nv forces, `awake` that of `body_awake`; `sign` is -1.0 to remove them.
    """
    bodies = bodies_of(table)
    parent = ints(table[memory.DOF_PARENT], table[memory.NV])
    states = ints(awake, table[memory.NBODY])
    for slot in range(len(bodies)):
        body = bodies[slot]
        if states[body.body] == ASLEEP:
            continue
        f, m = sign * read_vector(body.wrench, 0), sign * read_vector(body.wrench, 3)
        if f.x == 0.0 and f.y == 0.0 and f.z == 0.0 and m.x == 0.0 and m.y == 0.0 and m.z == 0.0:
            continue
        center = read_vector(row_of(table[memory.XIPOS], body.body, 3), 0)
        m += cross(center - read_vector(row_of(table[memory.SUBTREE_COM], body.root, 3), 0), f)
        dof = body.last_dof
        while dof >= 0:
            axis = row_of(table[memory.CDOF], dof, 6)
            # In pairs: a chain of dependent sums takes twice as long.
            row_of(qfrc, dof, 1)[0] += (
                (axis[0] * m.x + axis[1] * m.y)
                + (axis[2] * m.z + axis[3] * f.x)
                + (axis[4] * f.y + axis[5] * f.z)
            )
            dof = parent[dof]


@compiled
def destroy(data, instance):
    """Free the block of an instance: MuJoCo frees the `mjData`."""
    _forget(data, instance)
    number = find_row(data, instance)
    if number == 0:
        return
    row = row_records(rows_address(), ROW_COUNT)[number]
    row.block = 0
    row.data = 0


@compiled
def copy(to, model, origin, instance):
    """Copy the results of the last step between two `mjData`."""
    ours, theirs = find_block(to, instance), find_block(origin, instance)
    if ours == 0 or theirs == 0:
        return
    mine, other = header_at(ours), header_at(theirs)
    if mine.image != other.image:
        mine.current = 1
        return
    into = _bytes(mine.results, mine.results_size)
    from_ = _bytes(other.results, other.results_size)
    for i in range(mine.results_size):
        into[i] = from_[i]
    mine.tuned, mine.current = 0, other.current


@compiled
def reset(model, state, handle, instance):
    """Reset the state of an instance, and clear the results of the last step."""
    numbers = floats(state, ints(_state_sizes(model), instance + 1)[instance])
    numbers[:] = 0.0  # the sand's memory: empty
    if len(numbers) == tuning.STATE_SIZE:
        for k in range(tuning.STATE_SIZE):
            numbers[k] = tuning.INITIAL[k]
    # A handle may be another's (`handles`), so the row must belong to the `mjData` with this state.
    if handle <= 0 or handle >= ROW_COUNT:
        return
    row = row_records(rows_address(), ROW_COUNT)[handle]
    if row.data == 0 or row.block == 0 or row.instance != instance:
        return
    if state_of(model, row.data, instance) == state:
        header = header_at(row.block)
        if header.table != 0 and header.program != 0:
            clear_results(header)


@compiled
def compute(model, data, instance, capability):
    """Add the forces of the sand to the passive forces, or update force sensors."""
    block = find_block(data, instance)
    if block == 0:
        _unprepared(model, data, instance, capability)
        return
    header = header_at(block)
    if header.refused != 0:
        _fail(block + _BEGIN)
        return
    if header.program == 0:
        return
    if capability == _SENSOR:
        update_sensors(model, data, instance, block)
        return
    table = table_at(header.table)
    if capability == _PASSIVE:
        if header.current == EARLY:  # added already
            header.current = 1
            return
        expect_later(header, data)
    elif header.current > 0 or not has_passive_forces(model):
        return
    # A batch may run this mjData on another model, or move arrays of the same.
    link_model(block, model, header)
    if capability == _ACTUATOR and header.current == 0:
        # `mjd_transitionFD` omits passive forces in steps with other controls, which change these.
        add_wrenches(table, header.qfrc, header.awake, -1.0)
    header.current = EARLY if capability == _ACTUATOR and header.current == EXPECTED else 1
    header.updating = 0  # it is still set if a user's callback raised
    if header.tuning_count != 0 and not adjust(block, model, data, instance):
        table[memory.OFF] = 1
    waits = header.whole != 0 and is_solved_later(header, data)
    if table[memory.OFF] != 0 and (waits or table[memory.BESIDE] == 0):
        return
    if not is_of_that_shape(header):
        _fail(header.refusals + REFUSAL_SIZE * (len(REFUSED) + 1))
        return
    lead = header.lead * options_of(model).timestep
    if waits:
        call_step(table[memory.SAMPLING], header.table, lead)
        return
    status = call_step(header.program, header.table, lead)
    if status <= BAD_TIMESTEP:
        _fail(header.refusals + REFUSAL_SIZE * (BAD_TIMESTEP - status))
        return
    address = header.table
    while address != 0:
        add_wrenches(table_at(address), header.qfrc, header.awake, 1.0)
        address = table_at(address)[memory.BESIDE]


@compiled
def advance(model, data, instance):
    """Update the sand's memory at the end of a step.

    Raise an error if MuJoCo computes no passive forces, since it then omits the sand's.
    """
    block = find_block(data, instance)
    if block == 0:
        return
    header = header_at(block)
    header.current = 0
    if not has_passive_forces(model):
        if header.refusals != 0:
            _fail(header.refusals + REFUSAL_SIZE * len(REFUSED))
    elif header.program != 0:
        update = table_at(header.table)[memory.UPDATE]
        if update != 0:
            link_model(block, model, header)  # a copy made between mj_step1 and mj_step2 is not yet
            call_step(update, header.table, 0.0)


@compiled
def visualize(model, data, options, scene, instance):
    """Add what the sand draws to a scene."""
    block = find_block(data, instance)
    if block == 0:
        return
    header, prints = header_at(block), False
    if header.shape_program != 0:
        link_model(block, model, header)
        prints = is_of_that_shape(header)
    draw(block, scene, model, prints)


_LIFE: Callbacks = {
    "destroy": (destroy, "void(int64, int32)"),
    "copy": (copy, "void(int64, int64, int64, int32)"),
    "reset": (reset, "void(int64, int64, int64, int32)"),
}
SAND: Callbacks = {
    **_LIFE,
    "compute": (compute, "void(int64, int64, int32, int32)"),
    "advance": (advance, "void(int64, int64, int32)"),
}
"""Callbacks of `mjgranular.sand`."""
SENSOR: Callbacks = {**_LIFE, "compute": (compute_sensors, "void(int64, int64, int32, int32)")}
"""Callbacks of `mjgranular.sensor`."""
DRAWING: Callbacks = {"visualize": (visualize, "void(int64, int64, int64, int64, int32)")}
"""Callbacks of `mjgranular.sand` that are added once something is drawn."""
