"""`WarpSand`: sand in all worlds of MuJoCo Warp."""

from collections.abc import Sequence
from typing import Any, Unpack

import mujoco
import numpy as np
import warp as wp

from mjgranular._util.checks import check_count, check_kind, is_finite
from mjgranular.errors import InputError, shown
from mjgranular.kernel.records import NO_GRAVITY
from mjgranular.law import make_scene
from mjgranular.law.law import get_law
from mjgranular.medium import Medium, get_medium
from mjgranular.relief.footprint import fitting
from mjgranular.relief.memory import Heights, as_memory
from mjgranular.relief.relief import Relief, place_in_plane
from mjgranular.sand.prepare import Original, choose_sand, remembering
from mjgranular.sand.spec import SandFields, SandSpec, combined
from mjgranular.scheme import Auto, Implicit, get_scheme
from mjgranular.warp import damping, fit, translate
from mjgranular.warp.memory import WarpMemory
from mjgranular.warp.motions import Damping, Slot
from mjgranular.warp.translate import to_device

SOFTNESS = 1e-6
"""Speed over which rest is softened [m/s]; chosen: single precision resolves a tenth of it."""

CORRECTIONS = 3
"""Corrections of the predicted velocity per step. Chosen: docs/warp.md shows the effect of each."""

# Upper bound on a body's damping in a time step, relative to the mass of its tree: MuJoCo Warp
# factorizes the sum of inertia and damping in single precision. Chosen: without it a third of 1,500
# Hoppers up to 15 cm deep diverged within 30 steps; with twice as much some of 300 deeper ones did.
# Rest of a body is softer where its sand would exceed this damping.
_MOST_DAMPING = 2e4


