"""Apply the state of a tunable sand (`tuning`) to its block: compiled, at each step."""

from __future__ import annotations

import math

from mjgranular.engine.block import HEADER_DTYPE, header_at
from mjgranular.engine.tuning import ACTIVE, DENSITY, HEIGHT, STATE_SIZE, STRENGTH, TUNING_DTYPE
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import NV, SCENE, field, floats, ints, longs, records, table_at
from mjgranular.kernel.records import bodies_of, contacts_of

_tunings = records(TUNING_DTYPE)
_states, _addresses = field("mjData", "plugin_state"), field("mjModel", "plugin_stateadr")
_APPLIED = int(HEADER_DTYPE.fields["applied"][1])  # pyright: ignore[reportOptionalSubscript]


@compiled
def is_reasonable(state):
    """Return True if all numbers of a state are finite, and none but the height negative."""
    for k in range(STATE_SIZE):
        if not math.isfinite(state[k]) or (k != HEIGHT and state[k] < 0.0):
            return False
    return True


@compiled
def invalidate_forces(header):
    """Set forces to NaN: MuJoCo finds them, warns and resets, as with any bad state."""
    table = table_at(header.table)
    bodies = bodies_of(table)
    forces = floats(header.qfrc, table[NV])
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
    count = header.tuning_count
    tunings = _tunings(header.tunings, count)
    scene = table_at(header.table)[SCENE]
    for i in range(count):
        tuning = tunings[i]
        value = tuning.base
        if tuning.number == STRENGTH:
            value *= state[STRENGTH]
        elif tuning.number == DENSITY:
            value *= state[DENSITY]
        else:
            value += tuning.rate * state[HEIGHT]
        floats(scene + 8 * tuning.word, 1)[0] = value


@compiled
def state_of(model, data, instance):
    """Return the address of the state of a plugin instance."""
    return _states(data) + 8 * ints(_addresses(model), instance + 1)[instance]


@compiled
def adjust(block, model, data, instance):
    """Apply the state of a tunable instance; return whether forces are to be computed.

    One `mjData` may serve many simulations in turn, so each call compares the state with the one
    last applied, bit by bit.
    """
    header = header_at(block)
    address = state_of(model, data, instance)
    state, bits = floats(address, STATE_SIZE), longs(address, STATE_SIZE)
    applied = longs(block + _APPLIED, STATE_SIZE)
    known = header.tuned != 0
    for k in range(STATE_SIZE):
        known = known and bits[k] == applied[k]
    if not known:
        if not is_reasonable(state):
            header.tuned = 0
            clear_results(header)
            invalidate_forces(header)
            return False
        rescale(header, state)
        if state[ACTIVE] == 0.0:
            clear_results(header)
        for k in range(STATE_SIZE):
            applied[k] = bits[k]
        header.tuned = 1
    return state[ACTIVE] != 0.0
