"""Follows a point of a model down to where it stops."""

from __future__ import annotations

import mujoco
import numpy as np

from mjgranular.errors import UnknownNameError
from mjgranular.experiment.watch import STILL


class TipWatch:
    """Follows a site down to where it stops.

    After `Sand.step`, places of sites are those at the beginning of the step, and velocities belong
    half a step before and half a step after them: their mean is taken.

    Args:
        model: the model.
        data: the simulation, not stepped yet.
        site: name of the site.
        height: of the level surface [m].

    Attributes:
        stop: time since the site touched the sand [s], and depth [m], when its vertical velocity
            was first zero; None until then.

    Raises:
        UnknownNameError: the model has no such site.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, site: str, *, height: float
    ) -> None:
        self._model = model
        self._site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, site)
        if self._site < 0:
            known = [model.site(s).name for s in range(model.nsite)]
            raise UnknownNameError("site of the model", site, known)
        self._height = height
        self._step = model.opt.timestep
        self._jacobian = np.zeros((3, model.nv))
        self._qvel = data.qvel.copy()
        self._old: tuple[float, float] | None = None  # depth, velocity down
        self._touchdown: float | None = None
        self._steps = 0
        self.stop: tuple[float, float] | None = None

    def follow(self, data: mujoco.MjData) -> None:
        """To be called after every step."""
        mujoco.mj_jacSite(self._model, data, self._jacobian, None, self._site)
        down = -float(self._jacobian[2] @ (self._qvel + data.qvel)) / 2
        self._qvel[:] = data.qvel
        depth = self._height - float(data.site_xpos[self._site, 2])
        time, h = self._steps * self._step, self._step
        self._steps += 1
        if self._old is None:
            # What begins on the surface may be rounded to a hair above it.
            self._touchdown = 0.0 if depth > -1e-12 else None
        elif self._touchdown is None and depth >= 0:
            self._touchdown = time - h * depth / (depth - self._old[0])
        elif self._touchdown is not None and self.stop is None and self._old[1] > STILL >= down:
            part = min(self._old[1] / (self._old[1] - down), 1.0)
            when = time - h + part * h - self._touchdown
            self.stop = when, self._old[0] + h * part * self._old[1] / 2
        self._old = depth, down
