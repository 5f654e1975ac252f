"""Drift of the paper's link at rest against the time step, explicit beside implicit."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from matplotlib import pyplot as plt
from style import BLUE, GREEN, GREY, ORANGE, save

from mjgranular import Sand, UnstableError
from mjgranular.models import Link

LINK = Link()
SETTLED, END = 5.0, 10.0  # [s]
DROPS = ((10.0, 45.0, "o"), (1.0, 0.0, "^"), (50.0, 60.0, "s"))  # [m/s], [deg]
BAR = 1e-9  # what is asked of rest [m]
LEAST, LOST = (
    1e-15,
    1.0,
)  # a drift of nothing is drawn at the one; beyond the other, not at rest [m]
STEPS = {
    "explicit": np.geomspace(1e-5, 1e-2, 7),
    "implicit": np.array([1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 2e-3, 5e-3, 1e-2]),
}  # [s]


def drift(timestep: float, *, scheme: str, speed: float, angle: float) -> float:
    """How far the link moves in the last 5 of 10 s [m], [rad]: the greater of both.

    Args:
        timestep: of the simulation [s].
        scheme: its name.
        speed: v_Ty(0) [m/s].
        angle: q(0) [deg].

    Returns:
        NaN if the simulation does not get there.
    """
    model = LINK.model(timestep)
    data = mujoco.MjData(model)
    sand = Sand(model, law="link_distributed", scheme=scheme, bodies="link")
    q = math.radians(angle)
    data.qpos[:] = LINK.touching(q)
    data.qvel[:] = LINK.moving(q, speed, 0.0, 0.0)
    try:
        for _ in range(round(SETTLED / timestep)):
            sand.step(data)
        before = data.qpos.copy()
        for _ in range(round((END - SETTLED) / timestep)):
            sand.step(data)
    except UnstableError:
        return math.nan
    return float(abs(data.qpos - before).max())


def main() -> None:
    """Draws the figure and prints the numbers in it."""
    figure, axis = plt.subplots(figsize=(6.4, 4.2))
    for scheme, colour in (("explicit", ORANGE), ("implicit", BLUE)):
        steps = STEPS[scheme]
        for speed, angle, marker in DROPS:
            drifts = [drift(h, scheme=scheme, speed=speed, angle=angle) for h in steps]
            for h, value in zip(steps, drifts, strict=True):
                print(f"{scheme}, {speed:g} m/s, {angle:g} deg: h = {h:.1e} s, drift {value:.1e}")
            drawn = np.clip(np.nan_to_num(drifts, nan=math.inf), LEAST, None)
            rests = drawn < LOST
            label = f"{scheme}, {speed:g} m/s, {angle:g}°"
            axis.loglog(
                steps[rests], drawn[rests], color=colour, marker=marker, ms=5, lw=1.2, label=label
            )
            lost = steps[~rests]
            axis.plot(lost, np.full(len(lost), LOST), color=colour, marker="x", ms=7, ls="")
    axis.text(1e-2, 2.5 * LOST, "x: lost", color=ORANGE, fontsize=9, ha="right")
    axis.axhline(BAR, color=GREEN, ls="--", lw=1)
    axis.text(1e-5, 1.4 * BAR, "1 nm in 5 s", color=GREEN, fontsize=9, va="bottom")
    guide = np.array([2e-5, 1e-3])
    axis.loglog(guide, (END - SETTLED) * 9.81 * guide, color=GREY, lw=0.8, ls=":")
    axis.text(1.5e-4, 1.5e-3, "$g h$ times 5 s", color=GREY, fontsize=9)
    axis.set(
        xlabel="time step $h$ [s]",
        ylabel="drift from 5 s to 10 s [m], [rad]",
        ylim=(3e-16, 30.0),
    )
    axis.legend(loc="center right", fontsize=8, bbox_to_anchor=(1.0, 0.62))
    save(figure, "rest_drift")


if __name__ == "__main__":
    main()
