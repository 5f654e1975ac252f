"""Binding of a sand to one `MjData`: addresses, wrenches, the last good state."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.options import options_address
from mjgranular.kernel.records import BODY_DTYPE, CONTACT_DTYPE
from mjgranular.kernel.snapshot import Snapshot
from mjgranular.sand.prepare import PreparedSand
from mjgranular.scheme.scheme import Workspace
from mjgranular.scheme.status import EVERY_INTEGRATOR, bits_of, nanoseconds
from mjgranular.shape.select import last_dof


@dataclass(frozen=True)
class Binding:
    """Arrays that the kernels work on, for one `MjData`. Nothing is allocated after this.

    The table holds addresses in the `MjData`, which it does not keep alive: do not use a binding
    after its data is gone.
    """

    table: np.ndarray
    address: int  # address of the table, the argument of the compiled calls
    bodies: np.ndarray
    contacts: np.ndarray
    snapshot: Snapshot
    workspace: Workspace
    scene: np.ndarray
    state: np.ndarray  # state of the surface (`relief.grid`); empty without memory


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
    # As passive forces, they are computed at any stage of the integrator.
    anywhere = within and not scheme.whole_state
    workspace = scheme.workspace(model, data, elements, sand.kernel, within=within)
    scene = sand.scene
    if state is None:
        state = np.zeros(sand.surface.state_size)
    if sand.footprint is not None:
        scene = scene.copy()
        scene["surface"]["state"] = state.ctypes.data
    integrators = EVERY_INTEGRATOR if anywhere else bits_of(scheme.integrators)
    numbers = (model.nbody, model.nv, len(elements), len(bodies), integrators)
    arrays = (
        model.dof_parentid,
        data.xpos,
        data.xmat,
        data.xipos,
        data.subtree_com,
        data.cvel,
        data.cdof,
        data.qacc_warmstart,
        data.xfrc_applied,
        data.warning.number,
        sand.packed,
        bodies,
        scene,
        contacts,
        snapshot.record,
        workspace.record,
    )
    memory = (state.ctypes.data if state.size else 0, state.size, sand.update)
    surface = scene["surface"].ctypes.data - scene.ctypes.data
    table = np.array(  # in the order of `kernel.memory`
        [
            *(*numbers, nanoseconds(scheme.step_limit), options_address(model)),
            *(array.ctypes.data for array in arrays),
            *(*memory, sand.sampling, sand.forces, surface),
        ],
        np.int64,
    )
    return Binding(table, table.ctypes.data, bodies, contacts, snapshot, workspace, scene, state)
