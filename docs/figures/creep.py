"""Creep of the explicit scheme: the speed at which a link at rest sinks, against the time step."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from matplotlib import pyplot as plt
from style import BLUE, GREEN, GREY, save

from mjgranular import Sand
from mjgranular.models import Link

LINK = Link()
SETTLED, END = 0.2, 0.6  # [s]; the link is at rest, but for the creep, from 0.1 s on


def creep(timestep: float, *, speed: float, angle: float) -> float:
    """Mean speed of C long after an impact [m/s].

    Args:
        timestep: of the simulation [s].
        speed: v_Ty(0) [m/s].
        angle: q(0) [rad].
    """
    model = LINK.model(timestep)
    data = mujoco.MjData(model)
    sand = Sand(model, law="link_distributed", bodies="link", scheme="explicit")
    data.qpos[:] = LINK.touching(angle)
    data.qvel[:] = LINK.moving(angle, speed, 0.0, 0.0)
    for _ in range(round(SETTLED / timestep)):
        sand.step(data)
    start = data.qpos.copy()
    for _ in range(round((END - SETTLED) / timestep)):
        sand.step(data)
    dx, dz, _ = data.qpos - start
    return math.hypot(dx, dz) / (END - SETTLED)


def main() -> None:
    """Draws the figure and prints the numbers in it."""
    steps = np.geomspace(1e-6, 1e-4, 7)
    figure, axis = plt.subplots(figsize=(5.6, 3.8))
    for label, colour, marker, speed, angle in (
        ("after 10 m/s, 45°: nearly flat", BLUE, "o", 10.0, math.pi / 4),
        ("after 1 m/s, 0°: upright", GREEN, "^", 1.0, 0.0),
    ):
        speeds = [creep(h, speed=speed, angle=angle) for h in steps]
        axis.loglog(steps, speeds, color=colour, marker=marker, ms=5, lw=1.2, label=label)
        for h, value in zip(steps, speeds, strict=True):
            print(f"{label}: h = {h:.2e} s, {value:.3e} m/s = {value / (9.81 * h):.2f} g h")
    axis.loglog(steps, 9.81 * steps, color=GREY, ls="--", lw=1, label="$g h$")
    axis.set(xlabel="time step $h$ [s]", ylabel="creep of $C$ at rest [m/s]")
    axis.legend(loc="upper left", fontsize=9)
    save(figure, "creep")


if __name__ == "__main__":
    main()
