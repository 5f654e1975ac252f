"""Error of the explicit scheme against the time step, with and without the half step."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from matplotlib import pyplot as plt
from reference import stop
from style import BLUE, GREEN, GREY, ORANGE, save

from mjgranular import Explicit, Sand
from mjgranular.experiment import Impact
from mjgranular.models import Link

SPEED, ANGLE = 10.0, math.pi / 4
LINK = Link()


def drop(timestep: float, *, half_step: bool, start_back: bool = False) -> tuple[float, float]:
    """Stopping time [s] and depth [m].

    The stop is read with velocities taken to the time of the positions: the mean of `qvel` before
    and after the step.

    Args:
        timestep: of the simulation [s].
        half_step: of the scheme.
        start_back: give the starting velocity half a step before the starting position.
    """
    model = LINK.model(timestep)
    data = mujoco.MjData(model)
    sand = Sand(model, law="link", scheme=Explicit(half_step=half_step), bodies="link")
    data.qpos[:] = LINK.touching(ANGLE)
    speed = SPEED - start_back * 9.81 * timestep / 2  # there only gravity acts
    data.qvel[:] = LINK.moving(ANGLE, speed, 0.0, 0.0)
    before = (0.0, SPEED)
    for step in range(100_000):
        qpos, qvel = data.qpos.copy(), data.qvel.copy()
        sand.step(data)
        _, depth, _, speed = LINK.tip(qpos, (qvel + data.qvel) / 2)
        if speed <= 0:
            part = before[1] / (before[1] - speed)
            return (step - 1 + part) * timestep, before[0] + timestep * part * before[1] / 2
        before = (depth, speed)
    raise RuntimeError("the link did not stop")


def main() -> None:
    """Draws the figure and prints the numbers in it."""
    exact = np.array(stop(SPEED, ANGLE))
    print(f"reference: {exact[0]:.9f} s {exact[1]:.9f} m")
    steps = np.geomspace(1e-6, 2e-4, 12)
    series = (
        ("without half step", ORANGE, "s", {"half_step": False}),
        ("with half step", BLUE, "o", {"half_step": True}),
        ("the same, started half a step back", GREEN, "^", {"half_step": True, "start_back": True}),
    )
    figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.7), sharex=True, sharey=True)
    for label, colour, marker, options in series:
        errors = np.array([np.abs(np.array(drop(h, **options)) / exact - 1) for h in steps])
        for axis, error in zip(axes, errors.T, strict=True):
            axis.loglog(steps, error, color=colour, marker=marker, ms=4, lw=1.2, label=label)
        for h, (time, depth) in zip(steps, errors, strict=True):
            print(f"{label}: h = {h:.2e} s, time {time:.2e}, depth {depth:.2e}")
    bound = Impact(speed=SPEED, angle=ANGLE).largest_step()
    for axis, title in zip(axes, ("stopping time", "depth at the stop"), strict=True):
        axis.axvline(bound, color=GREY, ls=":", lw=1)
        axis.set(title=title, xlabel="time step $h$ [s]", ylim=(1e-11, 1e-1))
    axes[0].set_ylabel("relative error [-]")
    axes[0].legend(loc="lower left", fontsize=8)
    guide = np.array([2e-6, 2e-5])
    axes[1].loglog(guide, 0.6e-1 * guide / 1e-4, color=GREY, lw=0.8)
    axes[1].text(5e-6, 7e-3, "slope 1", color=GREY, fontsize=8, ha="center")
    axes[1].loglog(guide, 2e-6 * (guide / 2e-5) ** 2, color=GREY, lw=0.8)
    axes[1].text(9e-6, 1e-7, "slope 2", color=GREY, fontsize=8, ha="left")
    axes[1].text(bound * 0.93, 2e-11, "$h\\cdot$rate $= 1$", color=GREY, fontsize=8, ha="right")
    save(figure, "convergence")


if __name__ == "__main__":
    main()
