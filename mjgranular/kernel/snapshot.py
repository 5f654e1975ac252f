"""The last good state of a simulation, stored so that a bad step can be undone.

If MuJoCo finds NaN, infinite or huge numbers it resets the simulation, and the state that led to
them is lost. So a few doubles are copied once per step, in compiled code, in the layout of
`mj_getState`; `mj_setState` restores them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import SNAPSHOT, floats, records

_SPAN_DTYPE = np.dtype([("source", np.int64), ("target", np.int64), ("size", np.int64)])
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
# Its arrays in its order, except for the time, which comes first.
_PARTS = [
    "qpos", "qvel", "act", "history", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied",
    "eq_active", "mocap_pos", "mocap_quat", "userdata", "plugin_state",
]  # fmt: skip
if hasattr(mujoco.mjtState, "mjSTATE_PLASTIC"):  # MuJoCo before 4.0 has no plasticity
    _PARTS.append("plastic")
_MOST = len(_PARTS) + 2  # spans: one per part, the time, the end

_spans = records(_SPAN_DTYPE)
_bytes = records(np.dtype(np.uint8))


@compiled
def save_snapshot(table):
    """Copy the state of a simulation to its snapshot."""
    spans = _spans(table[SNAPSHOT], _MOST)
    first = spans[0]
    flags, kept = _bytes(first.source, first.size), floats(first.target, first.size)
    for i in range(first.size):
        kept[i] = flags[i]
    k = 1
    while spans[k].size > 0:
        span = spans[k]
        values, kept = floats(span.source, span.size), floats(span.target, span.size)
        for i in range(span.size):
            kept[i] = values[i]
        k += 1


@compiled
def kept_time(table):
    """Return the time of the stored state [s]."""
    return floats(_spans(table[SNAPSHOT], _MOST)[1].target, 1)[0]


@dataclass(frozen=True)
class Snapshot:
    """The snapshot of one simulation, and the spans that are copied to it.

    Attributes:
        spans: source, destination, and number of values of each copy: those of bytes (`eq_active`),
            then those of doubles, then an end of size 0.
        state: as of `mj_getState`; the time, its first number, is NaN until a state is stored.
    """

    spans: np.ndarray
    state: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel, data: mujoco.MjData) -> Snapshot:
        """Allocate an empty snapshot for the state of `data`."""
        state = np.full(mujoco.mj_stateSize(model, _STATE), math.nan)
        # Python has no address of `time`: in mjdata.h it is the number before `energy`.
        spans = [(data.energy.ctypes.data - data.energy.itemsize, state.ctypes.data, 1)]
        target = state[1:].ctypes.data
        for name in _PARTS:
            array = getattr(data, name)
            span = (array.ctypes.data, target, array.size)
            if name == "eq_active":
                spans.insert(0, span)
            elif array.size:
                spans.append(span)
            target += array.size * state.itemsize
        return cls(np.array([*spans, (0, 0, 0)], _SPAN_DTYPE), state)

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
