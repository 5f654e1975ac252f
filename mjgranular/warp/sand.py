"""`WarpSand`: sand in all worlds of MuJoCo Warp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Unpack

import mujoco
import numpy as np
import warp as wp

from mjgranular._util.checks import check_count, is_finite
from mjgranular.errors import InputError, shown
from mjgranular.law import make_scene
from mjgranular.law.law import get_law
from mjgranular.medium import Medium, get_medium
from mjgranular.relief.footprint import fitting
from mjgranular.relief.heights import Heights
from mjgranular.relief.memory import as_memory
from mjgranular.relief.relief import Relief, place_in_plane
from mjgranular.sand.chosen import choose_sand
from mjgranular.sand.remembering import kernel_under, remembering
from mjgranular.sand.spec import SandFields, SandSpec, combined
from mjgranular.scheme import Auto, Implicit, get_scheme
from mjgranular.warp.constraints import Constraints
from mjgranular.warp.damping import (
    assemble_damping,
    assemble_forces,
    foresee,
    foresee_anew,
    resist_kernel,
    stop_creep,
    warm_start,
    wrenches_of_step,
)
from mjgranular.warp.fit import check_model, check_no_plugins, slots_of, slots_of_dofs, up_of
from mjgranular.warp.memory import WarpMemory
from mjgranular.warp.motions import Damping, Slot
from mjgranular.warp.records import (
    struct_of_dtype,
    struct_of_surface,
    surface_on_device,
    to_device,
)
from mjgranular.warp.room import check_room, check_room_to_remember

SOFTNESS = 1e-6
"""Speed over which rest is soft [m/s]. Chosen: what rests moves by about as
much; single precision tells a tenth of it."""

CORRECTIONS = 3
"""Times that a step's velocity is foreseen anew. Chosen: docs/warp.md has what each brings."""

# Damping of a body in a time step, in parts of the mass of its tree, at most: MuJoCo Warp
# factorizes the sum of inertia and damping in single precision. Chosen: of 1,500 Hoppers up to
# 15 cm deep a third were lost within 30 steps without it, and of 300 that were deeper still some
# with twice as much. Rest of a body is softer where its sand would be damped by more.
_MOST_DAMPING = 2e4

_OF_A_BODY = Damping.numpy_dtype()["itemsize"] + 4 * (6 + 3 + 3 + 5)
"""Bytes of a body in a world: damping, kick, force, moment, and five numbers."""


@dataclass(frozen=True)
class _Arrays:
    """What a step writes, on the device: made once, as CUDA graphs ask."""

    foreseen: wp.array  # velocities that the step is foreseen to end with, (nworld, nv)
    found: wp.array  # those that the last solution of the equations ended with
    gap: wp.array  # by how much others had been foreseen
    share: wp.array  # of the speed of sand that moves along, after its body has turned
    damping: wp.array  # of each body in the sand, (nworld, bodies)
    kick: wp.array  # and the momentum of sand that moves along already, per time
    limit: wp.array  # of static resistance to each body at its elements, summed up [N]
    creep: wp.array  # velocities that robots were stopped from, else zero, (nworld, nv)
    passive: wp.array  # other passive forces, (nworld, nv)
    fluid: wp.array  # damping by fluids, in the sparsity of the inertia matrix


