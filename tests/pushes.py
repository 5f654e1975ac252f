"""Random pushes, against which sand may give no energy."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular import Sand


def most_work_given(
    sand: Sand,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    *,
    pushes: Sequence[float],
    steps: int,
) -> float:
    """Pushes body 1, free and at rest, by another wrench at each step; what the sand has given.

    In a single step sand that moves along may give of the energy that it was given before.

    Args:
        sand: the sand.
        model: its model.
        data: the simulation.
        pushes: standard deviations of force [N] and moment [N m], shape (6,).
        steps: how many.

    Returns:
        The greatest work of the sand since the beginning, at velocities that steps end with [J].
    """
    rng, total, most = np.random.default_rng(0), 0.0, -math.inf
    for _ in range(steps):
        data.xfrc_applied[1] = rng.normal(size=6) * pushes
        mujoco.mj_step1(model, data)
        pushed = data.xfrc_applied[1].copy()
        sand.apply(data)
        wrench = data.xfrc_applied[1] - pushed
        rotation = data.xmat[1].reshape(3, 3).copy()
        mujoco.mj_step2(model, data)
        motion = np.concatenate([data.qvel[:3], rotation @ data.qvel[3:]])
        total += wrench @ motion * model.opt.timestep
        most = max(most, total)
        data.xfrc_applied[1] = 0
    return most
