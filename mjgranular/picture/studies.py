"""Figures of studies: outcomes against one varied field, or over two."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular.picture.figures import PALETTE, figure, panels

_BLUE = PALETTE[0]


@dataclass(frozen=True)
class Axis:
    """A column of the table, with its label and the unit of the figure in units of the table."""

    column: str
    label: str
    scale: float = 1.0


OUTCOMES: dict[str, tuple[Axis, Axis]] = {
    "impact": (
        Axis("stopping_time", "stopping time [ms]", 1e3),
        Axis("depth", "depth of T at the stop [mm]", 1e3),
    ),
    "drop": (
        Axis("greatest_depth", "greatest depth [mm]", 1e3),
        Axis("greatest_force", "greatest force of the sand on a body [N]"),
    ),
    "intrusion": (
        Axis("resistance", "resistance at the end of the path [N]"),
        Axis("work", "work done on the sand [J]"),
    ),
}
"""The two columns to draw for each experiment."""

_UNITS = {
    **dict.fromkeys(("speed", "tangential_speed", "velocity"), "m/s"),
    **dict.fromkeys(("height", "length", "diameter", "size", "depth", "start", "distance"), "m"),
    **dict.fromkeys(("surface_height", "memory"), "m"),
    **dict.fromkeys(("density", "medium.density"), "kg/m^3"),
    **dict.fromkeys(("timestep", "duration"), "s"),
    "angular_velocity": "rad/s",
}


def axis_of(column: str) -> Axis:
    """Return the axis of a varied field, by the name of its column."""
    name = column.removesuffix("_deg")
    unit = _UNITS.get(column) if name == column else "deg"
    words = name if name.startswith("law.") else name.replace("_", " ")
    return Axis(column, words if unit is None else f"{words} [{unit}]")


def draw_study(
    path: Path,
    columns: Mapping[str, Sequence[Any]],
    varied: Sequence[str],
    outcomes: Sequence[Axis],
    *,
    title: str = "",
) -> None:
    """Draw two outcomes against one varied field, or over a grid of two.

    `columns` are those of the table, with None for missing values; `varied` names one or two.
    """
    inputs = [axis_of(name) for name in varied]
    if len(inputs) == 1:
        labels = (one.label for one in outcomes)
        with panels(path, (6.4, 6.0), title, inputs[0].label, *labels) as axes:
            for axis, outcome in zip(axes, outcomes, strict=True):
                _draw_line(axis, columns, inputs[0], outcome)
        return
    with figure(path, 9.6, 4.2, title) as drawn:
        axes = drawn.subplots(1, 2, sharey=True)
        for axis, outcome in zip(axes, outcomes, strict=True):
            colors = _draw_over(axis, columns, inputs, outcome)
            drawn.colorbar(colors, ax=axis, label=outcome.label)
            axis.set_xlabel(inputs[0].label)
        axes[0].set_ylabel(inputs[1].label)


def _draw_line(axes: Any, columns: Mapping[str, Sequence[Any]], x: Axis, y: Axis) -> None:
    at, names = _places(columns[x.column])
    values = np.array(columns[y.column], float) * y.scale
    if names is None:
        order = np.argsort(at, kind="stable")
        axes.plot(at[order], values[order], color=_BLUE, marker="o", markersize=3.5)
    else:
        axes.scatter(at, values, s=12, color=_BLUE)
        axes.set_xticks(range(len(names)), names)


def _draw_over(
    axes: Any, columns: Mapping[str, Sequence[Any]], inputs: Sequence[Axis], outcome: Axis
) -> Any:
    """Draw colors over the plane of two fields; return the mappable for a color bar."""
    (x, x_names), (y, y_names) = (_places(columns[one.column]) for one in inputs)
    values = np.array(columns[outcome.column], float) * outcome.scale
    rows, across = np.unique(y), np.unique(x)
    cells = np.full((len(rows), len(across)), np.nan)
    cells[np.searchsorted(rows, y), np.searchsorted(across, x)] = values
    drawn = axes.pcolormesh(across, rows, cells, shading="nearest", cmap="viridis")
    axes.grid(visible=False)
    for names, put in ((x_names, axes.set_xticks), (y_names, axes.set_yticks)):
        if names is not None:
            put(range(len(names)), names)
    return drawn


def _places(values: Sequence[Any]) -> tuple[np.ndarray, list[str] | None]:
    """Return positions of values on an axis; for names their order, and the names."""
    if not any(isinstance(value, str) for value in values):
        return np.array(values, float), None
    names = list(dict.fromkeys(str(value) for value in values))
    return np.array([float(names.index(str(value))) for value in values]), names