class WarpSand:
    """Sand under all worlds of MuJoCo Warp: `attach` once, then plain `mujoco_warp.step`.

    Elements, laws, media and surfaces are those of `mjgranular.Sand`, and the laws' formulas the
    same source, in single precision. Forces belong to the velocity that a step ends with; they are
    solved for together with MuJoCo's constraints, by its integrator `discrete` (docs/warp.md).

    Args:
        model: the MuJoCo model that MuJoCo Warp's is made of; contacts of geoms that are the sand,
            or that it replaces, are switched off in it: make `WarpSand` before `put_model`.
        spec: the sand; see `SandSpec`.
        corrections: how often in a step the velocity at its end is foreseen anew; each costs a
            solution of MuJoCo Warp's equations. Steps take energy with any number.
        softness: speed over which rest is soft [m/s].
        fields: fields of the sand, in place of those of `spec`. `scheme` can be left out only.

    Attributes:
        bodies: names of the bodies in the sand, in the order of `force`, `moment` and `depth`.
        strength: factor on static resistance in each world, shape (nworld,), to be assigned.
        density: factor on drag and inertia of sand in each world, likewise.
        height: how much the surface is raised along its normal in each world [m], likewise.
        force: on each body in the last step [N], world frame, shape (nworld, bodies) of `wp.vec3`.
        moment: about its centre of mass [N m].
        depth: of its deepest element below the surface [m], negative above, shape (nworld,
            bodies).
        speed: greatest of its elements in the sand [m/s].
        power: of the sand on it [W], not positive but for rounding.

    Raises:
        InputError: what MuJoCo Warp has no place for: the explicit scheme, plugins in the model.
        UnknownNameError: as with `Sand`.
    """

    strength: wp.array
    density: wp.array
    height: wp.array
    force: wp.array
    moment: wp.array
    depth: wp.array
    speed: wp.array
    power: wp.array

    def __init__(
        self,
        model: mujoco.MjModel,
        spec: SandSpec | None = None,
        *,
        corrections: int = CORRECTIONS,
        softness: float = SOFTNESS,
        **fields: Unpack[SandFields],
    ) -> None:
        spec = combined(spec, fields)
        check_count("WarpSand: corrections", corrections, least=0)
        if not (is_finite(softness) and softness >= 0):
            raise InputError(
                f"WarpSand: softness is a speed [m/s], not negative; {SOFTNESS} is the default, "
                f"not {shown(softness)}"
            )
        if not isinstance(get_scheme(spec.scheme), (Auto, Implicit)):
            raise InputError(
                "in MuJoCo Warp forces always belong to the velocity at the step's end: leave "
                "scheme out"
            )
        check_no_plugins(model)
        chosen = choose_sand(model, spec)
        self.law, self.medium, self.surface = chosen.law, chosen.medium, chosen.surface
        self._model, self._elements, self._resolution = model, chosen.elements, spec.resolution
        memory, self._footprint = as_memory(spec.memory), None
        if memory is not None:
            fits = fitting(model, chosen.geoms, memory)
            self.surface, self._footprint = remembering(model, chosen, fits)
        self._memory: WarpMemory | None = None
        self._corrections, self._softness = corrections, float(softness)
        self._scene = make_scene(chosen.law, chosen.medium, self.surface, model)
        self._kernel = kernel_under(model, chosen, self.surface, self._footprint, forces_alone=True)
        self._slots, self._chain = slots_of(model, chosen.elements)
        self.bodies = tuple(model.body(int(body)).name or str(body) for body in self._slots["body"])
        self._attached_to: Any = None

    def attach(self, m: Any, d: Any) -> None:
        """Puts the sand into a model and a data of MuJoCo Warp's.

        From then on `mujoco_warp.step(m, d)` and its parts have sand in them. CUDA graphs are to be
        captured after this. The callbacks `control` and `sensor` that `m` has are called first;
        those that are to be set must be set before.

        Args:
            m: `mujoco_warp.Model` of this sand's model.
            d: `mujoco_warp.Data`, of any number of worlds.

        Raises:
            InputError: the sand is attached already, the model is another, it has an integrator or
                a flag under which sand would be left out, or the device has no room for it.
        """
        if self._attached_to is not None:
            raise InputError(
                "this sand is attached already; make another WarpSand for another model or data"
            )
        check_model(self._model, self._slots, self._chain, m)
        model, device = self._model, d.qvel.device
        self._cold = int(m.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_WARMSTART)
        n, count = d.nworld, len(self._slots)
        copied = (d.qfrc_passive, d.efm_fluid, d.efc.D, d.efc.aref)
        of_a_world = count * _OF_A_BODY + 16 * model.nv + sum(a.capacity for a in copied) // n
        check_room(device, n, of_a_world, self._elements, self._resolution)
        if isinstance(self.surface, Relief):
            check_room_to_remember(device, n, self.surface.memory)
        self._attached_to, self._device, self._size = m, device, (n, count)

        law_struct = struct_of_dtype(type(self.law).__name__, self._scene["law"].dtype)
        self._law_struct = law_struct
        self._laws = to_device(self._scene["law"], law_struct, device)
        record = self._scene["surface"]
        if isinstance(self.surface, Relief) and self._footprint is not None:
            self._memory = WarpMemory(self.surface, self._footprint, record, model, n, device)
            self._surface = self._memory.surface
        else:
            self._surface = surface_on_device(self.surface, record, model, device)
        surface_struct = struct_of_surface(self.surface, record)
        self._up = wp.vec3(*up_of(self.surface, model))
        self._resist = resist_kernel(
            self._kernel, law_struct, surface_struct, self._memory is not None
        )
        self._element_array = to_device(self._elements, self._kernel.element, device)
        self._slot_array = to_device(self._slots, Slot, device)

        def integers(values: Any) -> wp.array:
            return wp.array(np.asarray(values, np.int32), dtype=wp.int32, device=device)

        self._chain_array = integers(self._chain)
        self._dof_slots, self._dof_first = map(
            integers, slots_of_dofs(model.nv, self._slots, self._chain)
        )
        self._rows = integers(np.repeat(np.arange(model.nv), model.M_rownnz))
        self._columns = integers(model.M_colind)
        self._row_first = integers([*model.M_rowadr, len(model.M_colind)])
        roots, first = np.unique(model.body_rootid[model.dof_bodyid], return_index=True)
        self._roots, self._root_first = integers(roots), integers([*first, model.nv])

        most = _MOST_DAMPING * model.body_subtreemass[self._slots["root"]]
        self._most = wp.array(most, dtype=float, device=device)

        def zeros(shape: tuple[int, ...], kind: Any) -> wp.array:
            return wp.zeros(shape, dtype=kind, device=device)

        self.strength, self.density = (wp.ones(n, dtype=float, device=device) for _ in range(2))
        self.height = zeros((n,), float)
        self.depth, self.speed, self.power = (zeros((n, count), float) for _ in range(3))
        self.force, self.moment = zeros((n, count), wp.vec3), zeros((n, count), wp.vec3)
        self._arrays = _Arrays(
            foreseen=zeros((n, model.nv), float),
            found=zeros((n, model.nv), float),
            gap=zeros((n, model.nv), float),
            share=zeros((n, count), float),
            damping=zeros((n, count), Damping),
            kick=zeros((n, count), wp.spatial_vector),
            limit=zeros((n, count), float),
            creep=zeros((n, model.nv), float),
            passive=wp.zeros_like(d.qfrc_passive),
            fluid=wp.zeros_like(d.efm_fluid),
        )
        self._constraints = Constraints(d)
        self._control_before, self._sensor_before = m.callback.control, m.callback.sensor
        m.callback.control, m.callback.sensor = self._on_control, self._on_sensor
        m.has_fluid = True  # else the damping is not looked at

    def set_media(self, media: Sequence[str | Medium]) -> None:
        """Gives each world a medium of its own, with this sand's kind of law.

        Args:
            media: one for each world, or one for all.

        Raises:
            InputError: the sand is not attached, or so many worlds there are not.
            UnknownNameError: a medium that does not exist, or has no constants for the law.
        """
        self._check_attached("set_media")
        if isinstance(media, (str, Medium)):
            media = [media]
        if len(media) not in (1, self._size[0]):
            raise InputError(
                f"set_media takes a medium for each of the {self._size[0]} worlds, or one for "
                f"all, not {len(media)}"
            )
        found = [get_medium(medium) for medium in media]
        records = [get_law(self.law.name, medium).parameters(medium) for medium in found]
        self._laws = to_device(np.concatenate(records), self._law_struct, self._device)

    def relief(self, d: Any, world: int, middle: tuple[float, float] | None = None) -> Heights:
        """What the sand of a world remembers: heights over its surface.

        Args:
            d: `mujoco_warp.Data`.
            world: its number.
            middle: of the square that is asked for, along the axes of the surface's plane [m]; None
                for the middle of the bodies that meet the sand.

        Raises:
            InputError: the sand has no memory, or is not attached, or so many worlds there are not.
        """
        self._check_attached("relief")
        if self._memory is None or not isinstance(self.surface, Relief):
            raise InputError("this sand has no memory: WarpSand(model, memory=True) has")
        count = self._size[0]
        check_count("relief: world", world, least=0)
        if world >= count:
            raise InputError(f"relief: there are {count} worlds, 0 to {count - 1}, not {world}")
        if middle is None:
            places = d.xpos.numpy()[world, self._slots["body"]]
            middle = place_in_plane(self.surface.base, self._model, places.mean(axis=0))
        return self._memory.heights(world, middle)

    def volumes(self) -> dict[str, np.ndarray]:
        """Sand that each world has moved since it began [m^3], shape (nworld,) each.

        Returns:
            `pressed` down, `heaped` up, `forgotten` where the grid is wrapped around, and `waiting`
            for room beside a print.

        Raises:
            InputError: the sand has no memory, or is not attached.
        """
        self._check_attached("volumes")
        if self._memory is None:
            raise InputError("this sand has no memory: WarpSand(model, memory=True) has")
        return self._memory.volumes()

    def bad_worlds(self, d: Any) -> list[int]:
        """The numbers of worlds whose state is not finite; the others are not touched by them.

        `mujoco_warp.reset_data(m, d, reset)` begins them anew.
        """
        good = np.isfinite(d.qpos.numpy()).all(1) & np.isfinite(d.qvel.numpy()).all(1)
        return np.flatnonzero(~good).tolist()

    def _check_attached(self, what: str) -> None:
        if self._attached_to is None:
            raise InputError(f"{what}: attach the sand first, by sand.attach(m, d)")

    def _on_control(self, m: Any, d: Any) -> None:
        """Finds the damping of this step; where MuJoCo Warp asks for control."""
        if self._control_before is not None:
            self._control_before(m, d)
        a = self._arrays
        wp.copy(a.passive, d.qfrc_passive)
        wp.copy(a.fluid, d.efm_fluid)
        self._constraints.find(m, d)
        self._launch(
            warm_start,
            (self._size[0], self._model.nv),
            [m.opt.timestep, self._cold, d.qvel, d.qacc_warmstart, d.time, a.creep],
            [a.foreseen],
        )
        count = self._corrections
        self._resist_all(m, d, first=True, last=count == 0)
        for correction in range(count):
            self._constraints.solve(m, d)
            self._launch(
                foresee_anew,
                (self._size[0], len(self._roots)),
                [
                    *(correction > 0, self._root_first, self._row_first, m.opt.timestep),
                    *(d.M, d.qvel, d.qacc),
                ],
                [a.gap, a.found, a.foreseen],
            )
            self._resist_all(m, d, first=False, last=correction == count - 1)
        self._constraints.prepare(m, d)

    def _on_sensor(self, m: Any, d: Any, stage: Any) -> None:
        """Reads the forces that acted, once accelerations are known."""
        if self._sensor_before is not None:
            self._sensor_before(m, d, stage)
        if int(stage) != int(mujoco.mjtStage.mjSTAGE_ACC):
            return
        a = self._arrays
        self._foresee(m, d)
        self._launch(
            wrenches_of_step,
            self._size,
            [
                *(self._slot_array, self._chain_array, d.xipos, d.subtree_com, d.cdof),
                *(a.foreseen, a.damping),
            ],
            [self.force, self.moment, self.power],
        )
        self._launch(
            stop_creep,
            (self._size[0], len(self._roots)),
            [
                *(self._roots, self._root_first, self._slot_array, self._row_first, self._columns),
                *(m.opt.timestep, m.opt.sleep_tolerance, m.dof_length),
                *(d.M, d.qvel, a.foreseen, self.power),
            ],
            [a.creep, d.qacc],
        )
        if self._memory is not None:
            self._memory.update(m, d, self.height, self._up)

    def _foresee(self, m: Any, d: Any) -> None:
        shape = (self._size[0], self._model.nv)
        self._launch(foresee, shape, [m.opt.timestep, d.qvel, d.qacc], [self._arrays.foreseen])

    def _resist_all(self, m: Any, d: Any, *, first: bool, last: bool) -> None:
        """Damping at the velocities that are foreseen; its forces and its part of the metric."""
        a, n = self._arrays, self._size[0]
        self._launch(
            self._resist,
            self._size,
            [
                *(self._slot_array, self._element_array, self._laws, self._surface),
                *(self._chain_array, self._most, first, last, d.time),
                *(self.strength, self.density, self.height),
                *(self._up, self._softness, m.opt.timestep, m.opt.gravity),
                *(d.xpos, d.xmat, d.xipos, d.subtree_com, d.cvel, d.cdof, d.cdof_dot, d.qvel),
                *(a.foreseen, a.found, a.gap),
            ],
            [a.share, a.damping, a.kick, self.depth, self.speed, a.limit],
        )
        of_dofs = [self._dof_slots, self._dof_first]
        self._launch(
            assemble_forces,
            (n, self._model.nv),
            [self._slot_array, *of_dofs, d.cdof, d.cvel, a.damping, a.kick, a.passive],
            [d.qfrc_passive],
        )
        self._launch(
            assemble_damping,
            (n, len(self._rows)),
            [self._rows, self._columns, *of_dofs, m.opt.timestep, d.cdof, a.damping, a.fluid],
            [d.efm_fluid],
        )

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any], outputs: list[Any]) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device)
