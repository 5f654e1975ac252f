"""Guard around a scheme's program: a snapshot of the state, and the check that needs it.

If MuJoCo finds NaN, infinite or huge numbers it resets the simulation, and the state that led to
them is lost. So compiled code stores it once per step, by `mj_getState`; `mj_setState` restores it.
"""

import math

import mujoco
import numpy as np

from mjgranular.kernel import memory
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import get_state
from mjgranular.kernel.intrinsics import call_step
from mjgranular.kernel.memory import floats, records, table_at
from mjgranular.kernel.records import options_at
from mjgranular.relief.grid import TIME
from mjgranular.scheme import wrenches
from mjgranular.scheme.scheme import BAD_STATE, FINE

_RECORD_DTYPE = np.dtype([("model", np.int64), ("data", np.int64), ("state", np.int64)])
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)

_records = records(_RECORD_DTYPE)


@compiled
def save_snapshot(table):
    """Copy the state of a simulation to its snapshot."""
    record = _records(table[memory.SNAPSHOT], 1)[0]
    get_state(record.model, record.data, record.state, _STATE)


class Snapshot:
    """The snapshot of one simulation: its `state` as of `mj_getState`, and a `record` of addresses.

    The time, the first number of the state, is NaN until a state is stored.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.state = np.full(mujoco.mj_stateSize(model, _STATE), math.nan)
        addresses = (model._address, data._address, self.state.ctypes.data)
        self.record = np.array([addresses], _RECORD_DTYPE)

    @property
    def time(self) -> float | None:
        """Return the time of the stored state [s]; None if none is stored."""
        time = float(self.state[0])
        return None if math.isnan(time) else time

    def restore(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Restore the state to `data`, including positions and velocities of bodies."""
        mujoco.mj_setState(model, data, self.state, _STATE)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)


@compiled
def forget_after_reset(table):
    """Clear a surface's memory if time has gone back: the simulation starts over."""
    state = floats(table[memory.STATE], table[memory.STATE_SIZE])
    stored = _records(table[memory.SNAPSHOT], 1)[0].state
    time = floats(stored, 1)[0]  # its first number
    if time < state[TIME]:
        for k in range(len(state)):
            state[k] = 0.0
    state[TIME] = time


@compiled
def guarded_step(program, address, lead):
    """Call a scheme's program, and keep the state that it is called with if that is good.

    A surface with memory is updated after it. Return what the program returns, or `BAD_STATE`.
    """
    table = table_at(address)
    table[memory.OFF] = wrenches.is_bad(table)
    if table[memory.OFF] != 0:
        return BAD_STATE
    save_snapshot(table)
    if table[memory.UPDATE] != 0:
        forget_after_reset(table)
    failed = call_step(program, address, lead)
    table[memory.OFF] = failed != FINE
    if table[memory.OFF] == 0 and table[memory.UPDATE] != 0:
        call_step(table[memory.UPDATE], address, 0.0)
    return failed


@compiled
def finish_step(address):
    """Remove the wrenches after `mj_step2`; return `FINE`, or `BAD_STATE` if the state is bad."""
    table = table_at(address)
    wrenches.withdraw_wrenches(table)
    table[memory.OFF] = 1
    if wrenches.is_bad(table):
        return BAD_STATE
    if table[memory.UPDATE] != 0:  # a reset after a first step takes time back too; rounding not
        state = floats(table[memory.STATE], table[memory.STATE_SIZE])
        state[TIME] += 0.5 * options_at(table).timestep
    return FINE


@compiled
def withdraw(address):
    """Remove what is left of the wrenches that a Sand wrote; return `FINE`."""
    wrenches.withdraw_wrenches(table_at(address))
    return FINE


@compiled
def add_again(address):
    """Add the wrenches that a Sand wrote last, after `withdraw`; return `FINE`."""
    wrenches.add_wrenches(table_at(address))
    return FINE
