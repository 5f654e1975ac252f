"""`WarpSand`: sand in thousands of worlds, for MuJoCo Warp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Unpack

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from mjgranular.errors import InputError
from mjgranular.law import make_scene
from mjgranular.sand.chosen import choose_sand
from mjgranular.sand.spec import SandFields, SandSpec, combined
from mjgranular.warp.damping import (
    SLOT_DTYPE,
    Damping,
    Slot,
    assemble_damping,
    assemble_forces,
    foresee,
    resist_kernel,
    wrenches_of_step,
)
from mjgranular.warp.records import struct_of_dtype, surface_on_device, to_device

SOFTNESS = 1e-5
"""Speed over which rest is soft [m/s]: single precision tells no less. Chosen, not measured."""


@dataclass
class _Attached:
    """What belongs to one model and data of MuJoCo Warp's: all arrays of a step, made once."""

    foreseen: wp.array
    damping: wp.array
    kick: wp.array
    depth: wp.array
    passive: wp.array
    fluid: wp.array
    regularization: wp.array
    reference: wp.array
    force: wp.array
    moment: wp.array


class WarpSand:
    """Sand under every world of MuJoCo Warp.

    Takes what `mjgranular.Sand` takes; elements, formulas and constants are the same, in single
    precision. `attach` puts it into a model and data of MuJoCo Warp's; from then on
    `mujoco_warp.step` has sand in it, CUDA graphs included.
    """

    SHARES = (1.0,)

    def __init__(
        self,
        model: mujoco.MjModel,
        spec: SandSpec | None = None,
        *,
        corrections: int = 3,
        softness: float = SOFTNESS,
        **fields: Unpack[SandFields],
    ) -> None:
        spec = combined(spec, fields)
        chosen = choose_sand(model, spec)
        self._model, self._chosen = model, chosen
        self._corrections, self._softness = corrections, softness
        self._scene = make_scene(chosen.law, chosen.medium, chosen.surface, model)
        self._kernel = chosen.law.kernel_of_forces(chosen.surface)
        self._slots, self._chain = slots_of(model, chosen.elements)
        self.bodies = tuple(model.body(int(s["body"])).name for s in self._slots)

    def attach(self, m: Any, d: Any) -> None:
        """Puts the sand into a model and data of MuJoCo Warp's."""
        if m.opt.integrator != mujoco.mjtIntegrator.mjINT_DISCRETE:
            raise InputError(
                "sand has a place in MuJoCo Warp's steps of the integrator 'discrete' only; "
                "set mjm.opt.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE before put_model"
            )
        device, n, count = d.qvel.device, d.nworld, len(self._slots)
        model = self._model
        self._device = device
        law_kind = struct_of_dtype("Law", self._scene["law"].dtype)
        self._laws = to_device(self._scene["law"], law_kind, device)
        surface_kind, surface = surface_on_device(
            self._chosen.surface, self._scene["surface"], model, device
        )
        self._surfaces = surface
        self._resist = resist_kernel(self._kernel, law_kind, surface_kind)
        self._elements = to_device(self._chosen.elements, self._kernel.element, device)
        self._slot_array = to_device(self._slots, Slot, device)
        self._chain_array = wp.array(self._chain, dtype=wp.int32, device=device)
        dof_slots, dof_first = slots_of_dofs(model, self._slots, self._chain)
        self._dof_slots = wp.array(dof_slots, dtype=wp.int32, device=device)
        self._dof_first = wp.array(dof_first, dtype=wp.int32, device=device)
        rows = np.repeat(np.arange(model.nv), model.M_rownnz)
        self._rows = wp.array(rows, dtype=wp.int32, device=device)
        self._columns = wp.array(model.M_colind, dtype=wp.int32, device=device)
        self.strength = wp.ones(n, dtype=float, device=device)
        self.density = wp.ones(n, dtype=float, device=device)
        self.height = wp.zeros(n, dtype=float, device=device)
        self._a = _Attached(
            foreseen=wp.zeros((n, model.nv), dtype=float, device=device),
            damping=wp.zeros((n, count), dtype=Damping, device=device),
            kick=wp.zeros((n, count), dtype=wp.spatial_vector, device=device),
            depth=wp.zeros((n, count), dtype=float, device=device),
            passive=wp.zeros_like(d.qfrc_passive),
            fluid=wp.zeros_like(d.efm_fluid),
            regularization=wp.zeros_like(d.efc.D),
            reference=wp.zeros_like(d.efc.aref),
            force=wp.zeros((n, count), dtype=wp.vec3, device=device),
            moment=wp.zeros((n, count), dtype=wp.vec3, device=device),
        )
        self._rise = wp.vec3(0.0, 0.0, 1.0)
        self._before = m.callback.control
        m.callback.control = self._control
        m.callback.sensor = self._sensor
        m.has_fluid = True

    def _control(self, m: Any, d: Any) -> None:
        if self._before is not None:
            self._before(m, d)
        a = self._a
        wp.copy(a.passive, d.qfrc_passive)
        wp.copy(a.fluid, d.efm_fluid)
        wp.copy(a.foreseen, d.qvel)
        self._resist_all(m, d)
        if not self._corrections:
            return
        wp.copy(a.regularization, d.efc.D)
        wp.copy(a.reference, d.efc.aref)
        for k in range(self._corrections):
            mjw.fwd_actuation(m, d)
            mjw.fwd_acceleration(m, d, factorize=True)
            mjw.solve(m, d)
            wp.copy(d.efc.D, a.regularization)
            wp.copy(d.efc.aref, a.reference)
            self._foresee(m, d, self.SHARES[min(k, len(self.SHARES) - 1)])
            self._resist_all(m, d)

    def _foresee(self, m: Any, d: Any, share: float) -> None:
        wp.launch(
            foresee,
            dim=(d.nworld, m.nv),
            inputs=[m.opt.timestep, d.qvel, d.qacc, share],
            outputs=[self._a.foreseen],
            device=self._device,
        )

    def _resist_all(self, m: Any, d: Any) -> None:
        a = self._a
        wp.launch(
            self._resist,
            dim=(d.nworld, len(self._slots)),
            inputs=[
                self._slot_array,
                self._elements,
                self._laws,
                self._surfaces,
                self._chain_array,
                self.strength,
                self.density,
                self.height,
                self._rise,
                self._softness,
                m.opt.timestep,
                m.opt.gravity,
                d.xpos,
                d.xmat,
                d.xipos,
                d.subtree_com,
                d.cvel,
                d.cdof,
                a.foreseen,
            ],
            outputs=[a.damping, a.kick, a.depth],
            device=self._device,
        )
        wp.launch(
            assemble_forces,
            dim=(d.nworld, m.nv),
            inputs=[
                self._slot_array,
                self._dof_slots,
                self._dof_first,
                d.cdof,
                d.cvel,
                a.damping,
                a.kick,
                a.passive,
            ],
            outputs=[d.qfrc_passive],
            device=self._device,
        )
        wp.launch(
            assemble_damping,
            dim=(d.nworld, len(self._rows)),
            inputs=[
                self._rows,
                self._columns,
                self._dof_slots,
                self._dof_first,
                m.opt.timestep,
                d.cdof,
                a.damping,
                a.fluid,
            ],
            outputs=[d.efm_fluid],
            device=self._device,
        )

    def _sensor(self, m: Any, d: Any, stage: Any) -> None:
        if stage != mujoco.mjtStage.mjSTAGE_ACC:
            return
        a = self._a
        self._foresee(m, d, 1.0)
        wp.launch(
            wrenches_of_step,
            dim=(d.nworld, len(self._slots)),
            inputs=[
                self._slot_array,
                self._chain_array,
                d.subtree_com,
                d.xipos,
                d.cdof,
                a.foreseen,
                a.damping,
                a.kick,
            ],
            outputs=[a.force, a.moment],
            device=self._device,
        )


