"""The way of the data through the package, from the model to the force."""

from __future__ import annotations

from matplotlib import pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from style import BLUE, GREY, SAND, save

STATIONS = (
    ("MjModel", "geoms, bodies,\njoints", "white"),
    ("shape", "elements:\nwhere, which way,\nhow large", SAND),
    ("surface", "depth and normal\nat each element", SAND),
    ("law", "force on each\nelement, wrench\non each body", SAND),
    ("scheme", "at which velocity;\nadd, step,\ntake back", SAND),
    ("MjData", "xfrc_applied", "white"),
)
WIDTH, GAP, HEIGHT = 1.22, 0.26, 0.5


def main() -> None:
    """Draws the figure."""
    figure, axis = plt.subplots(figsize=(8.6, 2.0))
    for i, (name, what, colour) in enumerate(STATIONS):
        left = i * (WIDTH + GAP)
        edge = BLUE if colour == "white" else "#B08D4C"
        axis.add_patch(
            FancyBboxPatch(
                (left + 0.06, 0.06),
                WIDTH - 0.12,
                HEIGHT - 0.12,
                boxstyle="round,pad=0.06",
                fc=colour,
                ec=edge,
            )
        )
        middle = left + WIDTH / 2
        axis.text(middle, HEIGHT / 2, name, ha="center", va="center", family="monospace")
        axis.text(middle, -0.12, what, ha="center", va="top", fontsize=8, color=GREY)
        if i:
            axis.add_patch(
                FancyArrowPatch(
                    (left - GAP + 0.02, HEIGHT / 2),
                    (left - 0.02, HEIGHT / 2),
                    arrowstyle="-|>",
                    mutation_scale=11,
                    shrinkA=0,
                    shrinkB=0,
                    color=GREY,
                )
            )
    right = 5 * (WIDTH + GAP) - GAP
    axis.plot([WIDTH + GAP, right], [HEIGHT + 0.16] * 2, color=GREY, lw=1)
    axis.text(
        (WIDTH + GAP + right) / 2, HEIGHT + 0.24, "Sand binds these to a model", ha="center",
        color=GREY, fontsize=9,
    )  # fmt: skip
    axis.set(xlim=(-0.05, 6 * (WIDTH + GAP) - GAP + 0.05), ylim=(-0.85, 1.0))
    axis.axis("off")
    save(figure, "way")


if __name__ == "__main__":
    main()
