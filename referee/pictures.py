"""Figures of the validity page: whole trajectories, measured and with each law."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

if TYPE_CHECKING:
    from comparison import Comparison

    from mjgranular.calibrate import Motion

# Okabe and Ito's colors; dashed lines for the laws without inertia, dotted for those with an added
# mass, dash-dotted for those for fast motion.
_LOOK = {
    "link": ("#AA4499", "--"),
    "link_distributed": ("#AA4499", "-"),
    "depth_velocity": ("#009E73", "-"),
    "rft2d": ("#D55E00", "--"),
    "rft2d inertia": ("#D55E00", "-"),
    "rft2d added": ("#D55E00", ":"),
    "rft2d_dynamic": ("#E69F00", "-."),
    "rft3d": ("#0072B2", "--"),
    "rft3d inertia": ("#0072B2", "-"),
    "rft3d added": ("#0072B2", ":"),
    "rft3d_dynamic": ("#009E73", "-."),
}
_REST = ("#6B6B6B", ":")
_WHAT = {
    "seen": "grains (DEM)",
    "small_bed": "grains (DEM)",
    "katsuragi_durian": "fit to the measurements",
    "plates": "line through the measurements",
    "quikrete": "stiffness as measured",
    "paper_link": "the paper's equations",
}


_AXES = {
    "turn": ("angle [deg]", "thrust [N]"),
    "roll": ("spin [rad/s]", "lift [N]"),
    "sink": ("spin [rad/s]", "sinkage [mm]"),
    "walk": ("rate [Hz]", "speed [m/s]"),
}


def draw(found: list[Comparison], folder: Path) -> str:
    """Draw all runs of a set; return the name of the file."""
    runs = found[0].runs
    columns = min(3, len(runs.runs))
    lines = -(-len(runs.runs) // columns)
    with plt.rc_context(
        {
            "figure.constrained_layout.use": True,
            "font.size": 9,
            "axes.titlesize": 9,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.grid": True,
            "grid.color": "#DDDDDD",
            "legend.frameon": False,
        }
    ):
        figure, axes = plt.subplots(
            lines, columns, figsize=(3.3 * columns, 2.6 * lines + 0.6), squeeze=False, dpi=144
        )
        for axis in axes.ravel()[len(runs.runs) :]:
            axis.set_axis_off()
        labels = {}
        for axis, run in zip(axes.ravel(), runs.runs, strict=False):
            motion, drop = run.motion, run.kind == "drop"
            dot = "o" if len(motion.depth) == 1 else None
            axis.set_title(run.name)
            x, y = _curve(run.kind, motion)
            (line,) = axis.plot(x, y, "k", lw=2.6, marker=dot, ms=8)
            labels[_WHAT.get(runs.name, "measured")] = line
            for c in found:
                if c.run is not run or c.motion is None:
                    continue
                color, style = _LOOK.get(c.candidate.name, _REST)
                curve = _curve(run.kind, c.motion)
                (line,) = axis.plot(*curve, style, color=color, lw=1.3, marker=dot)
                labels[c.candidate.name] = line
            if drop:
                axis.set(xlabel="time [ms]", ylabel="height of the lowest point [mm]")
                axis.set_xlim(0, 1.05 * x[-1])
            elif run.kind == "drag":
                axis.set(xlabel="speed [m/s]", ylabel="force [N]", ylim=(0, 1.25 * y.max()))
            elif run.kind in _AXES:
                axis.set(xlabel=_AXES[run.kind][0], ylabel=_AXES[run.kind][1])
            else:
                axis.set(xlabel="depth [mm]", ylabel="force [N]", xlim=(0, None))
        figure.legend(
            labels.values(), labels.keys(), loc="outside lower center", ncols=min(5, len(labels))
        )
        folder.mkdir(parents=True, exist_ok=True)
        name = f"validity_{runs.name}.png"
        figure.savefig(folder / name, metadata={"Software": None})
        plt.close(figure)
    return name


def _curve(kind: str, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Return a curve: height over time of a drop [mm, ms], force over depth [mm] or speed [N].

    For legs, wheels and robots see `_AXES`.
    """
    if kind == "drop":
        assert motion.time is not None
        return 1e3 * motion.time, -1e3 * motion.depth
    columns = {
        "turn": (motion.angle, motion.force),
        "roll": (motion.spin, motion.lift),
        "sink": (motion.spin, 1e3 * motion.depth),
        "walk": (motion.rate, motion.speed),
    }
    if kind in columns:
        x, y = columns[kind]
        assert x is not None
        assert y is not None
        return x, y
    assert motion.force is not None
    if kind == "drag":
        assert motion.speed is not None
        return motion.speed, motion.force
    return 1e3 * motion.depth, motion.force
