"""Tables of docs/policies.md: how the policies that come with the package do, and where.

    python docs/figures/policies.py                    # what is not in policies.json yet
    python docs/figures/policies.py ChainSwim --again

Each policy runs ten seeds on each ground: means are kept in `policies.json` beside this file. A row
is the mean over the policies of an environment, with the 95 % interval of Student's t distribution
over their means. "Law held" is the share of the steps at which the law of the sand was within its
limits.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular.envs import tasks
from mjgranular.envs.ids import name_of
from mjgranular.learn.evaluate import evaluate, mean_of
from mjgranular.learn.policies import Policy, load_policy, shipped_policies
from mjgranular.learn.run import Run

HALVED = "halved"
GROUNDS = {
    "its own": "",
    "its own, time steps half as long": HALVED,
    "its own, under the quasi-static law": "law=rft3d",
    "its own, with memory": "memory=true",
    "as drawn in training": "randomise={strength=[0.5,2.0],density=[0.5,2.0],slope=[-0.1,0.1]}",
    "half as strong": "randomise={strength=[0.5,0.5]}",
    "twice as strong": "randomise={strength=[2.0,2.0]}",
    "0.1 rad uphill": "randomise={slope=[0.1,0.1]}",
    "0.1 rad downhill": "randomise={slope=[-0.1,-0.1]}",
}
MEMORY = "its own, with memory"
BURIED = ("ChainSwim",)  # of what swims sand keeps no prints (docs/memory.md)
MEDIA = ("poppy_seed_loose", "poppy_seed_close", "quikrete_medium", "glass_beads")
SEEDS = 10
STORE = Path(__file__).with_suffix(".json")


def own_medium(environment: str) -> str:
    """What an environment's sand is."""
    return str(tasks[name_of(environment)].medium)


def is_asked(environment: str, ground: str) -> bool:
    """Whether a ground says something about an environment."""
    return ground != MEMORY or name_of(environment) not in BURIED


def measure(run: Run, name: str, variant: str) -> dict[str, float]:
    """Means over ten episodes of one policy on one ground."""
    policy = load_policy(name)
    arguments: dict[str, Any] = dict(run.settings.environment)
    arguments.pop("randomise", None)  # sand as measured, unless the variant draws it
    if variant == HALVED:
        arguments["frame_skip"] = 2 * tasks[name_of(run.environment)].frame_skip

    def agent(env: Any) -> Policy:
        if variant == HALVED:
            task = env.unwrapped.task
            task.model.opt.timestep /= 2
            task.__dict__.pop("dt", None)  # a task caches the duration of a step
            env.unwrapped.batch.expand("opt.timestep")[:] = task.model.opt.timestep
        return policy.checked(run.environment, env)

    score = evaluate(
        name,
        agent,
        run.environment,
        arguments,
        variant="" if variant == HALVED else variant,
        seeds=SEEDS,
    )
    figures = score.episodes.figures
    return {
        "return": float(np.mean(score.episodes.returns)),
        "steps": float(np.mean(score.episodes.lengths)),
        "speed": float(np.mean(figures["x_velocity"])),
        "held": float(np.mean(figures["sand/valid"])),
    }


def cell(values: list[float], digits: int) -> str:
    """Mean and half the interval."""
    if len(values) == 1:
        return f"{values[0]:.{digits}f}"
    mean = mean_of(values)
    return f"{mean.mean:.{digits}f} ± {(mean.high - mean.low) / 2:.{digits}f}"


def row(ground: str, found: list[dict[str, float]]) -> str:
    """A row of a table."""
    values = {key: [one[key] for one in found] for key in found[0]}
    cells = [
        ground,
        cell(values["return"], 0),
        f"{np.mean(values['steps']):.0f}",
        cell(values["speed"], 3),
        f"{100 * np.mean(values['held']):.0f} %",
    ]
    return f"| {' | '.join(cells)} |"


def table(environment: str, members: list[tuple[str, Run]], store: dict[str, Any]) -> None:
    """Prints the table of one environment."""
    own = own_medium(environment)
    grounds = GROUNDS | {f"`{name}`": f"medium={name}" for name in MEDIA if name != own}
    print(f"\n### {environment}, {len(members)} policies, {own}\n")
    print("| on | return | steps | speed [m/s] | law held |\n|---|---|---|---|---|")
    for ground, variant in grounds.items():
        if not is_asked(environment, ground):
            continue
        for name, run in members:
            if ground not in store.setdefault(name, {}):
                store[name][ground] = measure(run, name, variant)
                STORE.write_text(json.dumps(store, indent=1) + "\n", encoding="utf-8")
        print(row(ground, [store[name][ground] for name, _ in members]), flush=True)


def main() -> int:
    """Prints the tables of the environments that are named, or of all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--again", action="store_true", help="measure what has been measured")
    options = parser.parse_args()
    families: dict[str, list[tuple[str, Run]]] = defaultdict(list)
    for name, run in shipped_policies().items():
        if not options.names or name.partition("-v0/")[0] in options.names:
            families[run.environment].append((name, run))
    store = json.loads(STORE.read_text(encoding="utf-8")) if STORE.exists() else {}
    if options.again:
        for members in families.values():
            for name, _ in members:
                store.pop(name, None)
    for environment, members in families.items():
        table(environment, members, store)
    return 0


if __name__ == "__main__":
    sys.exit(main())
