"""Cost of memory: steps of environments' models on sand with and without it, in turns.

    python benchmarks/memory.py
    python benchmarks/memory.py --names Hexapod --cells 0.01 0.005 --turns 20
    python benchmarks/memory.py --names Ant --rest 25

A gait if the environment has one (a tripod for the hexapod), else random actions. Each turn runs a
piece of an episode in each of the cases; figures are CPU time, the minimum over a piece's turns,
summed over all pieces, so that other load on the machine does not count.

With `--rest` nothing acts: each turn is another start, and is timed once that many seconds have
passed. The minimum over ten pieces counts.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from typing import Annotated, Any

import mujoco
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from mjgranular.envs import tasks
from mjgranular.envs.gaits import tripod


@dataclass(frozen=True)
class Options:
    """Cost of memory."""

    names: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...")] = ("Hexapod", "Hopper")
    """Environments."""
    cells: Annotated[tuple[float, ...], tyro.conf.arg(metavar="M...")] = (0.01,)
    """Sides of cells [m]."""
    turns: int = 8
    """Turns of each case."""
    seconds: float = 6.0
    """Of simulated time in a turn."""
    rest: float = 0.0
    """Seconds without actions before a turn, which then has none; 0 for robots that move."""


class Case:
    """A simulation with recorded actions."""

    def __init__(self, name: str, seconds: float, **options: Any) -> None:
        self.task = tasks[name](**options)
        self.model = self.task.model
        self.data = mujoco.MjData(self.model)
        self.state = self.task.state_of(self.data)
        self.skip = self.task.frame_skip
        rng, count = np.random.default_rng(0), round(seconds / self.task.dt)
        size = self.model.nu
        self.actions = rng.uniform(-1, 1, (count, size))
        if name == "Hexapod":
            self.actions = np.array([tripod(k * self.task.dt, size) for k in range(count)])

    def turn(self, piece: int = 25) -> np.ndarray:
        """Run the actions; return times of pieces of `piece` actions [s per step of the model]."""
        times, random = [], np.random.default_rng(1)
        model, data, task = self.model, self.data, self.task
        self._begin(random)
        for first in range(0, len(self.actions), piece):
            ctrl = task.act(self.actions[first : first + piece], self.state)
            began = time.process_time()
            for action in ctrl:
                data.ctrl[:] = action
                mujoco.mj_step(model, data, nstep=self.skip)
            times.append((time.process_time() - began) / (self.skip * len(ctrl)))
            self.state.found.clear()
            if task.terminated(self.state)[0]:
                self._begin(random)
        return np.array(times)

    def settle(self, seed: int, seconds: float) -> None:
        """Begin from another start, and step without actions."""
        self._begin(np.random.default_rng(seed))
        self.step(round(seconds / self.model.opt.timestep))

    def step(self, count: int) -> float:
        """Step without actions; return the time that it takes [s per step of the model]."""
        began = time.process_time()
        self.data.ctrl[:] = 0.0
        mujoco.mj_step(self.model, self.data, nstep=count)
        return (time.process_time() - began) / count

    def _begin(self, random: np.random.Generator) -> None:
        start = self.task.begin(random, None)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = start.qpos, start.qvel


def in_motion(cases: list[Case], options: Options) -> list[np.ndarray]:
    """Return the minima over all turns, for each case and piece of its actions."""
    least: list[Any] = [np.inf] * len(cases)
    for _ in range(options.turns):
        for number, case in enumerate(cases):
            least[number] = np.minimum(least[number], case.turn())
    return least


def at_rest(cases: list[Case], options: Options, pieces: int = 10) -> list[np.ndarray]:
    """Return the minima over pieces of a turn, for each case and turn."""
    least = []
    for seed in range(options.turns):
        for case in cases:
            case.settle(seed, options.rest)
        times = [[case.step(100) for case in cases] for _ in range(pieces)]
        least.append(np.min(times, axis=0))
    return list(np.transpose(least))


def main() -> None:
    """Print a table."""
    options = tyro.cli(Options)
    table = Table("environment", "cells [mm]", "without [µs]", "with [µs]", "ratio")
    for name in options.names:
        cases = [Case(name, options.seconds)]
        cases += [Case(name, options.seconds, memory=cell) for cell in options.cells]
        least = at_rest(cases, options) if options.rest else in_motion(cases, options)
        plain, *others = (1e6 * float(np.mean(times)) for times in least)
        for cell, cost in zip(options.cells, others, strict=True):
            ratio = f"{cost / plain:.2f}"
            table.add_row(name, f"{1e3 * cell:g}", f"{plain:.1f}", f"{cost:.1f}", ratio)
    console = Console()
    console.print(table)
    console.print(f"{os.cpu_count()} cores; steps of the model; least of {options.turns} turns")


if __name__ == "__main__":
    main()
