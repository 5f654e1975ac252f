"""The six drops of the paper: depth of T against time, and the stops that the paper prints."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace

from matplotlib import pyplot as plt
from style import BLUE, GREEN, ORANGE, save

from mjgranular.experiment import Impact, run_impact

TIMESTEP = 1e-6
PAPER = Path(__file__).parents[2] / "tests/data/paper.json"


def main() -> None:
    """Draws the figure and prints the table of the page on the link law."""
    cases = [SimpleNamespace(**case) for case in json.loads(PAPER.read_text())["cases"]]
    common = {"law": "link", "timestep": TIMESTEP}
    results = [
        (case, run_impact(Impact(speed=case.speed, angle=math.radians(case.angle), **common)))
        for case in cases
    ]
    for case, result in results:
        assert result.stop is not None
        time, depth = result.stop.time, result.stop.depth
        print(
            f"| {case.speed:g} | {case.angle:g} | {case.time:.6f} | {time:.6f} "
            f"| {time / case.time - 1:+.1e} | {case.depth:.6f} | {depth:.6f} "
            f"| {depth / case.depth - 1:+.1e} |"
        )

    figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.6), sharey=True)
    panels = (
        (axes[0], "three speeds, 45°", [r for r in results if r[0].figure in (2, 3, 4)]),
        (axes[1], "three angles, 2 m/s", [r for r in results if r[0].figure in (6, 7, 8)]),
    )
    for axis, title, drops in panels:
        for (case, result), colour in zip(drops, (BLUE, ORANGE, GREEN), strict=True):
            path = result.trajectory
            label = f"{case.speed:g} m/s" if axis is axes[0] else f"{case.angle:g}°"
            axis.plot(1e3 * path.t, 1e3 * path.y_T, color=colour, label=label)
            axis.plot(1e3 * case.time, 1e3 * case.depth, "x", color="black", ms=7, mew=1.5)
        axis.plot([], [], "kx", ms=7, mew=1.5, label="stop, as printed")
        axis.set(title=title, xlabel="time since touch-down $t$ [ms]")
        axis.legend(loc="upper right", fontsize=9)
    axes[0].set(ylabel="depth of the end $T$, $y_T$ [mm]", ylim=(40, 0))
    save(figure, "paper_cases")


if __name__ == "__main__":
    main()
