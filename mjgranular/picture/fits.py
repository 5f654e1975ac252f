"""Figure of a fit: every run's curve, measured and predicted by the fitted law."""

import math
from pathlib import Path

from mjgranular.calibrate import FitResult
from mjgranular.picture.figures import PALETTE, figure, plain

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
_MOST = 24  # curves in a figure


def draw_fit(path: Path, result: FitResult) -> None:
    """Draw every run's curves: measurements as dots, predictions of the fitted law as lines."""
    curves = [(name, curve) for name, found in result.curves.items() for curve in found][:_MOST]
    columns = min(3, len(curves))
    rows = math.ceil(len(curves) / columns)
    size = max(6.4, 3.6 * columns), 0.9 + 2.7 * rows
    measured, fitted, predicted = "#8a8a8a", *PALETTE[:2]
    constants = ", ".join(f"{name} = {value:.3g}" for name, value in result.values.items())
    title = f"{result.material.law.name}: {constants}"
    with figure(path, *size, title) as drawn:
        grid = drawn.subplots(rows, columns, squeeze=False).ravel()
        for axes, (name, curve) in zip(grid, curves, strict=False):
            along, below = _COLUMNS[curve.axis]
            factor, beside = _COLUMNS[curve.quantity]
            color, label = (predicted, "predicted") if curve.held_out else (fitted, "fitted")
            places, values = along * curve.places, factor * curve.measured
            axes.plot(places, values, ".", color=measured, markersize=3, label="measured")
            axes.plot(places, factor * curve.predicted, color=color, label=label)
            axes.set(xlabel=below, ylabel=beside, title=plain(name))
            if curve.quantity == "depth":
                axes.invert_yaxis()
            axes.legend(loc="best", fontsize="small")
        for axes in grid[len(curves) :]:
            axes.set_visible(False)
