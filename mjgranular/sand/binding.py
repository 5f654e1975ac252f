"""Binding of a sand to one `MjData`: addresses, wrenches, the last good state.

A registry has the sands of each simulation: one per body, unless all of them are shared.
"""

import math
import weakref
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel import memory
from mjgranular.kernel.compiled import compiled, entry
from mjgranular.kernel.engine import get_state
from mjgranular.kernel.intrinsics import call_step
from mjgranular.kernel.memory import BESIDE, OFF, floats, records, table_at
from mjgranular.kernel.records import BODY_DTYPE, CONTACT_DTYPE, options_address, options_at
from mjgranular.relief.grid import TIME
from mjgranular.sand.prepare import PreparedSand
from mjgranular.scheme import wrenches
from mjgranular.scheme.scheme import BAD_STATE, FINE, Workspace, nanoseconds
from mjgranular.shape.select import body_name, last_dof

# Guard around a scheme's program: a snapshot of the state, and the check that needs it. If MuJoCo
# finds NaN, infinite or huge numbers it resets the simulation, and the state that led to them is
# lost. So compiled code stores it once per step, by `mj_getState`; `mj_setState` restores it.

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


@dataclass(frozen=True)
class Binding:
    """Arrays that the kernels work on, for one `MjData`. Nothing is allocated after this.

    It is valid as long as the `MjData`, to whose arrays its table has addresses.
    """

    table: np.ndarray
    address: int  # address of the table, the argument of the compiled calls
    bodies: np.ndarray
    contacts: np.ndarray
    snapshot: Snapshot
    workspace: Workspace
    scene: np.ndarray
    state: np.ndarray  # state of the surface (`relief.grid`); empty without memory
    joins: bool  # whether it is solved together with others


def bind(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    sand: PreparedSand,
    *,
    within: bool = False,
    state: np.ndarray | None = None,
) -> Binding:
    """Make the binding of a prepared sand to a simulation of the model that it was prepared for.

    `within` says whether its forces are passive ones, computed inside MuJoCo's step. `state` is
    memory for the state of the surface; None to allocate an array of untouched sand.
    """
    elements, scheme = sand.elements, sand.scheme
    slots, first, counts = np.unique(elements["slot"], return_index=True, return_counts=True)
    ends = np.cumsum(counts)
    if not np.array_equal(elements["slot"], np.repeat(np.arange(len(slots)), counts)):
        raise InputError("the elements of a law must come body by body, their slots 0, 1, 2, ...")
    bodies = np.zeros(len(slots), BODY_DTYPE)
    for row, body, end in zip(bodies, elements["body"][first], ends, strict=True):
        row["body"], row["end"] = body, end
        row["root"] = model.body_rootid[body]
        row["last_dof"] = last_dof(model, int(body))
    bodies["last_wrench"] = np.nan  # NaN equals nothing: the first rows found are the user's
    contacts = np.zeros(len(elements), CONTACT_DTYPE)
    snapshot = Snapshot(model, data)
    workspace = scheme.workspace(model, data, sand.kernel, len(sand.packed), within)
    scene = sand.scene
    if state is None:
        state = np.zeros(sand.surface.state_size)
    if sand.footprint is not None:
        scene = scene.copy()
        scene["surface"]["state"] = state.ctypes.data
    numbers = (model.nbody, model.nv, len(elements), len(bodies))
    arrays = (
        model.dof_parentid, data.xpos, data.xmat, data.xipos, data.subtree_com, data.cvel,
        data.cdof, data.qacc_warmstart, data.xfrc_applied, data.warning.number,
        sand.packed, bodies, scene, contacts, snapshot.record, workspace.record,
    )  # fmt: skip
    memory = (state.ctypes.data if state.size else 0, state.size, sand.update)
    surface = scene["surface"].ctypes.data - scene.ctypes.data
    table = np.array(  # in the order of `kernel.memory`
        [
            *(*numbers, nanoseconds(scheme.step_limit), options_address(model)),
            *(array.ctypes.data for array in arrays),
            *(*memory, sand.sampling, sand.forces, surface, 0, 0),
        ],
        np.int64,
    )
    return Binding(
        table, table.ctypes.data, bodies, contacts, snapshot, workspace, scene, state,
        scheme.whole_state,
    )  # fmt: skip


