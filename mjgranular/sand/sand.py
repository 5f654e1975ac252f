"""`Sand`: a bed of sand bound to a model, the main class of the package."""

import copy
import weakref
from collections.abc import Callable
from functools import partial
from typing import Any, Self, Unpack

import mujoco
import numpy as np

from mjgranular._util.checks import check_kind, check_switch
from mjgranular.errors import InputError, UnstableError
from mjgranular.kernel.compiled import entry
from mjgranular.kernel.memory import BESIDE, UPDATE
from mjgranular.law import Law
from mjgranular.medium import Medium
from mjgranular.relief.grid import TIME
from mjgranular.relief.memory import Heights, Memory, checked_state, heights_of
from mjgranular.relief.relief import Relief, place_in_plane
from mjgranular.sand import advice
from mjgranular.sand.binding import (
    Binding,
    bind,
    find_sand_of_the_model,
    finish_step,
    guarded_step,
    registry_of,
)
from mjgranular.sand.prepare import Original, geoms_in_sand, prepare
from mjgranular.sand.report import Names, Report, Solver, describe
from mjgranular.sand.spec import SandFields, SandSpec, combined
from mjgranular.scheme import Scheme
from mjgranular.scheme.scheme import FINE, REFUSED
from mjgranular.shape.select import body_name
from mjgranular.surface import Surface
from mjgranular.surface.place import strength_of_gravity

_step1 = mujoco.mj_step1
_step2 = mujoco.mj_step2
_POSTURE = int(
    mujoco.mjtState.mjSTATE_QPOS
    | mujoco.mjtState.mjSTATE_QVEL
    | mujoco.mjtState.mjSTATE_MOCAP_POS
    | mujoco.mjtState.mjSTATE_MOCAP_QUAT
)
_WHOLE_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_NOBODY: tuple[Callable[[], object], int] = (object, 0)  # equal to no data, nor to None


