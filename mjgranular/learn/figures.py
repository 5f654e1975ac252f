"""Learning curves of runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mjgranular.picture.figures import PALETTE, figure_of_size, save_figure
from mjgranular.picture.plain import plain


def draw_curves(
    path: Path,
    curves: Mapping[str, Sequence[Sequence[tuple[float, ...]]]],
    *,
    baselines: Mapping[str, float] | None = None,
    title: str = "",
) -> None:
    """Mean return against steps: a line for each run, a colour for each name.

    Args:
        path: of the picture.
        curves: for each name the learning curves of its runs, rows of `run.CURVE_COLUMNS`.
        baselines: returns of agents that learned nothing, as level lines.
        title: above the figure.
    """
    figure, context = figure_of_size(6.4, 4.0)
    axis = figure.subplots()
    for (name, runs), colour in zip(curves.items(), PALETTE * 9, strict=False):
        for k, rows in enumerate(runs):
            steps, returns = (np.array([row[column] for row in rows]) for column in (0, 3))
            axis.plot(
                steps / 1e3, returns, color=colour, label=None if k else plain(name), alpha=0.85
            )
    for name, value in (baselines or {}).items():
        axis.axhline(value, color="#8a8a8a", linestyle="--", linewidth=1)
        axis.annotate(plain(name), (0.995, value), xycoords=("axes fraction", "data"), ha="right")
    axis.set_xlabel("steps [thousands]")
    axis.set_ylabel("mean return of episodes in training")
    if len(curves) > 1:
        axis.legend()
    figure.suptitle(plain(title))
    save_figure(figure, context, path)
