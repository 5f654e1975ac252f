"""The learning curve of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mjgranular.picture.figures import PALETTE, figure


def draw_curve(path: Path, curve: Sequence[tuple[float, ...]], title: str) -> None:
    """Draw mean return against steps.

    Args:
        path: path of the picture.
        curve: rows of `run.CURVE_COLUMNS`.
        title: title of the figure.
    """
    steps, returns = zip(*((row[0] / 1e3, row[3]) for row in curve), strict=True)
    with figure(path, 6.4, 4.0, title) as drawn:
        axis = drawn.subplots()
        axis.plot(steps, returns, color=PALETTE[0], alpha=0.85)
        axis.set_xlabel("steps [thousands]")
        axis.set_ylabel("mean return of episodes in training")
