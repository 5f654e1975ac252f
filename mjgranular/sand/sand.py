"""`Sand`: a bed of sand bound to a model; the one handle a user holds."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mjgranular.errors import InputError, UnstableError
from mjgranular.given import check_data, check_model, surface_of
from mjgranular.kernel.compiled import entry, program_address
from mjgranular.law import Law, get_law, make_scene
from mjgranular.medium import Medium, get_medium
from mjgranular.sand.binding import Binding, bind
from mjgranular.sand.company import company_of, refuse_sand_of_its_own
from mjgranular.sand.guard import finish_step, guarded_step
from mjgranular.sand.report import Names, Report, Solver, describe
from mjgranular.scheme import Scheme, get_scheme
from mjgranular.scheme.scheme import STEP, SchemeChoice
from mjgranular.scheme.status import FINE, REFUSED
from mjgranular.shape import select_geoms
from mjgranular.shape.select import Choice, body_name
from mjgranular.surface import Surface
from mjgranular.surface.floors import warn_of_floors

_step1 = mujoco.mj_step1
_step2 = mujoco.mj_step2
_POSTURE = int(
    mujoco.mjtState.mjSTATE_QPOS
    | mujoco.mjtState.mjSTATE_QVEL
    | mujoco.mjtState.mjSTATE_MOCAP_POS
    | mujoco.mjtState.mjSTATE_MOCAP_QUAT
)
_WHOLE_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_NOBODY: tuple[Callable[[], mujoco.MjData | None], int] = (lambda: None, 0)


class Sand:
    """Sand under a MuJoCo model.

    Everything is checked and prepared here, once. One `Sand` serves any number of `MjData` of its
    model, also from several threads (one `MjData` a thread, as for MuJoCo itself).

    Two `Sand`s, of two beds with two media for example, act in one simulation by `apply`, each
    once between `mj_step1` and `mj_step2`: a `step` of each would be two steps of time. They may
    have different bodies as they are; if both are to act on the same, each takes `shared=True`.

        first = Sand(model, surface=Bed("dry"), medium="glass_beads", shared=True)
        second = Sand(model, surface=Bed("wet"), medium="play_sand", shared=True)
        mujoco.mj_step1(model, data)
        first.apply(data)
        second.apply(data)
        mujoco.mj_step2(model, data)

    Args:
        model: the model; kept, not copied.
        medium: a medium, its name, or a YAML file (`medium.file`).
        law: a law, its name, or None for the medium's own.
        surface: where the sand is; None for the plane z = 0.
        scheme: how forces become a step: a scheme or its name. "auto" takes `Implicit`, but
            `Explicit` for fine time steps (`scheme.auto`); `Sand.scheme` says which.
        bodies: names or numbers of the bodies that meet the sand, with all their collision geoms;
            or "all".
        geoms: names or numbers of the geoms that meet the sand; or "all".
        groups: geom groups whose collision geoms meet the sand, those of bodies that can move. What
            `bodies`, `geoms` and `groups` name is taken together; with none of them, as with "all",
            every collision geom of every body that can move.
        resolution: how finely geoms are cut into elements, in the law's own measure; None for its
            default.
        shared: lets another `Sand`, shared too, or sand that is a part of the model act on the same
            bodies of the same `MjData`.

    Raises:
        UnknownNameError: a name or group that does not exist; lists those that do.
        InputError: geoms that the law has no elements for, a model that the scheme cannot step, or
            one that has sand of its own on the same bodies (`engine`).
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        *,
        medium: str | Path | Medium = "play_sand",
        law: str | Law | None = None,
        surface: Surface | None = None,
        scheme: str | SchemeChoice = "auto",
        bodies: Choice = None,
        geoms: Choice = None,
        groups: Sequence[int] | int | None = None,
        resolution: int | None = None,
        shared: bool = False,
    ) -> None:
        check_model(model, "Sand")
        self._arguments: dict[str, Any] = {
            "medium": medium,
            "law": law,
            "surface": surface,
            "scheme": scheme,
            "bodies": bodies,
            "geoms": geoms,
            "groups": groups,
            "resolution": resolution,
            "shared": shared,
        }
        self._model = model
        self._medium = get_medium(medium)
        self._law = get_law(law, self._medium)
        self._surface = surface_of(surface)
        asked = get_scheme(scheme)
        asked.check(model)
        chosen = select_geoms(
            model,
            bodies=bodies,
            geoms=geoms,
            groups=groups,
            leave_out=self._surface.geoms(model),
        )
        warn_of_floors(model, chosen, self._surface)
        self._elements = self._law.elements(model, chosen, resolution)
        if not shared:
            refuse_sand_of_its_own(model, self._elements)
        self._scheme = asked.settle(model, len(self._elements))
        self._scheme.check(model)
        self._scene = make_scene(self._law, self._medium, self._surface, model)
        self._kernel = self._law.kernel(self._surface)
        self._laid = self._kernel.pack(self._elements)
        program = self._scheme.program(self._kernel, self._scene.dtype)
        self._program = program_address(program, STEP)
        self._guarded = entry(guarded_step, "int64(int64, int64, float64)")
        self._finish = entry(finish_step, "int64(int64)")
        self._lead = self._scheme.lead
        self._shared = shared
        self._options = model.opt  # its `timestep` may change between steps
        self._bindings: weakref.WeakKeyDictionary[mujoco.MjData, Binding] = (
            weakref.WeakKeyDictionary()
        )
        self._slope = self._surface.tilt(model)
        self._names = Names.of(model, self._elements)
        self._members = [
            np.flatnonzero(self._elements["slot"] == slot)
            for slot in range(len(np.unique(self._elements["slot"])))
        ]
        self._probes: list[tuple[mujoco.MjData, Binding]] = []
        # The last data and the address of its table: what a loop over one simulation needs.
        self._recent = _NOBODY

    @property
    def model(self) -> mujoco.MjModel:
        """The model."""
        return self._model

    @property
    def medium(self) -> Medium:
        """What the sand is."""
        return self._medium

    @property
    def law(self) -> Law:
        """How it resists."""
        return self._law

    @property
    def surface(self) -> Surface:
        """Where it is."""
        return self._surface

    @property
    def scheme(self) -> Scheme:
        """How forces become a step."""
        return self._scheme

    @property
    def elements(self) -> np.ndarray:
        """The elements that the law acts on: a structured array, read-only."""
        view = self._elements.view()
        view.flags.writeable = False
        return view

    def step(self, data: mujoco.MjData) -> None:
        """Advances the simulation by one time step with the sand acting: use it for `mj_step`.

        `mj_step1` makes positions and velocities current, the wrench of every body is added to
        `data.xfrc_applied`, `mj_step2` finishes the step, and `data.xfrc_applied` is left as it was
        found: what a user writes there acts beside the sand and stays.

        Raises:
            UnstableError: a force is not finite, and then the step is not finished; or MuJoCo has
                found the state bad, and then `data` holds the last good state, its time, controls
                and `xfrc_applied` included.
            InputError: the time step is not a positive number, or the model's integrator was
                changed to one that cannot be stepped (RK4): the step is not made. At the first step
                with this `data`: it belongs to another model, or another `Sand` acts on one of the
                bodies.
        """
        recent, address = self._recent
        if recent() is not data:
            address = self._bind(data)
        model = self._model
        _step1(model, data)
        failed = self._guarded(self._program, address, self._lead * self._options.timestep)
        if failed != FINE:
            raise self._failure(data, failed)
        _step2(model, data)
        failed = self._finish(address)
        if failed != FINE:
            raise self._failure(data, failed)

    def apply(self, data: mujoco.MjData) -> None:
        """Adds the sand's wrenches to `data.xfrc_applied`, for a stepping loop of your own.

        Call it between `mj_step1` and `mj_step2`, when positions and velocities are current. The
        wrench stays in `xfrc_applied` until the next call, which takes it back; a row that was
        written in between is taken to be wholly yours.

        Raises:
            UnstableError: a force is not finite, and then nothing is written; or MuJoCo has found
                the state bad, and then `data` holds the last good state but for `xfrc_applied`.
            InputError: as `step`.
        """
        recent, address = self._recent
        if recent() is not data:
            address = self._bind(data)
        failed = self._guarded(self._program, address, self._lead * self._options.timestep)
        if failed != FINE:
            raise self._failure(data, failed, own=False)

    def release(self, data: mujoco.MjData) -> None:
        """Lets a simulation go, so that another `Sand` may act on the same bodies of it.

        What `apply` has left in `data.xfrc_applied` is taken back. A later `step` or `apply` begins
        anew; without an earlier one there is nothing to let go.
        """
        binding = self._bindings.pop(data, None)
        if binding is not None:
            self._recent = _NOBODY
            company_of(data).leave(self, binding)

    def report(self, data: mujoco.MjData) -> Report:
        """What the sand does at the state in `data` (`qpos`, `qvel`), which is left untouched."""
        model = self._model
        self._check_owner(data)
        # Probes are kept for the next call; a list hands each to one thread at a time.
        try:
            probe, binding = self._probes.pop()
        except IndexError:
            probe = mujoco.MjData(model)
            binding = self._new_binding(probe)
        lead = 0.0
        if self._scheme.whole_state:
            lead = self._lead * self._options.timestep
            mujoco.mj_copyState(model, data, probe, _WHOLE_STATE)
            probe.xfrc_applied[:] = self._own_applied(data)
        else:
            mujoco.mj_copyState(model, data, probe, _POSTURE)
        mujoco.mj_fwdPosition(model, probe)
        mujoco.mj_fwdVelocity(model, probe)
        binding.bodies["written"] = np.nan  # what is there now is the user's
        failed = self._guarded(self._program, binding.address, lead)
        if failed != FINE:
            raise self._failure(data, failed, binding)
        probe.time = data.time
        report = describe(
            probe,
            elements=self._elements,
            members=self._members,
            names=self._names,
            binding=binding,
            gravity=float(np.linalg.norm(model.opt.gravity)),
            limits=self._law.validity,
            slope=self._slope,
            grain=None if self._medium.grain is None else self._medium.grain.value,
            solver=self._solver(data),
        )
        self._probes.append((probe, binding))
        return report

    def _solver(self, data: mujoco.MjData) -> Solver | None:
        """What the scheme has counted in this simulation."""
        bound = self._bindings.get(data)
        if bound is None or bound.desk.account is None:
            return None
        return Solver.of(bound.desk.account[0])

    def _own_applied(self, data: mujoco.MjData) -> np.ndarray:
        """`xfrc_applied` without what `apply` has left in it."""
        applied = data.xfrc_applied.copy()
        binding = self._bindings.get(data)
        if binding is not None:
            for row in binding.bodies:
                if (applied[row["body"]] == row["written"]).all():
                    applied[row["body"]] = row["own"]
        return applied

    def table_of(self, data: mujoco.MjData) -> int:
        """The address of a simulation's table (`kernel.memory`), which lives as long as `data`."""
        return self._bind(data)

    def _check_owner(self, data: mujoco.MjData) -> None:
        check_data(data, "Sand")
        if data.model is not self._model and data.model._address != self._model._address:
            raise InputError(
                "this MjData belongs to another model: make it with MjData(model) from the "
                "model that Sand was made for"
            )

    def _bind(self, data: mujoco.MjData) -> int:
        check_data(data, "Sand")
        binding = self._bindings.get(data)
        if binding is None:
            self._check_owner(data)
            self._scheme.check(self._model)
            binding = self._new_binding(data)
            company_of(data).join(self, self._model, binding, shared=self._shared)
            self._bindings[data] = binding
        if self._shared:  # comes here at every call: the others' shares are to be seen to
            company_of(data).begin(binding)
        else:
            self._recent = (weakref.ref(data), binding.address)
        return binding.address

    def _new_binding(self, data: mujoco.MjData) -> Binding:
        return bind(
            self._model,
            data,
            self._elements,
            self._laid,
            self._scene,
            self._scheme,
            self._kernel,
        )

    def _failure(
        self,
        data: mujoco.MjData,
        failed: int,
        binding: Binding | None = None,
        *,
        own: bool = True,
    ) -> UnstableError | InputError:
        """What to raise when a program has failed; brings the last good state back, if it is bad.

        Args:
            data: the simulation.
            failed: what the program has returned.
            binding: what it was called with; None for that of `data`.
            own: whether `xfrc_applied` was wholly the user's when the state was kept.
        """
        model = self._model
        if failed in REFUSED:
            return InputError(self._scheme.refusal(failed))
        if binding is None:
            binding = self._bindings[data]
        advice = f"a time step below {self._options.timestep:g} s may do better"
        if failed >= 0:
            return UnstableError(
                f"the sand's force on body {body_name(model, binding.bodies[failed]['body'])} is "
                f"not finite at {self._moment(data.time)}: the state has left reason; {advice}"
            )
        what, body = self._blame(data)
        found = f"MuJoCo found NaN, infinite or huge numbers in {what} of body "
        found += body_name(model, body)
        time = binding.kept.time
        if time is None:
            reset = not self._options.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET
            return UnstableError(
                f"{found} before the sand's first step"
                f"{' and has reset the simulation' if reset else ''}: start from finite numbers"
            )
        applied = data.xfrc_applied.copy()
        binding.kept.restore(model, data)
        if not own:
            data.xfrc_applied[:] = applied
        return UnstableError(
            f"{found} at {self._moment(time)}: the state has left reason, and the data hold the "
            f"last good one, from before that step; {advice}"
        )

    def _moment(self, time: float) -> str:
        """When, in words; the first step is step 1."""
        step = time / self._options.timestep if self._options.timestep else math.nan
        return f"t = {time:.6g} s" + (f", step {round(step) + 1}" if math.isfinite(step) else "")

    def _blame(self, data: mujoco.MjData) -> tuple[str, int]:
        """What MuJoCo has found bad, and in which body; its warnings count as told then."""
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

    def __copy__(self) -> Sand:
        """Sand of its own on the same model: addresses are not copied."""
        return Sand(self._model, **self._arguments)

    def __deepcopy__(self, memo: dict[int, Any]) -> Sand:
        """As `copy`: the model is shared, as it is by the deep copy of a `MjData`."""
        return self.__copy__()

    def __reduce__(self) -> tuple[Any, ...]:
        return _remake, (self._model, self._arguments)


def _remake(model: mujoco.MjModel, arguments: dict[str, Any]) -> Sand:
    return Sand(model, **arguments)
