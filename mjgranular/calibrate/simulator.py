"""A model on sand whose law can change between runs, without recompiling.

A law's constants are numbers in the record that its compiled program reads. If a change of
constants changes neither elements nor kernels, which is checked once for each set of constants, a
new law is a new record and costs nothing.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import fields

import mujoco
import numpy as np

from mjgranular.calibrate.material import Material
from mjgranular.errors import GranularWarning, UnstableError
from mjgranular.kernel.compiled import entry
from mjgranular.sand.binding import Binding, bind
from mjgranular.sand.guard import finish_step, guarded_step
from mjgranular.sand.prepare import PreparedSand, prepare
from mjgranular.sand.spec import SandSpec
from mjgranular.scheme import Scheme
from mjgranular.scheme.status import FINE

_STILL = 1e-6  # largest velocity at which a body counts as at rest [m/s], [rad/s]; chosen
_CHECK_EVERY = 8  # steps between two checks for rest


class Simulator:
    """A model on sand of any constants; its time step may change between two runs.

    The scheme is for free motion, or for forces on a prescribed motion; `bodies` meet the sand,
    None for all that can move. `use` replaces `data` if elements or kernels change.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        scheme: Scheme | str = "auto",
        bodies: tuple[str, ...] | None = None,
    ) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        self._scheme, self._bodies = scheme, bodies
        self._prepared: PreparedSand
        self._binding: Binding
        self._material: Material | None = None
        self._harmless: set[frozenset[str]] = set()  # constants that elements do not depend on

    def use(self, material: Material) -> None:
        """Change the material of the sand."""
        before = self._material
        if before is None or type(before.law) is not type(material.law):
            self._bind(self._prepare(material), material)
            return
        now = self._prepared
        same_kernel = material.law.kernel(now.surface) is now.kernel
        changed = _changed(before, material)
        if not (same_kernel and changed in self._harmless):
            prepared = self._prepare(material)
            if not (same_kernel and np.array_equal(prepared.elements, now.elements)):
                self._bind(prepared, material)
                return
            self._harmless.add(changed)
        now.scene["law"][:] = material.law.parameters(material.medium)

    def _prepare(self, material: Material) -> PreparedSand:
        spec = SandSpec(
            medium=material.medium, law=material.law, scheme=self._scheme, bodies=self._bodies
        )
        with warnings.catch_warnings():  # the model is made for this, and the law is still unknown
            warnings.simplefilter("ignore", GranularWarning)
            return prepare(self.model, spec)

    def _bind(self, prepared: PreparedSand, material: Material) -> None:
        self.data = mujoco.MjData(self.model)  # data bound to the old sand has its addresses
        self._prepared, self._material = prepared, material
        self._binding = bind(self.model, self.data, prepared)
        self._guarded = entry(guarded_step, "int64(int64, int64, float64)")
        self._finish = entry(finish_step, "int64(int64)")
        self._harmless.clear()

    @property
    def elements(self) -> np.ndarray:
        """The elements of the law."""
        return self._prepared.elements

    @property
    def depths(self) -> np.ndarray:
        """Depth of each element at the last force [m], negative above the sand."""
        return self._binding.contacts["depth"]

    def _act(self, lead: float) -> None:
        if self._guarded(self._prepared.program, self._binding.address, lead) != FINE:
            raise self._unstable()

    def _unstable(self) -> UnstableError:
        law = self._material.law if self._material else ""
        return UnstableError(f"the simulation diverged at t = {self.data.time:.4g} s with {law}")

    def step(self) -> None:
        """Advance `data` by one time step."""
        mujoco.mj_step1(self.model, self.data)
        self._act(self._prepared.scheme.lead * self.model.opt.timestep)
        mujoco.mj_step2(self.model, self.data)
        if self._finish(self._binding.address) != FINE:
            raise self._unstable()

    def reset(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Start from a state."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel

    def move(
        self, steps: int, look: Callable[[], np.ndarray], *, until_rest: bool = False
    ) -> np.ndarray:
        """Advance `data`, and return what `look` returns after each step.

        At rest, if that is asked for, it stops and repeats the last row from there on.
        """
        first = np.asarray(look())
        rows = np.empty((steps, *first.shape))
        speed = self.data.qvel
        for step in range(1, steps + 1):
            self.step()
            rows[step - 1] = look()
            if until_rest and step % _CHECK_EVERY == 0 and np.abs(speed).max() < _STILL:
                rows[step:] = rows[step - 1]
                break
        return rows

    def force(self) -> np.ndarray:
        """Return the sand's force on the model at the state in `data` [N], world, shape (3,)."""
        model, data = self.model, self.data
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
