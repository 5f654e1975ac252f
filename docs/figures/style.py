"""One look for all figures of the documentation."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

FOLDER = Path(__file__).resolve().parent

# Okabe and Ito's colours, which stay apart for colour-blind readers.
BLUE, ORANGE, GREEN, PURPLE, GREY = "#0072B2", "#D55E00", "#009E73", "#AA4499", "#6B6B6B"
SAND, STEEL = "#EBD9B4", "#596673"

plt.rcParams.update(
    {
        "figure.dpi": 144,
        "figure.facecolor": "white",
        "figure.constrained_layout.use": True,
        "font.size": 10,
        "axes.titlesize": 10,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.color": "#DDDDDD",
        "grid.linewidth": 0.6,
        "legend.frameon": False,
        "lines.linewidth": 1.6,
        "mathtext.fontset": "cm",
    }
)


def save(figure: Figure, name: str) -> None:
    """Writes the figure beside the scripts, without a date: the same run gives the same file."""
    path = FOLDER / f"{name}.png"
    figure.savefig(path, metadata={"Software": None})
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")
