"""Learning curves of the policies that come with the package.

python docs/figures/learning.py
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from matplotlib import pyplot as plt
from style import BLUE, GREEN, GREY, ORANGE, save

from mjgranular.learn.policies import shipped_policies
from mjgranular.learn.run import CURVE, Run, mean_returns, read_curve

COLOURS = {"ppo": BLUE, "sac": ORANGE, "td3": GREEN}
COLUMNS = 3
LAST_PART = 0.8  # of a learning curve, from here on


def last_return(run: Run) -> float:
    """Return the mean return over the last fifth of a run's learning curve."""
    rows = read_curve(run.path / CURVE)
    rows = [row for row in rows if row[0] >= LAST_PART * rows[-1][0] and row[2] > 0]
    return float(np.average([row[3] for row in rows], weights=[row[2] for row in rows]))


def main() -> None:
    """Draws the figure and prints where each curve ends."""
    families: dict[str, list[tuple[str, Run]]] = defaultdict(list)
    for name, run in shipped_policies().items():
        families[run.environment].append((name, run))
    rows = -(-len(families) // COLUMNS)
    figure, grid = plt.subplots(rows, COLUMNS, figsize=(9.6, 2.7 * rows), squeeze=False)
    for axis in grid.flat[len(families) :]:
        axis.set_visible(False)
    for axis, (environment, members) in zip(grid.flat, families.items(), strict=False):
        for name, run in members:
            curve = read_curve(run.path / CURVE)
            colour = COLOURS.get(run.settings.algorithm, GREY)
            steps, returns = np.array(mean_returns(curve, run.settings.num_envs)).T
            axis.plot(steps / 1e3, returns, color=colour, linewidth=1.0)
            minutes, end = curve[-1][1] / 60, curve[-1][0]
            print(f"{name}: {last_return(run):.0f} after {end:.0f} steps, {minutes:.0f} min")
        axis.set(title=environment, xlabel="steps [thousands]")
    for axis in grid[:, 0]:
        axis.set_ylabel("mean return in training")
    save(figure, "learning")


if __name__ == "__main__":
    main()
