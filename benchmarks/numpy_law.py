"""The lumped link law in NumPy: cost of sand without compiled kernels.

For the planar link of `mjgranular.models` on the plane z = 0; the same formulas as in
`mjgranular.law.link`, in a few dozen lines of straightforward NumPy.
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjgranular import LinkLaw


class NumpySand:
    """Steps a model of one link as `Sand` does, with the explicit scheme at the current velocity.

    Args:
        model: model with one capsule or cylinder, its axis along z of the geom.
        law: the coefficients.
        density: density of the medium [kg/m^3].
    """

    def __init__(self, model: mujoco.MjModel, law: LinkLaw, density: float) -> None:
        self._model, self._law, self._density = model, law, density
        self._geom = model.geom("link").id
        self._body = int(model.geom_bodyid[self._geom])
        self._diameter = 2 * float(model.geom_size[self._geom, 0])
        self._length = 2 * float(model.geom_size[self._geom, 1])
        if model.geom_type[self._geom] == mujoco.mjtGeom.mjGEOM_CAPSULE:
            self._length += self._diameter
        self._velocity = np.zeros(6)

    def wrench(self, data: mujoco.MjData) -> np.ndarray:
        """Return force [N] and moment about the center of mass [N m], world axes, shape (6,)."""
        law, d = self._law, self._diameter
        center = data.geom_xpos[self._geom]
        axis = data.geom_xmat[self._geom].reshape(3, 3)[:, 2]
        if axis[2] > 0:
            axis = -axis
        tip = center + 0.5 * self._length * axis
        depth = -tip[2]
        if depth <= 0:
            return np.zeros(6)
        length = min(self._length, depth / max(-axis[2], 1e-12))
        point = tip - 0.5 * length * axis
        mujoco.mj_objectVelocity(
            self._model, data, mujoco.mjtObj.mjOBJ_BODY, self._body, self._velocity, 0
        )
        v = self._velocity[3:] + np.cross(self._velocity[:3], point - data.xipos[self._body])
        g = np.linalg.norm(self._model.opt.gravity)
        speed = np.linalg.norm(v)
        sine = np.linalg.norm(np.cross(axis, v))  # times the speed
        force = -law.eta_d * self._density * d * length * sine * v
        volume = 0.25 * np.pi * d**2 * length
        force[2] -= (
            np.sign(v[2]) * law.eta_v * (depth / d) ** law.exponent * g * self._density * volume
        )
        level = np.array([v[0], v[1], 0.0])
        if speed > 0 and np.any(level):
            along = law.eta_h * g * self._density * depth**2 * d
            force -= along * level / np.linalg.norm(level)
        moment = np.cross(point - data.xipos[self._body], force)
        return np.concatenate([force, moment])

    def step(self, data: mujoco.MjData) -> None:
        """Advance the simulation by one time step with the sand."""
        mujoco.mj_step1(self._model, data)
        data.xfrc_applied[self._body] = self.wrench(data)
        mujoco.mj_step2(self._model, data)
