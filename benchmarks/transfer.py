"""Does sand matter? Policies trained on a rigid floor, on one sand and on drawn sand, on all three.

    python benchmarks/transfer.py --out transfer
    python benchmarks/transfer.py --out transfer --robots Hopper --seeds 3 --jobs 4

Trains what is missing in the folder, one run on each core, evaluates ten episodes of each policy on
each ground, prints the tables of docs/policies.md and draws its figure. A score is the way ahead in
an episode, until a fall if there is one. Cells are interquartile means over the seeds with 95 %
intervals by the bootstrap, as in Agarwal et al., NeurIPS 2021. Settings are those of the package,
chosen on sand: they are not tuned for the floor.
"""

from __future__ import annotations

import importlib
import json
import math
import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from scipy import stats

from mjgranular._util import files
from mjgranular._util.checks import check_count
from mjgranular.envs import tasks
from mjgranular.learn.environments import find_spec
from mjgranular.learn.evaluate import evaluate
from mjgranular.learn.policies import load_policy
from mjgranular.learn.run import begin_run, open_run
from mjgranular.learn.settings import find_settings
from mjgranular.learn.train import train

FIGURES = Path(__file__).resolve().parents[1] / "docs" / "figures"
DRAWN = {"strength": [0.5, 2.0], "density": [0.5, 2.0], "slope": [-0.1, 0.1]}
GROUNDS: dict[str, dict[str, Any]] = {
    "rigid floor": {"rigid": math.inf},
    "sand": {},
    "drawn sand": {"randomise": DRAWN},
}
ROBOTS = ("Hexapod", "Hopper", "Walker2d")
EPISODES = 10


@dataclass(frozen=True)
class Options:
    """Train, evaluate, and show."""

    out: Path
    """Folder of the runs; those in it are not repeated, and unfinished ones are resumed."""
    robots: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ROBOTS
    """Tasks of the package that stand on the ground."""
    seeds: int = 5
    """Runs on each ground."""
    jobs: int = os.cpu_count() or 1
    """Runs at once."""


@dataclass(frozen=True)
class Job:
    """One training."""

    robot: str
    ground: str
    seed: int

    def folder(self, out: Path) -> Path:
        """Return the folder of its run."""
        return out / f"{self.robot}-{self.ground.replace(' ', '-')}-{self.seed}"


def score(out: Path, job: Job) -> dict[str, float]:
    """Train, unless that is done; return the ways ahead on each ground [m]."""
    environment, path = f"mjgranular/{job.robot}-v0", job.folder(out)
    if (path / "ways.json").exists():
        return json.loads((path / "ways.json").read_text(encoding="utf-8"))
    settings = find_settings(environment)
    settings = replace(settings, environment={**settings.environment, **GROUNDS[job.ground]})
    run = (
        open_run(path)
        if (path / "config.json").exists()
        else begin_run(path, environment, settings, seed=job.seed)
    )
    with run.locked():
        train(run)
    policy, dt, ways = load_policy(path), tasks[job.robot]().dt, {}
    for name, ground in GROUNDS.items():
        found = evaluate(name, lambda _: policy, environment, ground, seeds=EPISODES).episodes
        ways[name] = float(np.mean(found.figures["x_velocity"] * found.lengths) * dt)
    files.write_text(path / "ways.json", json.dumps(ways) + "\n")
    return ways


def take_a_core(cores: Any) -> None:
    """Keep a worker on one core: a batch waits for its slowest thread at each step."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {cores.get()})


def select(ways: dict[Job, dict[str, float]], robot: str, trained: str, ground: str) -> list[float]:
    """Return the ways of a robot's policies of one training on one ground, for each seed."""
    return [way[ground] for job, way in ways.items() if (job.robot, job.ground) == (robot, trained)]


def interquartile(values: Any, axis: int = -1) -> Any:
    """Return the mean of the middle half."""
    return stats.trim_mean(values, 0.25, axis=axis)


def interval(values: list[float]) -> tuple[float, float, float]:
    """Return the interquartile mean and its interval."""
    given = (np.array(values),)
    found = stats.bootstrap(given, interquartile, method="percentile", rng=0).confidence_interval
    return float(interquartile(given[0])), float(found.low), float(found.high)


def cell(values: list[float]) -> str:
    """Return an interquartile mean with its interval, for a table."""
    mean, low, high = interval(values)
    return f"{mean:.2f} ({low:.2f} to {high:.2f})"


def draw(robots: tuple[str, ...], ways: dict[Job, dict[str, float]]) -> None:
    """Draw the figure: a panel for each robot, a color for each ground of the training."""
    sys.path.insert(0, str(FIGURES))
    from matplotlib import pyplot as plt

    style: Any = importlib.import_module("style")
    colors = (style.GREY, style.ORANGE, style.BLUE)
    figure, axes = plt.subplots(1, len(robots), figsize=(4.6 * len(robots), 3.2), squeeze=False)
    for axis, robot in zip(axes.flat, robots, strict=True):
        for shift, (trained, color) in enumerate(zip(GROUNDS, colors, strict=True)):
            for place, ground in enumerate(GROUNDS):
                values = select(ways, robot, trained, ground)
                mean, low, high = interval(values)
                x = place + 0.25 * (shift - 1)
                label = f"trained on {trained}" if place == 0 else None
                axis.bar(x, mean, 0.22, color=color, label=label)
                axis.plot([x, x], [low, high], color="black", linewidth=1.2)
                axis.plot([x] * len(values), values, ".", color="black", markersize=3)
        axis.set_xticks(range(len(GROUNDS)), [f"on {ground}" for ground in GROUNDS])
        axis.set(title=robot, ylabel="way ahead in an episode [m]")
        axis.grid(axis="x", visible=False)
    axes.flat[0].legend(fontsize=8)
    style.save(figure, "transfer")


def main(options: Options) -> None:
    """Train and evaluate, print the tables, draw the figure."""
    check_count("seeds", options.seeds, least=2)  # an interval needs two
    for robot in options.robots:
        find_spec(f"mjgranular/{robot}-v0")
    context = multiprocessing.get_context("spawn")
    cores = context.Queue()
    for number in range(options.jobs):
        cores.put(number % (os.cpu_count() or 1))
    jobs = [Job(*each) for each in product(options.robots, GROUNDS, range(options.seeds))]
    jobs.sort(key=lambda job: job.seed)
    ways: dict[Job, dict[str, float]] = {}
    with ProcessPoolExecutor(options.jobs, context, take_a_core, (cores,)) as pool:
        started = {job: pool.submit(score, options.out, job) for job in jobs}
        for job, future in started.items():
            ways[job] = future.result()
            print(f"{job.robot}, {job.ground}, seed {job.seed}: {ways[job]}", flush=True)
    for robot in options.robots:
        print(f"\n| {robot} trained on | {' | '.join(GROUNDS)} |\n|---|---|---|---|")
        for trained in GROUNDS:
            cells = [cell(select(ways, robot, trained, ground)) for ground in GROUNDS]
            print(f"| {trained} | {' | '.join(cells)} |")
    draw(options.robots, ways)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
