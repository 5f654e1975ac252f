"""Figures of learning: curves of runs, returns of policies on other grounds than their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mjgranular.picture.figures import PALETTE, figure_of_size, save_figure
from mjgranular.picture.plain import plain

if TYPE_CHECKING:
    from mjgranular.learn.compare import Cell


_FEW = 6  # values that are drawn one by one


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


def draw_comparison(path: Path, cells: Sequence[Cell], *, title: str = "") -> None:
    """Bars of the mean return on each ground, one for each ground trained on.

    On them what they are means of, a dot each; where these are many, the interval.
    """
    grounds = list(dict.fromkeys(cell.on for cell in cells))
    figure, context = figure_of_size(6.4, 3.8)
    axis = figure.subplots()
    width = 0.8 / len(grounds)
    for k, (trained_on, colour) in enumerate(zip(grounds, PALETTE, strict=False)):
        row = [cell.returned for cell in cells if cell.trained_on == trained_on]
        places = np.arange(len(grounds)) + (k - (len(grounds) - 1) / 2) * width
        few = len(row[0].values) <= _FEW
        axis.bar(
            places,
            [mean.mean for mean in row],
            width,
            yerr=None if few else [(mean.high - mean.low) / 2 for mean in row],
            color=colour,
            label=f"trained on {trained_on}",
            capsize=3,
        )
        if few:
            dots = [(place, v) for place, m in zip(places, row, strict=True) for v in m.values]
            axis.scatter(*zip(*dots, strict=True), 25, "white", edgecolors="black", zorder=3)
    axis.set_xticks(np.arange(len(grounds)), [f"on {ground}" for ground in grounds])
    axis.set_ylabel("mean return")
    figure.legend(loc="outside lower center", ncols=len(grounds))
    figure.suptitle(plain(title))
    save_figure(figure, context, path)
