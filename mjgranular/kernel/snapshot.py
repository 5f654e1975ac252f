"""The last good state of a simulation, stored so that a bad step can be undone.

If MuJoCo finds NaN, infinite or huge numbers it resets the simulation, and the state that led to
them is lost. So compiled code stores it once per step, by `mj_getState`; `mj_setState` restores it.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import get_state
from mjgranular.kernel.memory import SNAPSHOT, floats, records

_RECORD_DTYPE = np.dtype([("model", np.int64), ("data", np.int64), ("state", np.int64)])
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)

_records = records(_RECORD_DTYPE)


@compiled
def save_snapshot(table):
    """Copy the state of a simulation to its snapshot."""
    record = _records(table[SNAPSHOT], 1)[0]
    get_state(record.model, record.data, record.state, _STATE)


@compiled
def kept_time(table):
    """Return the time of the stored state [s], its first number."""
    return floats(_records(table[SNAPSHOT], 1)[0].state, 1)[0]


class Snapshot:
    """The snapshot of one simulation.

    Attributes:
        record: addresses of the model, the data and the stored state.
        state: as of `mj_getState`; the time, its first number, is NaN until a state is stored.
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
