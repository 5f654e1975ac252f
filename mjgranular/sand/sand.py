"""`Sand`: a bed of sand bound to a model; the one handle a user holds."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numba import types

from mjgranular.errors import InputError, UnstableError
from mjgranular.kernel import entry
from mjgranular.law import Law, get_law, make_scene
from mjgranular.medium import Medium, get_medium
from mjgranular.sand.binding import Binding, bind
from mjgranular.sand.report import Names, Report, describe
from mjgranular.scheme import Scheme, get_scheme
from mjgranular.scheme.explicit import take_back_wrenches
from mjgranular.shape import select_geoms
from mjgranular.surface import Plane, Surface

_FINE = -1  # what a program returns when all is well
_step1 = mujoco.mj_step1
_step2 = mujoco.mj_step2


class Sand:
    """Sand under a MuJoCo model.

    Everything is checked and prepared here, once. One `Sand` serves any number of `MjData` of its
    model, also from several threads (one `MjData` a thread, as for MuJoCo itself).

    Args:
        model: the model; kept, not copied.
        medium: a medium, its name, or a YAML file (`medium.file`).
        law: a law, its name, or None for the medium's own.
        surface: where the sand is; None for the plane z = 0.
        scheme: how forces become a step: a scheme or its name.
        bodies: names of the bodies that meet the sand.
        geoms: names of the geoms that meet the sand. With neither, every collision geom of every
            body that can move.
        resolution: how finely geoms are cut into elements, in the law's own measure; None for its
            default.

    Raises:
        UnknownNameError: a name that does not exist; lists those that do.
        InputError: geoms that the law has no elements for, or a model that the scheme cannot step.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        *,
        medium: str | Path | Medium = "play_sand",
        law: str | Law | None = None,
        surface: Surface | None = None,
        scheme: str | Scheme = "explicit",
        bodies: Sequence[str] | str | None = None,
        geoms: Sequence[str] | str | None = None,
        resolution: int | None = None,
    ) -> None:
        self._arguments: dict[str, Any] = {
            "medium": medium,
            "law": law,
            "surface": surface,
            "scheme": scheme,
            "bodies": bodies,
            "geoms": geoms,
            "resolution": resolution,
        }
        self._model = model
        self._medium = get_medium(medium)
        self._law = get_law(law, self._medium)
        self._surface = Plane() if surface is None else surface
        self._scheme = get_scheme(scheme)
        self._scheme.check(model)
        chosen = select_geoms(
            model, bodies=bodies, geoms=geoms, leave_out=self._surface.geoms(model)
        )
        self._elements = self._law.elements(model, chosen, resolution)
        self._scene = make_scene(self._law, self._medium, self._surface, model)
        self._kernel = self._law.kernel(self._surface, self._scene.dtype)
        self._program = entry(self._scheme.program(self._kernel), types.int64, types.float64)
        self._take_back = entry(take_back_wrenches, types.int64)
        self._lead = self._scheme.lead
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
        self._recent: tuple[Callable[[], mujoco.MjData | None], int] = (lambda: None, 0)

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
            UnstableError: a force is not finite, and then the step is not finished and
                `xfrc_applied` is as it was; or MuJoCo has found the state bad and reset it.
        """
        recent, address = self._recent
        if recent() is not data:
            address = self._bind(data)
        model = self._model
        _step1(model, data)
        failed = self._program(address, self._lead * self._options.timestep)
        if failed != _FINE:
            raise self._unstable(data, failed)
        _step2(model, data)
        self._take_back(address)

    def apply(self, data: mujoco.MjData) -> None:
        """Adds the sand's wrenches to `data.xfrc_applied`, for a stepping loop of your own.

        Call it between `mj_step1` and `mj_step2`, when positions and velocities are current. The
        wrench stays in `xfrc_applied` until the next call, which takes it back; a row that was
        written in between is taken to be wholly yours.

        Raises:
            UnstableError: a force is not finite, or MuJoCo has found the state bad; nothing is
                written.
        """
        recent, address = self._recent
        if recent() is not data:
            address = self._bind(data)
        failed = self._program(address, self._lead * self._options.timestep)
        if failed != _FINE:
            raise self._unstable(data, failed)

    def report(self, data: mujoco.MjData) -> Report:
        """What the sand does at the state in `data` (`qpos`, `qvel`), which is left untouched."""
        model = self._model
        self._check_owner(data)
        # Probes are kept for the next call; a list hands each to one thread at a time.
        try:
            probe, binding = self._probes.pop()
        except IndexError:
            probe = mujoco.MjData(model)
            binding = bind(model, probe, self._elements, self._scene)
        probe.qpos[:] = data.qpos
        probe.qvel[:] = data.qvel
        probe.mocap_pos[:] = data.mocap_pos
        probe.mocap_quat[:] = data.mocap_quat
        mujoco.mj_kinematics(model, probe)
        mujoco.mj_comPos(model, probe)
        mujoco.mj_comVel(model, probe)
        self._kernel(binding.table, 0.0)
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
        )
        self._probes.append((probe, binding))
        return report

    def _check_owner(self, data: mujoco.MjData) -> None:
        if data.model is not self._model and data.model._address != self._model._address:
            raise InputError(
                "this MjData belongs to another model: make it with MjData(model) from the "
                "model that Sand was made for"
            )

    def _bind(self, data: mujoco.MjData) -> int:
        binding = self._bindings.get(data)
        if binding is None:
            self._check_owner(data)
            self._scheme.check(self._model)
            binding = bind(self._model, data, self._elements, self._scene)
            self._bindings[data] = binding
        self._recent = (weakref.ref(data), binding.address)
        return binding.address

    def _unstable(self, data: mujoco.MjData, failed: int) -> UnstableError:
        step = f"a time step below {self._options.timestep:g} s may keep it"
        if failed >= 0:
            body = int(self._bindings[data].bodies[failed]["body"])
            return UnstableError(
                f"the sand's force on body {self._names.bodies[body]!r} is not finite at "
                f"t = {data.time:.6g} s: the state has left reason; {step}"
            )
        for what in ("QPOS", "QVEL", "QACC"):
            warning = data.warning[int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{what}"))]
            if warning.number:
                warning.number = 0  # told
                dof = min(int(warning.lastinfo), self._model.nv - 1)
                body = self._model.body(int(self._model.dof_bodyid[dof]))
                kept = self._options.disableflags & int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
                return UnstableError(
                    f"the state left reason: MuJoCo found NaN, infinite or huge numbers in "
                    f"{what.lower()} of body {body.name or body.id!r}"
                    f"{'' if kept else ' and has reset the simulation'}; {step}"
                )
        return UnstableError(f"the state left reason; {step}")

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
