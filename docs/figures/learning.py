"""Learning curves of the policies that come with the package, one picture an environment."""

from __future__ import annotations

from collections import defaultdict

from matplotlib import pyplot as plt
from style import BLUE, GREEN, GREY, ORANGE, save

from mjgranular.learn.policies import shipped_policies
from mjgranular.learn.run import CURVE, read_curve

COLOURS = {"ppo": BLUE, "sac": ORANGE, "td3": GREEN}


def main() -> None:
    """Draws the figures and prints where each curve ends."""
    families = defaultdict(list)
    for name, run in shipped_policies().items():
        families[run.environment].append((name, run))
    for environment, members in families.items():
        figure, axis = plt.subplots(figsize=(5.6, 3.6))
        for name, run in members:
            rows = read_curve(run.path / CURVE)
            colour = COLOURS.get(run.settings.algorithm, GREY)
            axis.plot([row[0] / 1e3 for row in rows], [row[3] for row in rows], color=colour)
            print(f"{name}: {rows[-1][3]:.1f} after {rows[-1][0]:.0f} steps")
        axis.set(xlabel="steps [thousands]", ylabel="mean return of episodes in training")
        axis.set_title(environment)
        save(figure, f"learning_{environment.rpartition('/')[2].lower().replace('-', '_')}")


if __name__ == "__main__":
    main()
