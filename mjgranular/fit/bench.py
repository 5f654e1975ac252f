"""Sand under a body whose law changes between evaluations, without recompiling.

A law's constants are numbers in the record that its compiled program reads. If a change of
constants changes neither elements nor kernels, which is checked once for each set of constants, a
new law is a new record and costs nothing.
"""

from __future__ import annotations

import warnings
from dataclasses import fields

import mujoco
import numpy as np

from mjgranular.errors import GranularWarning, InputError, UnstableError
from mjgranular.fit.constants import Material
from mjgranular.kernel.compiled import entry
from mjgranular.sand.binding import Binding, bind
from mjgranular.sand.guard import finish_step, guarded_step
from mjgranular.sand.prepare import PreparedSand, prepare
from mjgranular.sand.spec import SandSpec
from mjgranular.scheme import Scheme
from mjgranular.scheme.status import FINE

_STILL = 1e-6  # largest velocity at which a body counts as at rest [m/s], [rad/s]; chosen
_LOOK = 8  # steps between two checks for rest


class Bench:
    """A model on sand of any constants.

    Args:
        model: the model.
        scheme: time stepping scheme, for free motion or for forces on a prescribed motion.
        bodies: names of the bodies that meet the sand; None for all that can move.
    """

    def __init__(
        self, model: mujoco.MjModel, scheme: Scheme, bodies: tuple[str, ...] | None = None
    ) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        self._scheme, self._bodies = scheme, bodies
        self._prepared: PreparedSand | None = None
        self._material: Material | None = None
        self._binding: Binding | None = None
        self._alike: set[frozenset[str]] = set()  # sets of constants that elements do not depend on

    def _prepare(self, material: Material) -> PreparedSand:
        spec = SandSpec(
            medium=material.medium, law=material.law, scheme=self._scheme, bodies=self._bodies
        )
        with warnings.catch_warnings():  # the model is made for this, and the law is still unknown
            warnings.simplefilter("ignore", GranularWarning)
            return prepare(self.model, spec)

    def use(self, material: Material) -> None:
        """Change the material of the sand.

        Raises:
            InputError: the law has no elements for the body.
        """
        before, prepared = self._material, self._prepared
        if before is None or prepared is None or type(before.law) is not type(material.law):
            self._keep(self._prepare(material), material)
            return
        law = material.law
        kernel = law.kernel(prepared.surface)
        changed = _changed(before, material)
        if kernel is prepared.kernel and changed in self._alike:
            prepared.scene["law"][:] = law.parameters(material.medium)
            return
        anew = self._prepare(material)
        if kernel is prepared.kernel and np.array_equal(anew.elements, prepared.elements):
            self._alike.add(changed)
            prepared.scene["law"][:] = anew.scene["law"]
            return
        self._keep(anew, material)

    def _keep(self, prepared: PreparedSand, material: Material) -> None:
        self.data = mujoco.MjData(self.model)  # data bound to the old sand has its addresses
        self._prepared, self._material = prepared, material
        self._binding = bind(self.model, self.data, prepared)
        self._guarded = entry(guarded_step, "int64(int64, int64, float64)")
        self._finish = entry(finish_step, "int64(int64)")
        self._alike.clear()

    @property
    def elements(self) -> np.ndarray:
        """The elements of the law."""
        assert self._prepared is not None
        return self._prepared.elements

    def _act(self, lead: float) -> None:
        assert self._prepared is not None
        assert self._binding is not None
        if self._guarded(self._prepared.program, self._binding.address, lead) != FINE:
            raise self._unstable()

    def _unstable(self) -> UnstableError:
        return UnstableError(
            f"the simulation left reason at t = {self.data.time:.4g} s, with the law "
            f"{self._material.law if self._material else ''}"
        )

    def move(self, qpos: np.ndarray, qvel: np.ndarray, steps: int) -> np.ndarray:
        """Simulate the model.

        Args:
            qpos: initial positions.
            qvel: velocities half a time step before.
            steps: number of time steps.

        Returns:
            `qpos` after each step, the start first, shape (steps + 1, nq). A model at rest stays
            there.

        Raises:
            UnstableError: the state diverged.
        """
        model, data = self.model, self.data
        assert self._prepared is not None
        assert self._binding is not None
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = qpos, qvel
        timestep = model.opt.timestep
        path = np.empty((steps + 1, model.nq))
        path[0] = qpos
        lead = self._prepared.scheme.lead * timestep
        address = self._binding.address
        step1, step2, place, speed = mujoco.mj_step1, mujoco.mj_step2, data.qpos, data.qvel
        for step in range(1, steps + 1):
            step1(model, data)
            self._act(lead)
            step2(model, data)
            if self._finish(address) != FINE:
                raise self._unstable()
            path[step] = place
            if step % _LOOK == 0 and np.abs(speed).max() < _STILL:
                path[step:] = place
                break
        return path

    def watch(self, qpos: np.ndarray, qvel: np.ndarray, duration: float, body: int) -> np.ndarray:
        """Simulate the model, and return the depth of a body's deepest element before each step.

        Args:
            qpos: initial positions.
            qvel: initial velocities.
            duration: simulated time [s].
            body: its id.

        Returns:
            Depth [m], negative above the sand, shape (steps,).
        """
        model, data = self.model, self.data
        assert self._prepared is not None
        assert self._binding is not None
        rows = np.flatnonzero(self.elements["body"] == body)
        if not len(rows):
            raise InputError(f"the body {model.body(body).name!r} does not meet the sand")
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = qpos, qvel
        lead = self._prepared.scheme.lead * model.opt.timestep
        depth = np.empty(int(np.ceil(duration / model.opt.timestep)) + 1)
        for step in range(len(depth)):
            mujoco.mj_step1(model, data)
            self._act(lead)
            depth[step] = self._binding.contacts["depth"][rows].max()
            mujoco.mj_step2(model, data)
            if self._finish(self._binding.address) != FINE:
                raise self._unstable()
        return depth

    def force(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Return the sand's force on the model in a given state [N], world frame, shape (3,)."""
        model, data = self.model, self.data
        assert self._binding is not None
        data.qpos[:], data.qvel[:] = qpos, qvel
        data.xfrc_applied[:] = 0.0
        self._binding.bodies["last_wrench"] = np.nan
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        self._act(0.0)
        total = data.xfrc_applied[:, :3].sum(axis=0)
        data.xfrc_applied[:] = 0.0
        return total


def _changed(before: Material, after: Material) -> frozenset[str]:
    """Return the names of the constants by which two materials differ."""
    every = fields(before.law)  # pyright: ignore[reportArgumentType]
    names = {f.name for f in every if getattr(before.law, f.name) != getattr(after.law, f.name)}
    return frozenset(names | ({"medium"} if before.medium != after.medium else set()))
