"""A plate in the sand: tilt, attack, normal and velocity, as resistive force theory counts them."""

from __future__ import annotations

import math

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Arc, FancyArrowPatch
from style import BLUE, GREEN, GREY, ORANGE, PURPLE, SAND, STEEL, save

TILT, ATTACK = math.radians(30), math.radians(42)


def arrow(axis: Axes, start: np.ndarray, end: np.ndarray, colour: str, style: str = "-|>") -> None:
    """An arrow that does not shrink at its ends."""
    axis.add_patch(
        FancyArrowPatch(
            start, end, arrowstyle=style, color=colour, lw=1.7, mutation_scale=13,
            shrinkA=0, shrinkB=0, zorder=6,
        )
    )  # fmt: skip


def main() -> None:
    """Draws the figure; lengths mean nothing."""
    normal = np.array([math.sin(TILT), -math.cos(TILT)])
    along = np.array([math.cos(TILT), math.sin(TILT)])
    motion = np.array([math.cos(ATTACK), -math.sin(ATTACK)])
    middle = np.array([0.0, -1.05])

    figure, axis = plt.subplots(figsize=(7.2, 4.6))
    axis.axhspan(-2.6, 0, color=SAND, lw=0, zorder=0)
    axis.axhline(0, color="#B08D4C", lw=1.2, zorder=1)
    axis.text(-2.4, -2.45, "sand", color="#8A6A2F")

    half, thick = 0.95, 0.07
    corners = [
        middle + half * along,
        middle - half * along,
        middle - half * along - thick * normal,
        middle + half * along - thick * normal,
    ]
    axis.fill(*np.array(corners).T, color=STEEL, lw=0, zorder=3)
    axis.plot(*np.array(corners[:2]).T, color="black", lw=2.2, zorder=4)

    # The horizontal and the vertical through the middle of the element.
    axis.plot([middle[0], 2.35], [middle[1]] * 2, color=GREY, lw=0.9, ls="--", zorder=2)
    axis.plot([middle[0]] * 2, [middle[1], -2.4], color=GREY, lw=0.9, ls="--", zorder=2)
    arrow(axis, np.array([-1.35, 0.0]), np.array([-1.35, middle[1]]), GREY, "<|-|>")
    axis.plot([-1.45, middle[0]], [middle[1]] * 2, color=GREY, lw=0.7, zorder=2)
    axis.text(-1.45, middle[1] / 2, r"$|z|$", fontsize=14, ha="right", va="center")

    axis.add_patch(Arc(middle, 1.5, 1.5, theta1=0, theta2=math.degrees(TILT), color=STEEL, lw=1.4))
    axis.text(0.82, middle[1] + 0.13, r"$\beta$", fontsize=15, color=STEEL)
    low = math.degrees(ATTACK)
    axis.add_patch(Arc(middle, 2.5, 2.5, theta1=-low, theta2=0, color=GREEN, lw=1.4))
    axis.text(1.3, middle[1] - 0.55, r"$\gamma$", fontsize=15, color=GREEN)
    axis.add_patch(
        Arc(middle, 1.9, 1.9, theta1=-90, theta2=math.degrees(TILT) - 90, color=STEEL, lw=1.2)
    )
    axis.text(0.13, middle[1] - 0.86, r"$\beta$", fontsize=14, color=STEEL)

    arrow(axis, middle, middle + 1.3 * normal, BLUE)
    axis.text(*(middle + 1.3 * normal + [0.05, -0.07]), "$n$", color=BLUE, fontsize=15)
    arrow(axis, middle, middle + 1.7 * motion, GREEN)
    axis.text(*(middle + 1.7 * motion + [0.07, -0.08]), "$v$", color=GREEN, fontsize=15)
    force = np.array([-0.72, 0.86])
    arrow(axis, middle, middle + force, ORANGE)
    axis.text(*(middle + force + [-0.34, -0.03]), r"$dF$", color=ORANGE, fontsize=15)

    origin = np.array([1.75, 0.35])
    step, up = np.array([0.5, 0.0]), np.array([0.0, 0.5])
    arrow(axis, origin, origin + step, PURPLE)
    arrow(axis, origin, origin + up, PURPLE)
    axis.text(*(origin + 1.08 * step), "$r$", fontsize=13, color=PURPLE, va="center")
    axis.text(*(origin + 1.1 * up), "$z$", fontsize=13, color=PURPLE, ha="center")

    axis.set(xlim=(-2.5, 2.5), ylim=(-2.6, 1.05), aspect="equal")
    axis.axis("off")
    save(figure, "rft_frame")


if __name__ == "__main__":
    main()
