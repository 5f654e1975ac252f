"""How the distributed law spreads the static force along the link, and where its resultant is."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.lines import Line2D
from style import BLUE, GREY, ORANGE, save

from mjgranular import DistributedLinkLaw, Sand, media
from mjgranular.models import Link

ANGLE, Y_T = math.pi / 4, 0.03


def main() -> None:
    """Draws the figure and prints totals and resultants."""
    link = Link()
    model = link.model(1e-5)
    data = mujoco.MjData(model)
    data.qpos[:] = link.touching(ANGLE)
    data.qpos[1] -= Y_T
    data.qvel[:] = 1e-9, -1e-9, 0.0  # slow, without drag: both static limits

    lumped = Sand(model, law="link", bodies="link").report(data)["link"].force
    constants = media["play_sand"].constants_for("link")
    figure, axis = plt.subplots(figsize=(5.6, 3.6))
    for pieces, marker in ((20, "o"), (400, "")):
        law = DistributedLinkLaw(**constants, pieces=pieces)
        report = Sand(model, law=law, bodies="link").report(data)
        inside = [e for e in report.elements if e.immersed_length > 0]
        depth = np.array([-e.point[2] for e in inside])
        for k, colour in ((0, ORANGE), (2, BLUE)):
            force = np.array([abs(e.force[k]) for e in inside])
            density = force / [e.immersed_length for e in inside]
            style = {"marker": marker, "ls": ""} if marker else {"lw": 1.2}
            axis.plot(density, 1e3 * depth, color=colour, ms=4, **style)
            centre = float(force @ depth / force.sum())
            ratio = force.sum() / abs(lumped[k])
            print(f"{pieces} pieces, axis {k}: {ratio:.5f} of the lumped total")
            print(f"  {abs(lumped[k]):.3f} N lumped; resultant at {centre / Y_T:.4f} y_T")
            if pieces == 400:
                axis.axhline(1e3 * centre, color=colour, ls="--", lw=1)
    axis.axhline(1e3 * Y_T / 2, color=GREY, ls=":", lw=1.2)
    axis.set(
        xlabel="static force per length of axis [N/m]",
        ylabel="depth $y$ [mm]",
        ylim=(1e3 * Y_T, 0),
        xlim=(0, None),
    )
    axis.legend(
        handles=[
            Line2D([], [], color=ORANGE, marker="o", ms=4, label="horizontal"),
            Line2D([], [], color=BLUE, marker="o", ms=4, label="vertical"),
            Line2D([], [], color="black", ls="--", lw=1, label="depth of its resultant"),
            Line2D([], [], color=GREY, ls=":", lw=1.2, label="depth of $E$ (lumped)"),
        ],
        fontsize=9,
        loc="upper right",
    )
    save(figure, "distribution")


if __name__ == "__main__":
    main()
