"""Tables of docs/policies.md: how the policies that come with the package do, and where.

    python docs/figures/policies.py                    # all: a quarter of an hour on two cores
    python docs/figures/policies.py ChainSwim Hopper

Each policy runs ten seeds on each ground; a row is the mean over the policies of an environment,
with the 95 % interval of Student's t distribution over their means. "Law held" is the share of the
steps at which the law of the sand was within its limits.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from dataclasses import replace
from typing import Any

import numpy as np

from mjgranular import Rft2dLaw, Rft3dLaw, media
from mjgranular.envs import tasks
from mjgranular.learn.evaluate import Score, evaluate, mean_of
from mjgranular.learn.policies import load_policy, shipped_policies
from mjgranular.learn.run import Run

GROUNDS = {
    "its own": "",
    "its own, time steps half as long": "refine=2",
    "half as strong": "randomise={strength=[0.5,0.5]}",
    "twice as strong": "randomise={strength=[2.0,2.0]}",
    "0.1 rad uphill": "randomise={slope=[0.1,0.1]}",
    "0.1 rad downhill": "randomise={slope=[-0.1,-0.1]}",
}
# Of Agarwal et al. for fast motion, which the laws leave out unless it is asked for.
INERTIA = 1.1
MEDIA = ("poppy_seed_loose", "poppy_seed_close", "quikrete_medium", "glass_beads")
SEEDS = 10


def scores(run: Run, name: str, ground: str, more: dict[str, Any] | None = None) -> Score:
    """Ten episodes of one policy on one ground."""
    policy = load_policy(name)
    return evaluate(
        name,
        lambda env: policy.checked(run.environment, env),
        run.environment,
        {**run.settings.environment, **(more or {})},
        variant=ground,
        seeds=SEEDS,
    )


def row(ground: str, found: list[Score]) -> str:
    """A row of the table."""

    def cell(values: list[float]) -> str:
        if len(values) == 1:
            return f"{values[0]:.4g}"
        mean = mean_of(values)
        return f"{mean.mean:.4g} ± {(mean.high - mean.low) / 2:.2g}"

    def figure(name: str) -> list[float]:
        return [float(np.mean(score.episodes.figures[name])) for score in found]

    returns = [float(np.mean(score.episodes.returns)) for score in found]
    steps = np.mean([score.episodes.lengths.mean() for score in found])
    held = 100 * np.mean(figure("sand/valid"))
    cells = [ground, cell(returns), f"{steps:.0f}", cell(figure("x_velocity")), f"{held:.0f} %"]
    return f"| {' | '.join(cells)} |"


def table(environment: str, members: list[tuple[str, Run]]) -> None:
    """Prints the table of one environment."""
    own = str(tasks[environment.rpartition("/")[2].removesuffix("-v0")].medium)
    grounds = GROUNDS | {f"`{name}`": f"medium={name}" for name in MEDIA if name != own}
    print(f"\n### {environment}, {len(members)} policies, trained on {own}\n")
    print("| on | return | steps | speed [m/s] | law held |\n|---|---|---|---|---|")
    kind = Rft2dLaw if own.startswith("poppy") else Rft3dLaw
    inertial = {"law": replace(kind.from_medium(media[own]), inertia=INERTIA)}
    print(row(f"its own, and inertia {INERTIA}", [scores(r, n, "", inertial) for n, r in members]))
    for ground, variant in grounds.items():
        print(row(ground, [scores(run, name, variant) for name, run in members]), flush=True)


def main() -> int:
    """Prints the tables of the environments that are named, or of all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*")
    options = parser.parse_args()
    families: dict[str, list[tuple[str, Run]]] = defaultdict(list)
    for name, run in shipped_policies().items():
        if not options.names or name.partition("-v0/")[0] in options.names:
            families[run.environment].append((name, run))
    for environment, members in families.items():
        table(environment, members)
    return 0


if __name__ == "__main__":
    sys.exit(main())
