"""Step environments with random actions on random sand: everything stays finite, without warnings.

The numbers of the cases go through the environments in turn.
"""

from __future__ import annotations

from argparse import Namespace
from dataclasses import dataclass

import mujoco
import numpy as np
from attacks.cases import Result

from mjgranular.envs import SandRanges, SandVectorEnv, tasks

RANGES = SandRanges(strength=(0.5, 2.0), density=(0.5, 2.0), slope=(-0.15, 0.15))
NUM_ENVS = 16


@dataclass
class EnvironmentCase:
    """An environment and the seed of its actions."""

    name: str
    seed: int
    steps: int

    def describe(self) -> str:
        """Return the case in a line."""
        return f"{self.name}, {NUM_ENVS} at once, seed {self.seed}, {self.steps} steps each"


def draw(seed: int, number: int, options: Namespace) -> EnvironmentCase:
    """Choose an environment."""
    names = list(tasks)
    return EnvironmentCase(names[number % len(names)], 100_000 * seed + number, options.steps)


def run(case: EnvironmentCase) -> Result:
    """Step a batch of one environment."""
    result = Result()
    episode = tasks[case.name].episode
    batch = SandVectorEnv(case.name, NUM_ENVS, max_episode_steps=episode, randomise=RANGES)
    batch.reset(seed=case.seed)
    batch.action_space.seed(case.seed)
    for step in range(case.steps):
        observations, rewards, *_ = batch.step(batch.action_space.sample())
        result.counts.update(("finite", "no warning"))
        if not (np.isfinite(observations).all() and np.isfinite(rewards).all()):
            result.fail("finite", f"step {step}: an observation or a reward is not finite")
        warned = batch.batch.warning[:, :, 1].any(axis=0).nonzero()[0]
        if warned.size:
            names = [mujoco.mjtWarning(int(kind)).name for kind in warned]
            result.fail("no warning", f"step {step}: {', '.join(names)}")
    batch.close()
    return result