class Sand:
    """Sand under a MuJoCo model.

    Everything is checked and prepared here, once. One `Sand` serves any number of `MjData` of its
    model, also from several threads (one `MjData` a thread, as for MuJoCo itself).

    With `memory` the sand keeps the prints of what has stood in it, separately for each `MjData`,
    until time goes back (`mj_resetData`), or the `MjData` is released (`release`). A copy of an
    `MjData` starts with untouched sand unless `restore_memory` is called; so does a pickled `Sand`.
    After an `UnstableError` the sand is as the failed step has left it.

    Two `Sand`s, of two beds with two media for example, act in one simulation by `apply`, each once
    between `mj_step1` and `mj_step2`: a `step` of each would be two steps of time. By default they
    must act on different bodies; to act on the same, both need `shared=True`. Under the implicit
    scheme they are solved together; apply explicit ones first.

        first = Sand(model, surface=Bed("dry"), medium="glass_beads", shared=True)
        second = Sand(model, surface=Bed("wet"), medium="play_sand", shared=True)
        mujoco.mj_step1(model, data)
        first.apply(data)
        second.apply(data)
        mujoco.mj_step2(model, data)

    Args:
        model: the model; kept, not copied.
        spec: the sand; None for one of defaults.
        shared: whether another `Sand`, shared too, or sand that is a part of the model may act on
            the same bodies of the same `MjData`.
        **fields: fields of `SandSpec`, which documents them; they replace those of `spec`.

    Raises:
        UnknownNameError: a name or group that does not exist; lists those that do.
        InputError: geoms that the law has no elements for, a model that the scheme cannot step, or
            a model that already has sand on the same bodies (`engine`).
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        spec: SandSpec | None = None,
        *,
        shared: bool = False,
        **fields: Unpack[SandFields],
    ) -> None:
        check_kind(model, mujoco.MjModel, "Sand")
        check_switch("shared", shared)
        self._model = model
        self._spec = combined(spec, fields)
        self._sand = sand = prepare(model, self._spec)
        self._beside = find_sand_of_the_model(model, sand.elements)
        if self._beside and not shared:
            raise InputError(
                f"the model has sand, {self._beside} inside mj_step: step it with "
                "mj_step and without Sand, or say shared=True if both are to act"
            )
        self._program = sand.program
        self._guarded = entry(guarded_step, "int64(int64, int64, float64)")
        self._finish = entry(finish_step, "int64(int64)")
        self._lead = sand.scheme.lead
        self._shared = shared
        self._options = model.opt  # its `timestep` may change between steps
        self._bindings = weakref.WeakKeyDictionary[mujoco.MjData, Binding]()
        self._slope, self._pull = sand.surface.tilt(model), model.opt.gravity.copy()
        self._names = Names.of(model, sand.elements)
        self._probes: list[tuple[mujoco.MjData, Binding]] = []
        # The last data and the address of its table: all that a loop over one simulation needs.
        self._recent = _NOBODY
        self._original = Original(model, sand.geoms, sand.surface.geoms(model))
        self._last_timestep = 0.0  # of the last step of any simulation [s]

    def __repr__(self) -> str:
        bodies = [repr(name) for name in self._names.bodies.values()]
        several = f"{', '.join(bodies[:3])}{', ...' if len(bodies) > 3 else ''}"
        return (
            f"Sand(medium={self.medium.name!r}, law={self.law.name!r}, surface={self.surface!r}, "
            f"scheme={self.scheme.name!r}, {len(self.elements)} elements on {len(bodies)} "
            f"{'body' if len(bodies) == 1 else 'bodies'}: {several})"
        )

    @property
    def model(self) -> mujoco.MjModel:
        """The model."""
        return self._model

    @property
    def spec(self) -> SandSpec:
        """The sand as specified."""
        return self._spec

    @property
    def medium(self) -> Medium:
        """The medium."""
        return self._sand.medium

    @property
    def law(self) -> Law:
        """The law of resistance."""
        return self._sand.law

    @property
    def surface(self) -> Surface:
        """The undisturbed surface."""
        surface = self._sand.surface
        return surface.base if isinstance(surface, Relief) else surface

    @property
    def memory(self) -> Memory | None:
        """The memory of the sand; None without one."""
        surface = self._sand.surface
        return surface.memory if isinstance(surface, Relief) else None

    @property
    def scheme(self) -> Scheme:
        """The time stepping scheme."""
        return self._sand.scheme

    @property
    def elements(self) -> np.ndarray:
        """The elements that the law acts on: a structured array, read-only."""
        view = self._sand.elements.view()
        view.flags.writeable = False
        return view

    def step(self, data: mujoco.MjData) -> None:
        """Advance the simulation by one time step with the sand: use it in place of `mj_step`.

        `mj_step1` makes positions and velocities current, the wrench of every body is added to
        `data.xfrc_applied`, `mj_step2` finishes the step, and `data.xfrc_applied` is restored: what
        you write there acts in addition to the sand and stays.

        Raises:
            UnstableError: a force is not finite, and then the step is not finished; or MuJoCo has
                found the state bad, and then `data` holds the last good state, its time, controls
                and `xfrc_applied` included.
            InputError: the time step is not a positive number, or the model's integrator was
                changed to one that cannot be stepped (RK4): the step is not made. At the first step
                with this `data`: it is of another model, or another `Sand` acts on the same bodies.
        """
        recent, address = self._recent
        if recent() is not data:
            address = self._begin(data)
        model = self._model
        self._last_timestep = timestep = self._options.timestep
        _step1(model, data)
        failed = self._guarded(self._program, address, self._lead * timestep)
        if failed != FINE:
            raise self._failure(data, failed)
        _step2(model, data)
        failed = self._finish(address)
        if failed != FINE:
            raise self._failure(data, failed)

    def apply(self, data: mujoco.MjData) -> None:
        """Add the sand's wrenches to `data.xfrc_applied`, for a custom stepping loop.

        Call it between `mj_step1` and `mj_step2`, when positions and velocities are current. The
        wrench stays in `xfrc_applied` until the next call, of any `Sand` in another step, which
        takes it back; a row that was written in between is taken to hold only your own wrench.

        Raises:
            UnstableError: a force is not finite, and then nothing is written; or MuJoCo has found
                the state bad, and then `data` holds the last good state but for `xfrc_applied`.
            InputError: as `step`.
        """
        recent, address = self._recent
        if recent() is not data:
            address = self._begin(data)
        self._last_timestep = timestep = self._options.timestep
        failed = self._guarded(self._program, address, self._lead * timestep)
        if failed != FINE:
            raise self._failure(data, failed, own=False)

    def release(self, data: mujoco.MjData) -> None:
        """Release a simulation, so that another `Sand` may act on the same bodies of it.

        The wrenches that `apply` has left in `data.xfrc_applied` are removed. A later `step` or
        `apply` starts over; without an earlier one this does nothing.

        Raises:
            InputError: `data` is not an `MjData`.
        """
        check_kind(data, mujoco.MjData, "Sand")
        binding = self._bindings.pop(data, None)
        if binding is not None:
            self._recent = _NOBODY
            registry_of(data).remove(self, binding)

    def relief(self, data: mujoco.MjData, middle: tuple[float, float] | None = None) -> Heights:
        """Return the memory of a simulation's sand: heights over its surface.

        Args:
            data: the simulation.
            middle: center of the returned square, along the axes of the surface's plane [m]; None
                for the center of the bodies that meet the sand.

        Raises:
            InputError: the sand has no memory.
        """
        surface = self._remembering()
        if middle is None:
            places = data.xpos[np.unique(self._sand.elements["body"])]
            middle = place_in_plane(surface.base, self._model, places.mean(axis=0))
        return heights_of(self._state_of(data), surface.memory, middle)

    def save_memory(self, data: mujoco.MjData) -> np.ndarray:
        """Return the memory of a simulation's sand as an array, for `restore_memory`.

        MuJoCo does not copy it: after `mj_copyData`, `mj_setState` or `copy.copy` call
        `sand.restore_memory(to, sand.save_memory(origin))` too. (Sand in `mj_step` needs none.)

        Raises:
            InputError: the sand has no memory.
        """
        self._remembering()
        return self._state_of(data)

    def restore_memory(self, data: mujoco.MjData, saved: np.ndarray) -> None:
        """Restore the memory of a simulation's sand, also one saved by another process.

        Args:
            data: the simulation, with the state that it had then.
            saved: array from `save_memory`, of a sand with the same memory.

        Raises:
            InputError: the sand has no memory, or the array does not fit it: nothing is changed.
        """
        self._remembering()
        state = self._bind(data).state
        state[:] = checked_state(saved, len(state))
        state[TIME] = data.time

    def _remembering(self) -> Relief:
        surface = self._sand.surface
        if not isinstance(surface, Relief):
            raise InputError("this sand has no memory: make it with Sand(..., memory=True)")
        return surface

    def _state_of(self, data: mujoco.MjData) -> np.ndarray:
        """Return the memory in a simulation, a copy; zeros before a first step or after a reset."""
        self._check_owner(data)
        binding = self._bindings.get(data)
        if binding is None or (binding.state[TIME : TIME + 1] > data.time).any():
            return np.zeros(self._sand.surface.state_size)
        return binding.state.copy()

    def report(self, data: mujoco.MjData) -> Report:
        """Report the sand's action in a step from the state in `data`, which is not changed.

        Write its controls and mocap poses first. Warns with a `MissedStepWarning` as `check` does.

        Raises:
            InputError: the shape of a geom was changed after the sand was made of it; `check` looks
                at more. The model already has sand on the same bodies, and this one has never acted
                in `data`: the report would be of forces in addition to those.
        """
        model = self._model
        self._check_owner(data)
        if self._beside and data not in self._bindings:
            raise InputError(
                f"the model has sand, {self._beside} inside mj_step, and this Sand, "
                "which has never acted in this MjData, has nothing to report: read the model's "
                "sensors (mjgranular.sensor), or report with the model without its sand"
            )
        self._original.check_shapes(model)
        self._warn_of_missed_steps(data)
        # Probes are kept for the next call; a list hands each to one thread at a time.
        try:
            probe, binding = self._probes.pop()
        except IndexError:
            probe = mujoco.MjData(model)
            binding = bind(model, probe, self._sand)
            binding.table[UPDATE] = 0  # a report leaves the memory unchanged
        lead = 0.0
        if self._sand.scheme.whole_state:
            lead = self._lead * self._options.timestep
            mujoco.mj_copyState(model, data, probe, _WHOLE_STATE)
            probe.xfrc_applied[:] = self._own_applied(data)
        else:
            mujoco.mj_copyState(model, data, probe, _POSTURE)
        mujoco.mj_fwdPosition(model, probe)
        mujoco.mj_fwdVelocity(model, probe)
        binding.bodies["last_wrench"] = np.nan  # what is there now is the user's
        bound = self._bindings.get(data)
        binding.state[:] = self._state_of(data)
        counts = None if bound is None else bound.workspace.statistics
        beside = self._act_beside(data, probe, lead)
        binding.table[BESIDE] = beside[-1].address if beside else 0
        failed = self._guarded(self._program, binding.address, lead)
        if failed != FINE:
            raise self._failure(data, failed, binding)
        probe.time = data.time
        pull = model.opt.gravity
        if not np.array_equal(pull, self._pull):
            self._slope, self._pull = self._sand.surface.tilt(model), pull.copy()
        report = describe(
            probe,
            sand=self._sand,
            names=self._names,
            binding=binding,
            gravity=strength_of_gravity(model),
            slope=self._slope,
            solver=None if counts is None else Solver(*counts[0].item()),
        )
        self._probes.append((probe, binding))
        return report

    def check(self, data: mujoco.MjData | None = None) -> None:
        """Check that the model is still the one that this sand was made from.

        Masses and options may change between any two steps. Inputs of elements and selection may
        not: sizes, places and types of geoms, meshes, the tree of bodies and joints.

        Warns with a `MissedStepWarning` if time has gone on in `data` without this sand, also if it
        has never acted there: most likely `mujoco.mj_step` was called in place of `step`. With a
        `FloorWarning` if the model's own ground supports bodies in its contacts. With a
        `RangeWarning` if a robot is completely buried, deeper than its largest geom is wide.

        Raises:
            InputError: something was changed, or the scheme cannot step with the options.
        """
        geoms = geoms_in_sand(self._model, self._spec)
        self._original.check(self._model, geoms)
        self._sand.scheme.check(self._model)
        if data is not None:
            self._check_owner(data)
            self._warn_of_missed_steps(data, began=0.0)
            case = advice.Case(self._model, self._spec, geoms, self.law, self.surface, None)
            advice.warn(advice.CHECKS_OF_CONTACTS, case, data)
            advice.warn(advice.CHECKS_OF_DEPTH, case, data, "in this MjData")

    def _warn_of_missed_steps(self, data: mujoco.MjData, began: float | None = None) -> None:
        bound = self._bindings.get(data)
        last = None if bound is None else bound.snapshot.time
        timestep = max(self._last_timestep, self._options.timestep)
        advice.warn(advice.CHECKS_OF_TIME, data.time, last, timestep, began)

    def _own_applied(self, data: mujoco.MjData) -> np.ndarray:
        """Return `xfrc_applied` without what `apply` has left in it."""
        applied = data.xfrc_applied.copy()
        binding = self._bindings.get(data)
        for share in () if binding is None else registry_of(data).before(binding):
            for row in share.bodies:
                if (applied[row["body"]] == row["last_wrench"]).all():
                    applied[row["body"]] = row["user_wrench"]
        return applied

    def _act_beside(self, data: mujoco.MjData, probe: mujoco.MjData, lead: float) -> list[Binding]:
        """Have those that are solved with this sand act in a copy; return their bindings there."""
        bound, acted = self._bindings.get(data), []
        if bound is None or not bound.joins:
            return acted
        shares = registry_of(data).before(bound)
        for other in registry_of(data).others(self):
            theirs = other._bindings.get(data)
            if theirs is not None and theirs.joins and any(share is theirs for share in shares):
                binding = bind(self._model, probe, other._sand)
                binding.table[UPDATE] = 0
                binding.state[:] = other._state_of(data)
                binding.table[BESIDE] = acted[-1].address if acted else 0
                other._guarded(other._program, binding.address, lead)
                acted.append(binding)
        return acted

    def table_of(self, data: mujoco.MjData) -> int:
        """Return the address of a simulation's table (`kernel.memory`), valid as long as `data`."""
        return self._bind(data).address

    def _check_owner(self, data: mujoco.MjData) -> None:
        check_kind(data, mujoco.MjData, "Sand")
        if data.model is not self._model and data.model._address != self._model._address:
            raise InputError(
                "this MjData belongs to another model, as a deep copy or a pickle of one always "
                "does: make it with MjData(model) from the model that Sand was made for, and fill "
                "it with mj_copyData; copy.copy(data) does both"
            )

    def forget_last(self) -> None:
        """Forget which simulation came last: another sand acts there from now on."""
        self._recent = _NOBODY

    def _begin(self, data: mujoco.MjData) -> int:
        """Prepare for a step; return the address of the table."""
        binding, registry = self._bind(data), registry_of(data)
        registry.begin(binding, data.time)
        if not registry.is_crowded:  # else at every call, to update the shares of the others
            self._recent = (weakref.ref(data), binding.address)
        return binding.address

    def _bind(self, data: mujoco.MjData) -> Binding:
        check_kind(data, mujoco.MjData, "Sand")
        binding = self._bindings.get(data)
        if binding is None:
            self._check_owner(data)
            self._sand.scheme.check(self._model)
            binding = bind(self._model, data, self._sand)
            registry_of(data).add(self, self._model, binding, shared=self._shared)
            self._bindings[data] = binding
        return binding

    def _failure(
        self, data: mujoco.MjData, failed: int, binding: Binding | None = None, *, own: bool = True
    ) -> UnstableError | InputError:
        """Make the error for a program that failed; if the state is bad, restore the last good one.

        `binding` is the one that it was called with; None for that of `data`. `own` says whether
        `xfrc_applied` held only the user's wrenches when the state was kept.
        """
        model = self._model
        if failed in REFUSED:
            return InputError(self._sand.scheme.refusal(failed))
        if binding is None:
            binding = self._bindings[data]
        advice = f"a time step below {self._options.timestep:g} s may do better"
        if failed >= 0:
            if not np.isfinite(model.hfield_data).all():
                advice = "heights in hfield_data must be finite"
            return UnstableError(
                f"the sand's force on body {body_name(model, binding.bodies[failed]['body'])} is "
                f"not finite at t = {data.time:.6g} s: the state has diverged; {advice}"
            )
        what, body = self._blame(data)
        found = f"MuJoCo found NaN, infinite or huge numbers in {what} of body "
        found += body_name(model, body)
        time = binding.snapshot.time
        if time is None:
            reset = not self._options.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET
            return UnstableError(
                f"{found} before the sand's first step"
                f"{' and has reset the simulation' if reset else ''}: start from finite numbers"
            )
        applied = data.xfrc_applied.copy()
        binding.snapshot.restore(model, data)
        binding.state[TIME : TIME + 1] = time  # no reset
        if not own:
            data.xfrc_applied[:] = applied
        return UnstableError(
            f"{found} at t = {time:.6g} s: the state has diverged, and the data hold the "
            f"last good one, from before that step; {advice}"
        )

    def _blame(self, data: mujoco.MjData) -> tuple[str, int]:
        """Find what MuJoCo found bad, and in which body; clear its warnings."""
        model = self._model
        warnings = {
            what: data.warning[int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{what.upper()}"))]
            for what in ("qpos", "qvel", "qacc")
        }
        what = next(what for what, warning in warnings.items() if warning.number)
        index = int(warnings[what].lastinfo)
        for warning in warnings.values():
            warning.number = 0
        if what == "qpos":
            joint = np.searchsorted(model.jnt_qposadr, index, side="right") - 1
            return what, int(model.jnt_bodyid[joint])
        return what, int(model.dof_bodyid[index])

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return a new sand for a deep copy of the model, shared by all that is copied with it."""
        make, (model, spec) = self.__reduce__()
        return make(copy.deepcopy(model, memo), spec)

    def __reduce__(self) -> tuple[Any, ...]:
        # A new sand: addresses are not copied.
        return partial(Sand, shared=self._shared), (self._model, self._spec)