def slots_of(model: mujoco.MjModel, elements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The bodies in the sand, and the degrees of freedom that move each, one after the other."""
    bodies = [int(elements["body"][k]) for k in np.unique(elements["slot"], return_index=True)[1]]
    ends = np.cumsum(np.bincount(elements["slot"]))
    slots = np.zeros(len(bodies), SLOT_DTYPE)
    chain: list[int] = []
    for slot, body, end in zip(slots, bodies, ends, strict=True):
        slot["body"], slot["root"] = body, model.body_rootid[body]
        slot["end"] = end
        slot["chain"] = len(chain)
        while body and not model.body_dofnum[body]:
            body = int(model.body_parentid[body])
        dof = int(model.body_dofadr[body] + model.body_dofnum[body]) - 1 if body else -1
        while dof >= 0:
            chain.append(dof)
            dof = int(model.dof_parentid[dof])
        slot["chain_end"] = len(chain)
    slots["first"][1:] = ends[:-1]
    return slots, np.array(chain, np.int32)


def slots_of_dofs(
    model: mujoco.MjModel, slots: np.ndarray, chain: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """For each degree of freedom the bodies in the sand that it moves.

    Returns:
        Rows of `slots`, one degree of freedom after the other; and where each begins, nv + 1.
    """
    moved: list[list[int]] = [[] for _ in range(model.nv)]
    for s, slot in enumerate(slots):
        for dof in chain[slot["chain"] : slot["chain_end"]]:
            moved[dof].append(s)
    first = np.cumsum([0, *(len(each) for each in moved)])
    return np.array([s for each in moved for s in each], np.int32), first.astype(np.int32)
