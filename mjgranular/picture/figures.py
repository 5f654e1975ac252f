"""Figures of runs, in the style of the paper; of studies, and of fits."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular._util.checks import require
from mjgranular._util.files import atomic_write
from mjgranular.calibrate import FitResult
from mjgranular.errors import one_line
from mjgranular.experiment.trajectory import Trajectory

_BLUE, _OCHRE, _GREY, _RED = "#20567f", "#b8761c", "#8a8a8a", "#b03a2e"
_MOST_CURVES, _MOST_OF_A_FIT = 8, 24
_STYLE = {
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "figure.constrained_layout.use": True,
    "font.size": 10,
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "savefig.dpi": 150,
}


@contextmanager
def figure(path: Path, width: float, height: float, title: str) -> Iterator[Any]:
    """Yield an empty figure of a size in inches, made without pyplot; write it at the end."""
    matplotlib = require("matplotlib", extra="figures", purpose="Drawing figures")
    require("matplotlib.figure", extra="figures", purpose="Drawing figures")
    with matplotlib.rc_context(_STYLE):
        drawn = matplotlib.figure.Figure(figsize=(width, height))
        drawn.suptitle(plain(title))
        yield drawn
        with atomic_write(path) as part:
            drawn.savefig(part)


def plain(text: str) -> str:
    """Return a string that matplotlib draws literally: no formula between dollars, no omission.

    Labels that begin with an underscore would be missing from a legend.
    """
    lines = "\n".join(map(one_line, text.split("\n"))).replace("$", r"\$")
    return f" {lines}" if lines.startswith("_") else lines


@contextmanager
def panels(
    path: Path, size: tuple[float, float], title: str, below: str, *beside: str
) -> Iterator[Any]:
    """Yield axes one above the other, with a label below all and one beside each."""
    with figure(path, *size, title) as drawn:
        axes = drawn.subplots(len(beside), 1, sharex=True, squeeze=False)[:, 0]
        for axis, label in zip(axes, beside, strict=True):
            axis.set_ylabel(label)
        axes[-1].set_xlabel(below)
        yield axes


def draw_motion(path: Path, trajectory: Trajectory, *, stop: float | None, title: str = "") -> None:
    """Draw depth and velocity of T and the link's angle against time, as in Figs. 2-4 and 6-8.

    A line marks the time from release to the stop [s], if there was one.
    """
    labels = "depth of T, $y_T$ [mm]", "velocity of T, $v_{Ty}$ [m/s]", "angle, $q$ [deg]"
    with panels(path, (6.4, 7.2), title, "time since release [ms]", *labels) as axes:
        t = trajectory.t * 1e3
        axes[0].plot(t, trajectory.y_T * 1e3, color=_BLUE)
        axes[0].invert_yaxis()
        axes[1].plot(t, trajectory.v_Ty, color=_BLUE)
        axes[1].axhline(0, color=_GREY, linewidth=0.8)
        axes[2].plot(t, np.degrees(trajectory.q), color=_BLUE)
        _mark_stop(axes, stop)


def draw_forces(path: Path, trajectory: Trajectory, *, stop: float | None, title: str = "") -> None:
    """Draw force, moment and power of the sand, and the link's energy, as `draw_motion` does."""
    labels = "force [N]", "moment about C [N m]", "power of the sand [W]", "energy of the link [J]"
    with panels(path, (6.4, 8.2), title, "time since release [ms]", *labels) as axes:
        t = trajectory.t * 1e3
        axes[0].plot(t, -trajectory.F_y, color=_BLUE, label="up, $-F_y$")
        axes[0].plot(t, trajectory.F_x, color=_OCHRE, label="along the surface, $F_x$")
        axes[0].legend(loc="upper right", bbox_to_anchor=(0.94, 1.0))  # left of the stop
        for axis, values in zip(
            axes[1:], (trajectory.M, trajectory.power, trajectory.energy), strict=True
        ):
            axis.plot(t, values, color=_BLUE)
        _mark_stop(axes, stop)