class WarpSand:
    """Sand under all worlds of MuJoCo Warp: `attach` once, then plain `mujoco_warp.step`.

    Elements, laws, media and surfaces are those of `mjgranular.Sand`; the laws' formulas come from
    the same source, in single precision. Forces are functions of the velocity at the end of a step
    and are solved together with MuJoCo's constraints, by its integrator `discrete` (docs/warp.md).

    Args:
        model: MuJoCo model that the MuJoCo Warp model is made of. Contacts of geoms that are the
            sand, or that it replaces, are disabled in it: make `WarpSand` before `put_model`.
        spec: the sand; see `SandSpec`.
        corrections: how often per step the predicted final velocity is corrected; each correction
            costs one solution of MuJoCo Warp's equations. Steps dissipate energy with any number.
        softness: speed over which rest is softened [m/s].
        fields: fields of the sand, in place of those of `spec`; `scheme` must be omitted.

    Attributes:
        bodies: names of the bodies in the sand, in the order of `force`, `moment` and `depth`.
        strength: factor on static resistance in each world, shape (nworld,), assignable.
        density: factor on drag and inertia of sand in each world, shape (nworld,), assignable.
        height: how much each world's surface is raised along its normal [m], (nworld,), assignable.
        force: on each body in the last step [N], world frame, `wp.vec3`, shape (nworld, bodies).
        moment: moment on each body about its center of mass [N m].
        depth: of each body's deepest element [m], negative above the sand, shape (nworld, bodies).
        speed: greatest speed of each body's elements in the sand as the step begins [m/s].
        power: power of the sand on each body [W], not positive except for rounding.

    Raises:
        InputError: MuJoCo Warp does not support it: the explicit scheme, plugins in the model.
        UnknownNameError: as with `Sand`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        spec: SandSpec | None = None,
        *,
        corrections: int = CORRECTIONS,
        softness: float = SOFTNESS,
        **fields: Unpack[SandFields],
    ) -> None:
        check_kind(model, mujoco.MjModel, "WarpSand")
        spec = combined(spec, fields)
        check_count("WarpSand: corrections", corrections, least=0)
        if not (is_finite(softness) and softness >= 0):
            raise InputError(f"WarpSand: softness must be at least 0 m/s, not {shown(softness)}")
        if not isinstance(get_scheme(spec.scheme), (Auto, Implicit)):
            raise InputError(
                "in MuJoCo Warp forces always belong to the velocity at the step's end: leave "
                "scheme out"
            )
        fit.check_no_plugins(model)
        chosen = choose_sand(model, spec)
        self.law, self.medium, self.surface = chosen.law, chosen.medium, chosen.surface
        self._model, self._elements = model, chosen.elements
        self._original = Original(model, chosen.geoms, self.surface.geoms(model))
        memory, self._footprint = as_memory(spec.memory), None
        if memory is not None:
            fits = fitting(model, chosen.geoms, memory)
            self.surface, self._footprint = remembering(model, chosen, fits)
        self._memory: WarpMemory | None = None
        self._corrections, self._softness = corrections, float(softness)
        self._scene = make_scene(chosen.law, chosen.medium, self.surface, model)
        self._kernel = self.law.kernel_of_forces(self.surface)
        self._slots, self._chain = fit.slots_of(model, chosen.elements)
        self.bodies = tuple(model.body(int(body)).name or str(body) for body in self._slots["body"])
        self._attached_to: Any = None

    def attach(self, m: Any, d: Any) -> None:
        """Attach the sand to a model and data of MuJoCo Warp.

        From then on `mujoco_warp.step(m, d)` and its parts include the sand. Capture CUDA graphs
        after this call, and set callbacks `control` and `sensor` before: they are called first.

        Args:
            m: `mujoco_warp.Model` of this sand's model.
            d: `mujoco_warp.Data`, of any number of worlds.

        Raises:
            InputError: it is attached already, or the model is another, or would omit the sand.
        """
        if self._attached_to is not None:
            raise InputError(
                "this sand is attached already; make another WarpSand for another model or data"
            )
        if isinstance(getattr(m.callback.control, "__self__", None), WarpSand):
            raise InputError("attach: another WarpSand acts in this model; call put_model again")
        self._original.check_shapes(self._model)
        fit.check_model(self._model, self._chain, self._original.geoms, m)
        model, device = self._model, d.qvel.device
        self._cold = int(m.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_WARMSTART)
        n, count = d.nworld, len(self._slots)
        self._device, self._size = device, (n, count)

        law_struct = translate.struct_of_dtype(type(self.law).__name__, self._scene["law"].dtype)
        self._law_struct = law_struct
        self._laws = to_device(np.repeat(self._scene["law"], n), law_struct, device)
        record = self._scene["surface"]
        if isinstance(self.surface, Relief) and self._footprint is not None:
            self._memory = WarpMemory(self.surface, self._footprint, record, model, n, device)
            self._surface = self._memory.surface
        else:
            self._surface = translate.surface_on_device(self.surface, record, model, device)
        surface_struct = translate.struct_of_surface(self.surface, record)
        self._up = wp.vec3(*fit.up_of(self.surface, model))
        self._resist = damping.resist_kernel(
            self._kernel, law_struct, surface_struct, self._memory is not None
        )
        self._elements_there = to_device(self._elements, self._kernel.element, device)
        self._tables = self._tables_on(device)

        def zeros(count: int, kind: Any = float) -> wp.array:
            return wp.zeros((n, count), dtype=kind, device=device)

        self._state = state = damping.State()
        for name in ("predicted", "found", "gap", "creep"):
            setattr(state, name, zeros(model.nv))
        for name in ("share", "limit", "depth", "speed", "power"):
            setattr(state, name, zeros(count))
        state.force, state.moment = zeros(count, wp.vec3), zeros(count, wp.vec3)
        state.damping, state.start_force = zeros(count, Damping), zeros(count, wp.spatial_vector)
        state.passive, state.fluid = wp.zeros_like(d.qfrc_passive), wp.zeros_like(d.efm_fluid)
        self.depth, self.speed, self.power = state.depth, state.speed, state.power
        self.force, self.moment = state.force, state.moment
        self.strength, self.density = (wp.ones(n, dtype=float, device=device) for _ in range(2))
        self.height = wp.zeros(n, dtype=float, device=device)
        self._constraints = damping.Constraints(d)
        self._control_before, self._sensor_before = m.callback.control, m.callback.sensor
        m.callback.control, m.callback.sensor = self._on_control, self._on_sensor
        m.has_fluid = True  # else MuJoCo Warp ignores the damping
        self._attached_to, self._weightless = d, wp.zeros(1, dtype=wp.vec3, device=device)

    def set_media(self, media: Sequence[str | Medium]) -> None:
        """Give each world its own medium, or all of them one, with this sand's kind of law.

        Raises:
            InputError: the sand is not attached, or the number of media does not match the worlds.
            UnknownNameError: a medium does not exist, or has no constants for the law.
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
        each = np.concatenate(records * (self._size[0] // len(records)))
        given = to_device(each, self._law_struct, self._device)
        wp.copy(self._laws, given)  # in place, for captured graphs

    def relief(self, d: Any, world: int, middle: tuple[float, float] | None = None) -> Heights:
        """Return the stored heights of a world's sand over its surface, as `Sand.relief` does.

        `d` is the `mujoco_warp.Data`, `world` the index of the world.

        Raises:
            InputError: the sand has no memory, is not attached, or has no world of that index.
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
        """Return the sand that each world has moved since its start [m^3], shape (nworld,) each.

        Returns:
            `pressed` down, `heaped` up, `forgotten` where the grid is wrapped around, and `waiting`
                to be deposited beside a track.

        Raises:
            InputError: the sand has no memory, or is not attached.
        """
        self._check_attached("volumes")
        if self._memory is None:
            raise InputError("this sand has no memory: WarpSand(model, memory=True) has")
        return self._memory.volumes()

    def _tables_on(self, device: Any) -> Any:
        def integers(values: Any) -> wp.array:
            return wp.array(np.asarray(values, np.int32), dtype=wp.int32, device=device)

        model, tables = self._model, damping.Tables()
        tables.slots, tables.chain = to_device(self._slots, Slot, device), integers(self._chain)
        most = _MOST_DAMPING * model.body_subtreemass[self._slots["root"]]
        tables.most = wp.array(most, dtype=float, device=device)
        moved, first_moved = fit.slots_of_dofs(model.nv, self._slots, self._chain)
        tables.dof_slots, tables.dof_first = integers(moved), integers(first_moved)
        tables.rows = integers(np.repeat(np.arange(model.nv), model.M_rownnz))
        tables.columns = integers(model.M_colind)
        tables.row_first = integers([*model.M_rowadr, len(model.M_colind)])
        roots, first = np.unique(model.body_rootid[model.dof_bodyid], return_index=True)
        tables.roots, tables.root_first = integers(roots), integers([*first, model.nv])
        return tables

    def _check_attached(self, what: str) -> None:
        if self._attached_to is None:
            raise InputError(f"{what}: attach the sand first, by sand.attach(m, d)")

    def _gravity(self, m: Any) -> wp.array:
        return self._weightless if int(m.opt.disableflags) & NO_GRAVITY else m.opt.gravity

    def _on_control(self, m: Any, d: Any) -> None:
        """Compute the damping of this step when MuJoCo Warp calls the control callback."""
        if d is not self._attached_to:
            raise InputError("this sand is attached to another mujoco_warp.Data: make one for each")
        if self._control_before is not None:
            self._control_before(m, d)
        if self._memory is not None:
            self._memory.restart(d)
        tables, state, timestep = self._tables, self._state, m.opt.timestep
        wp.copy(state.passive, d.qfrc_passive)
        wp.copy(state.fluid, d.efm_fluid)
        self._constraints.find(m, d)
        starting = (timestep, self._cold, d.qvel, d.qacc_warmstart, d.time)
        self._launch(damping.warm_start, self._model.nv, state, *starting)
        count = self._corrections
        self._resist_all(m, d, first=True, last=count == 0)
        for correction in range(count):
            self._constraints.solve(m, d)
            solved = (correction > 0, timestep, d.M, d.qvel, d.qacc)
            self._launch(damping.predict_again, len(tables.roots), tables, state, *solved)
            self._resist_all(m, d, first=False, last=correction == count - 1)
        self._constraints.prepare(m, d)

    def _on_sensor(self, m: Any, d: Any, stage: Any) -> None:
        """Read the forces that acted, once accelerations are known."""
        if self._sensor_before is not None:
            self._sensor_before(m, d, stage)
        if int(stage) != int(mujoco.mjtStage.mjSTAGE_ACC):
            return
        tables, state, timestep = self._tables, self._state, m.opt.timestep
        self._launch(damping.predict, self._model.nv, timestep, d.qvel, d.qacc, state)
        places = (d.xipos, d.subtree_com, d.cdof)
        self._launch(damping.wrenches_of_step, self._size[1], tables, state, *places)
        creeping = (timestep, m.opt.sleep_tolerance, m.dof_length, d.M, d.qvel, d.qacc)
        self._launch(damping.stop_creep, len(tables.roots), tables, state, *creeping)
        if self._memory is not None:
            self._memory.update(self._gravity(m), d, self.height, self._up)

    def _resist_all(self, m: Any, d: Any, *, first: bool, last: bool) -> None:
        """Compute damping at the predicted velocities, its forces and its part of the metric."""
        tables, state, timestep = self._tables, self._state, m.opt.timestep
        self._launch(
            self._resist,
            self._size[1],
            *(tables, state, self._elements_there, self._laws, self._surface),
            *(first, last, d.time, self.strength, self.density, self.height),
            *(self._up, self._softness, timestep, self._gravity(m)),
            *(d.xpos, d.xmat, d.xipos, d.subtree_com, d.cvel, d.cdof, d.cdof_dot, d.qvel),
        )
        forces = (d.cdof, d.cvel, d.qfrc_passive)
        self._launch(damping.assemble_forces, self._model.nv, tables, state, *forces)
        metric = (timestep, d.cdof, d.efm_fluid)
        self._launch(damping.assemble_damping, len(tables.rows), tables, state, *metric)

    def _launch(self, kernel: Any, count: int, *inputs: Any) -> None:
        """Run a kernel for each world, and in each for `count` bodies, robots or numbers."""
        wp.launch(kernel, dim=(self._size[0], count), inputs=inputs, device=self._device)
