"""Hostile motions, over which sand may give no energy."""

from __future__ import annotations

import mujoco
import numpy as np

from mjgranular import Sand

PHASES = ("strike", "push", "brake", "turn", "withdraw", "hold", "free")


class Hostile:
    """Draws the force of each step: phases of 2 to 30 ms, one after another.

    Strikes set a model in motion within a step, brakes and holds are harder than the sand, turns
    wheel a body round within 10 ms, and withdrawals pull it up.

    Args:
        rng: draws phases, directions and speeds.
        model: its first three degrees of freedom move it, the others turn it, faster.
    """

    def __init__(self, rng: np.random.Generator, model: mujoco.MjModel) -> None:
        self.rng, self.model = rng, model
        self.turns = np.arange(model.nv) >= 3
        self.left, self.phase, self.goal = 0, "free", np.zeros(model.nv)

    def force(self, data: mujoco.MjData) -> np.ndarray:
        """Return the generalized force of a step [N, N m], after `mj_step1`."""
        rng, h, nv = self.rng, self.model.opt.timestep, self.model.nv
        if self.left <= 0:
            self.phase = str(rng.choice(PHASES))
            self.left = 1 if self.phase == "strike" else max(1, int(rng.uniform(0.002, 0.03) / h))
            self.goal = rng.normal(size=nv) * rng.uniform(0.3, 6.0)
        self.left -= 1
        v, change = data.qvel, np.zeros(nv)
        if self.phase == "strike":
            change = self.goal * np.where(self.turns, 5.0, 1.0) / h
        elif self.phase == "push":
            change = self.goal / 0.02
        elif self.phase == "brake":
            change = -v * rng.uniform(0.5, 1.0) / max(h, 0.003)
        elif self.phase == "turn":
            change = self.turns * (10.0 * self.goal - v) / max(h, 0.01)
        elif self.phase == "hold":
            change = (self.goal - v) / max(h, 0.005)
        elif self.phase == "withdraw":
            change[min(2, nv - 1)] = abs(self.goal[0]) / 0.01
        force = np.zeros(nv)
        mujoco.mj_mulM(self.model, data, force, change)
        return force


def work_given(
    sand: Sand, model: mujoco.MjModel, data: mujoco.MjData, *, steps: int, seed: int = 0
) -> tuple[float, float]:
    """Move a model that is at rest by hostile forces.

    Returns:
        The work of the sand in steps in which it gives energy, at velocities that steps end with,
        and the work that the forces have put in [J].
    """
    hostile = Hostile(np.random.default_rng(seed), model)
    given, put, h = 0.0, 0.0, model.opt.timestep
    for _ in range(steps):
        mujoco.mj_step1(model, data)
        data.qfrc_applied[:] = force = hostile.force(data)
        data.xfrc_applied[:] = 0.0
        sand.apply(data)
        sands = np.zeros(model.nv)
        for body in range(1, model.nbody):
            wrench, point = data.xfrc_applied[body], data.xipos[body]
            mujoco.mj_applyFT(model, data, wrench[:3], wrench[3:], point, body, sands)
        mujoco.mj_step2(model, data)
        given += h * max(float(sands @ data.qvel), 0.0)
        put += h * max(float(force @ data.qvel), 0.0)
    return given, put
