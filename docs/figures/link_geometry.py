"""The link in the sand: angle, points, immersed length, velocity and forces."""

from __future__ import annotations

import math

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Arc, FancyArrowPatch
from style import BLUE, GREEN, GREY, ORANGE, PURPLE, SAND, STEEL, save

Q = math.radians(38)
LENGTH, DIAMETER = 2.4, 0.11
Y_T = 0.72


def arrow(axis: Axes, start: np.ndarray, end: np.ndarray, colour: str, style: str = "-|>") -> None:
    """An arrow that does not shrink at its ends."""
    axis.add_patch(
        FancyArrowPatch(
            start, end, arrowstyle=style, color=colour, lw=1.6, mutation_scale=13,
            shrinkA=0, shrinkB=0, zorder=5,
        )
    )  # fmt: skip


def shifted(point: np.ndarray, x: float, z: float) -> np.ndarray:
    """A point a little way off."""
    return point + np.array([x, z])


def main() -> None:
    """Draws the figure. Depth is drawn downward, in units of half the link's length."""
    along = np.array([math.sin(Q), -math.cos(Q)])  # from C to T, z up
    across = np.array([math.cos(Q), math.sin(Q)])
    T = np.array([0.45, -Y_T])
    C = T - LENGTH / 2 * along
    top = T - LENGTH * along
    length = Y_T / math.cos(Q)
    E = T - length / 2 * along
    entry = T - length * along

    figure, axis = plt.subplots(figsize=(7.6, 5.2))
    axis.axhspan(-1.15, 0, color=SAND, lw=0, zorder=0)
    axis.axhline(0, color="#B08D4C", lw=1.2, zorder=1)
    axis.text(1.95, -0.09, "sand", color="#8A6A2F", ha="right")

    # The link, a capsule from pole to pole.
    radius = DIAMETER / 2
    turn = np.linspace(0, math.pi, 40)
    cap = np.outer(np.cos(turn), across) * radius
    low = T - radius * along + cap + np.outer(np.sin(turn), along) * radius
    high = top + radius * along - cap - np.outer(np.sin(turn), along) * radius
    axis.fill(*np.vstack([low, high]).T, color=STEEL, alpha=0.55, lw=0, zorder=2)

    # The vertical and the angle q.
    axis.plot([C[0], C[0]], [C[1], C[1] + 0.95], color=GREY, lw=0.9, ls="--", zorder=3)
    axis.add_patch(Arc(C, 1.4, 1.4, theta1=90, theta2=90 + math.degrees(Q), color=GREY, lw=1.1))
    axis.text(C[0] - 0.24, C[1] + 0.78, "$q$", fontsize=14)

    # Depth of T and immersed length.
    axis.plot([T[0], 1.62], [T[1], T[1]], color=GREY, lw=0.7, zorder=3)
    arrow(axis, np.array([1.55, 0.0]), np.array([1.55, -Y_T]), GREY, "<|-|>")
    axis.text(1.6, -Y_T / 2, "$y_T$", fontsize=14, va="center")
    side = 0.72 * across
    for point in (entry, T):
        axis.plot(*np.array([point + 0.09 * across, point + side * 1.06]).T, color=GREY, lw=0.7)
    arrow(axis, entry + side, T + side, GREY, "<|-|>")
    axis.text(
        *((entry + T) / 2 + side + 0.08 * across),
        "$l = y_T/\\cos q$",
        fontsize=13,
        ha="center",
        va="bottom",
        rotation=math.degrees(Q) - 90,
        rotation_mode="anchor",
    )

    # Points.
    names = ((C, "$C$", (0.09, -0.03)), (E, "$E$", (-0.17, -0.19)), (T, "$T$", (0.02, -0.2)))
    for point, name, shift in names:
        axis.plot(*point, "o", color="black", ms=5, zorder=6)
        axis.text(*(point + shift), name, fontsize=14, zorder=6)

    # Velocity of E and the forces.
    v = np.array([0.13, -0.5])
    unit = v / np.linalg.norm(v)
    arrow(axis, E, E + v, GREEN)
    axis.text(*shifted(E + v, 0.02, -0.13), "$v_E$", color=GREEN, fontsize=14, ha="center")
    arrow(axis, E, E - 0.74 * unit, BLUE)
    axis.text(*shifted(E - 0.74 * unit, 0.03, 0.04), "$F_d$", color=BLUE, fontsize=14)
    arrow(axis, E, shifted(E, -0.52, 0), ORANGE)
    axis.text(*shifted(E, -0.72, -0.05), "$F_{sx}$", color=ORANGE, fontsize=14)
    up = E + np.array([0.0, 0.46])
    arrow(axis, E, up, ORANGE)
    axis.text(*shifted(up, 0.05, -0.08), "$F_{sy}$", color=ORANGE, fontsize=14)
    arrow(axis, C, shifted(C, 0, -0.4), PURPLE)
    axis.text(*shifted(C, -0.18, -0.38), "$G$", color=PURPLE, fontsize=14)

    # Axes of the paper and of MuJoCo.
    origin = np.array([-1.55, 0.95])
    for step, name, shift in (
        ((0.32, 0), "$x$", (0.04, -0.05)),
        ((0, -0.32), "$y$ (depth)", (-0.05, -0.15)),
        ((0, 0.32), "$z$ (world)", (-0.05, 0.06)),
    ):
        arrow(axis, origin, origin + step, "black")
        axis.text(*(origin + step + shift), name, fontsize=11)

    axis.set(xlim=(-1.75, 2.0), ylim=(-1.15, 1.45), aspect="equal")
    axis.axis("off")
    save(figure, "link_geometry")


if __name__ == "__main__":
    main()
