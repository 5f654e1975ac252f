"""Environments: steps per second on sand, on Gymnasium's rigid floor, in batches, one by one.

    python benchmarks/environments.py                        # all, some minutes
    python benchmarks/environments.py --names Hopper Ant --repeats 7 --save figures.json

Random actions; cases take turns, so that a busy machine slows all of them; medians. A ratio above 1
means that sand, or the batch, is faster.
"""

from __future__ import annotations

import json
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from stable_baselines3.common.env_util import make_vec_env as make_dummy

import mjgranular.envs
from mjgranular import InputError
from mjgranular.envs.gym_robots import Robot
from mjgranular.envs.ids import id_of
from mjgranular.envs.sb3 import make_vec_env


@dataclass(frozen=True)
class Options:
    """Steps a second of environments."""

    names: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...")] = ()
    """Environments; all if none is given."""
    num_envs: int = 64
    """Simulations in a batch."""
    repeats: int = 5
    """Turns of each case."""
    seconds: float = 0.5
    """Duration of a turn, about."""
    save: Path | None = None
    """A file for the figures, JSON."""


def single(env: gym.Env) -> Callable[[int], None]:
    """Return a turn of an environment with one simulation."""
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(512)]

    def turn(steps: int) -> None:
        for step in range(steps):
            _, _, terminated, truncated, _ = env.step(actions[step % len(actions)])
            if terminated or truncated:
                env.reset()

    return turn


def many(vec: Any, count: int) -> Callable[[int], None]:
    """Return a turn of a Stable-Baselines3 vector environment, of `count` steps together."""
    vec.reset()
    vec.action_space.seed(0)
    actions = [np.array([vec.action_space.sample() for _ in range(count)]) for _ in range(32)]

    def turn(steps: int) -> None:
        for step in range(-(-steps // count)):
            vec.step(actions[step % len(actions)])

    return turn


def measure(cases: dict[str, Callable[[int], None]], options: Options) -> dict[str, float]:
    """Return steps per second of each case, the median of its turns."""
    rates: dict[str, list[float]] = {name: [] for name in cases}
    steps = {}
    for name, turn in cases.items():  # warm-up, and number of steps of a turn
        turn(options.num_envs)
        began = time.perf_counter()
        turn(2 * options.num_envs)
        rate = 2 * options.num_envs / (time.perf_counter() - began)
        whole = -(-int(rate * options.seconds) // options.num_envs)
        steps[name] = max(whole, 1) * options.num_envs
    for _ in range(options.repeats):
        for name, turn in cases.items():
            began = time.perf_counter()
            turn(steps[name])
            rates[name].append(steps[name] / (time.perf_counter() - began))
    return {name: statistics.median(values) for name, values in rates.items()}


def main() -> None:
    """Print a table."""
    options = tyro.cli(Options)
    figures = {}
    names = options.names or tuple(mjgranular.envs.tasks)
    heads = ("single", "rigid floor", "of rigid", "DummyVecEnv", "batch", "of DummyVecEnv")
    table = Table("environment", *heads, title=f"steps/s, batches of {options.num_envs}")
    for name in names:
        try:
            env = gym.make(id_of(name))
        except InputError as error:  # a robot that is not on this machine
            print(f"{name} is left out: {error}")
            continue
        cases = {
            "single": single(env),
            "dummy": many(make_dummy(id_of(name), options.num_envs), options.num_envs),
            "batch": many(make_vec_env(id_of(name), options.num_envs), options.num_envs),
        }
        if issubclass(mjgranular.envs.tasks[name], Robot):
            cases["rigid"] = single(gym.make(f"{name}-v5"))
        found = figures[name] = measure(cases, options)
        rigid = found.get("rigid")
        table.add_row(
            name,
            f"{found['single']:.0f}",
            f"{rigid:.0f}" if rigid else "",
            f"{found['single'] / rigid:.2f}" if rigid else "",
            f"{found['dummy']:.0f}",
            f"{found['batch']:.0f}",
            f"{found['batch'] / found['dummy']:.2f}",
        )
    Console().print(table)
    print(f"{os.cpu_count()} cores; medians of {options.repeats} turns of {options.seconds} s")
    if options.save is not None:
        options.save.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