def _mark_stop(axes: Sequence[Any], stop: float | None) -> None:
    if stop is None:
        return
    for axis in axes:
        axis.axvline(stop * 1e3, color=_RED, linewidth=1, linestyle="--")
    axes[0].annotate(
        f"T stops at {stop * 1e3:.3f} ms",
        (stop * 1e3, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(0, 3),
        textcoords="offset points",
        ha="right",
        va="bottom",
        color=_RED,
    )


def draw_drop(
    path: Path,
    t: np.ndarray,
    names: Sequence[str],
    depth: np.ndarray,
    force: np.ndarray,
    power: np.ndarray,
    *,
    title: str = "",
) -> None:
    """Draw depth, force and power of the bodies that met the sand, against time.

    If there are many, those with the largest forces are drawn.
    """
    met = [k for k in range(len(names)) if depth[:, k].max() > 0] or list(range(len(names)))
    greatest = np.linalg.norm(force, axis=2).max(axis=0)
    strongest = sorted(met, key=lambda k: -greatest[k])[:_MOST_CURVES]
    if len(met) > _MOST_CURVES:
        title += f"\n(the {_MOST_CURVES} bodies with the largest forces, of {len(met)} in the sand)"
    labels = "greatest depth [mm]", "force of the sand [N]", "power of the sand [W]"
    with panels(path, (6.8, 7.2), title, "time [s]", *labels) as axes:
        for k in sorted(strongest):
            axes[0].plot(t, depth[:, k] * 1e3, label=plain(names[k]), linewidth=1.2)
            axes[1].plot(t, np.linalg.norm(force[:, k], axis=1), linewidth=1.0)
            axes[2].plot(t, power[:, k], linewidth=1.0)
        axes[0].axhline(0, color=_OCHRE, linewidth=1.2)
        axes[0].invert_yaxis()
        axes[0].legend(fontsize=8, ncols=2)


def draw_intrusion(
    path: Path, depth: np.ndarray, force: np.ndarray, moment: np.ndarray, *, title: str = ""
) -> None:
    """Draw force, as in `IntrusionResult`, and moment against depth."""
    beside = "force of the sand [N]", "moment about the center [N m]"
    with panels(path, (6.4, 6.4), title, "depth of the deepest point [mm]", *beside) as axes:
        labels = ("against the motion", "lift, up across the motion", "sideways")
        for k, (label, color) in enumerate(zip(labels, (_BLUE, _OCHRE, _GREY), strict=True)):
            axes[0].plot(depth * 1e3, force[:, k], color=color, label=label)
        axes[0].legend()
        for k, (label, color) in enumerate(zip("xyz", (_OCHRE, _BLUE, _GREY), strict=True)):
            axes[1].plot(depth * 1e3, moment[:, k], color=color, label=f"about {label}")
        if np.abs(moment).max() < 1e-9 * max(np.abs(force).max(), 1e-300):
            axes[1].set_ylim(-1, 1)  # only rounding errors
        axes[1].legend()


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


_COLUMNS = {  # factors of SI units, and labels
    "time": (1e3, "time since the touch [ms]"),
    "depth": (1e3, "depth [mm]"),
    "speed": (1.0, "speed [m/s]"),
    "angle": (1.0, "angle [deg]"),
    "spin": (1.0, "spin [rad/s]"),
    "rate": (1.0, "rate [Hz]"),
    "pitch": (1.0, "pitch [deg]"),
    "force": (1.0, "force [N]"),
    "side": (1.0, "side force [N]"),
    "lift": (1.0, "lift [N]"),
}


def draw_fit(path: Path, result: FitResult) -> None:
    """Draw every run's curves: measurements as dots, predictions of the fitted law as lines."""
    curves = [(name, curve) for name, found in result.curves.items() for curve in found]
    del curves[_MOST_OF_A_FIT:]
    columns = min(3, len(curves))
    rows = math.ceil(len(curves) / columns)
    size = max(6.4, 3.6 * columns), 0.9 + 2.7 * rows
    constants = ", ".join(f"{name} = {value:.3g}" for name, value in result.values.items())
    title = f"{result.material.law.name}: {constants}"
    with figure(path, *size, title) as drawn:
        grid = drawn.subplots(rows, columns, squeeze=False).ravel()
        for axes, (name, curve) in zip(grid, curves, strict=False):
            along, below = _COLUMNS[curve.axis]
            factor, beside = _COLUMNS[curve.quantity]
            color, label = (_OCHRE, "predicted") if curve.held_out else (_BLUE, "fitted")
            places, values = along * curve.places, factor * curve.measured
            axes.plot(places, values, ".", color=_GREY, markersize=3, label="measured")
            axes.plot(places, factor * curve.predicted, color=color, label=label)
            axes.set(xlabel=below, ylabel=beside, title=plain(name))
            if curve.quantity == "depth":
                axes.invert_yaxis()
            axes.legend(loc="best", fontsize="small")
        for axes in grid[len(curves) :]:
            axes.set_visible(False)