_sands_of_model: list[Callable[[mujoco.MjModel], Iterable[tuple[str, set[int]]]]] = []

ask_about_models = _sands_of_model.append
"""Register a function that returns a model's own sands: names, and ids of the bodies acted on."""


def find_sand_of_the_model(model: mujoco.MjModel, elements: np.ndarray) -> str:
    """Return which of the model's own sands acts on one of these bodies, in words; "" for none."""
    ours = set(elements["body"].tolist())
    for sands_of_model in _sands_of_model:
        for name, bodies in sands_of_model(model):
            common = ours & bodies
            if common:
                return (
                    f"the plugin instance {name!r}, which acts on body "
                    f"{body_name(model, min(common))}"
                )
    return ""


class SandRegistry:
    """The Sands that act on one `MjData`, and their shares in its `xfrc_applied`."""

    def __init__(self) -> None:
        # The bodies of each Sand, and whether it is shared.
        self._members = weakref.WeakKeyDictionary[Any, tuple[set[int], bool]]()
        self._shares: list[Binding] = []  # in the order they were added

    @property
    def is_crowded(self) -> bool:
        """Whether more than one Sand acts, or did until now and is gone."""
        return len(self._members) > 1 or len(self._shares) > 1

    def add(self, sand: Any, model: mujoco.MjModel, binding: Binding, *, shared: bool) -> None:
        """Register a Sand; raise if another acts on one of its bodies, and not both are shared."""
        bodies = set(binding.bodies["body"].tolist())
        for others, is_shared in list(self._members.values()):
            common = bodies & others
            if common and not (shared and is_shared):
                raise InputError(
                    f"another Sand acts on body {body_name(model, min(common))} of this MjData: "
                    "make an MjData for each, make both with shared=True if both are to act (two "
                    "beds, say), or have the other one release(data) first"
                )
        for other in self._members:
            other.forget_last()
        self._members[sand] = bodies, shared

    def remove(self, sand: Any, binding: Binding) -> None:
        """Remove a Sand, and its share too."""
        self._members.pop(sand)
        if self._shares:
            self._withdraw_all()
        else:
            _withdraw(binding)

    def begin(self, binding: Binding, time: float) -> None:
        """Prepare for the share of a Sand at a time [s].

        The first that comes at another time, or for a second time, begins a new step: the shares of
        the last step are removed. So does one after a `Sand.step`, or a failure. All others that
        can be are solved together, and the rest acts before them.
        """
        if len(self._shares) == 1 and self._shares[0] is binding:
            return
        if any(
            share is binding or share.table[OFF] or share.snapshot.time != time
            for share in self._shares
        ):
            self._withdraw_all()
        together = [share for share in self._shares if share.joins and binding.joins]
        if together and not self._shares[-1].joins:
            self._put_last(together)
        binding.table[BESIDE] = together[-1].address if together else 0
        self._shares.append(binding)

    def before(self, binding: Binding) -> list[Binding]:
        """Return the shares that a Sand's own does not act in addition to, the latest first.

        These are its own, those that have come since, and those that are solved with it.
        """
        for number, share in enumerate(self._shares):
            if share is binding or (share.joins and binding.joins):
                return self._shares[number:][::-1]
        return [binding]

    def others(self, sand: Any) -> list[Any]:
        return [other for other in self._members if other is not sand]

    def _put_last(self, together: list[Binding]) -> None:
        """Put the shares that are solved together after all others; they are yet to be added."""
        first = [share for share in self._shares if not share.joins]
        self._withdraw_all()
        for share in first:
            entry(add_again, "int64(int64)")(share.address)
        self._shares = first + together

    def _withdraw_all(self) -> None:
        """Take all shares back, the latest first: each finds the row as it left it."""
        while self._shares:
            _withdraw(self._shares.pop())


def _withdraw(binding: Binding) -> None:
    entry(withdraw, "int64(int64)")(binding.address)


_registries: weakref.WeakKeyDictionary[mujoco.MjData, SandRegistry] = weakref.WeakKeyDictionary()


def registry_of(data: mujoco.MjData) -> SandRegistry:
    """Return the registry of the Sands that act on `data`; empty at first."""
    found = _registries.get(data)
    return _registries.setdefault(data, SandRegistry()) if found is None else found
