"""Environments of one worker, normalised as `VecNormalize` does it, with statistics of many.

Observations are scaled by their running mean and variance, rewards by the variance of the
discounted return. Each worker goes on from the statistics of all, adds what it sees, and hands over
what is new in them; whoever collects that joins it by the formulas for two samples.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorWrapper
from stable_baselines3.common.running_mean_std import RunningMeanStd


class Statistics(NamedTuple):
    """Running means and variances.

    Attributes:
        observations: of each number of an observation.
        returns: of discounted returns.
    """

    observations: RunningMeanStd
    returns: RunningMeanStd

    @classmethod
    def none(cls, shape: tuple[int, ...]) -> Statistics:
        """Of nothing that was seen yet; `shape` is that of an observation."""
        return cls(RunningMeanStd(0.0, shape), RunningMeanStd(0.0, ()))

    def join(self, others: Statistics) -> None:
        """Adds what others have seen."""
        for mine, theirs in zip(self, others, strict=True):
            if theirs.count > 0:
                mine.combine(theirs)


class Scaling(NamedTuple):
    """Ways in which environments are normalised.

    Attributes:
        observations: whether they are.
        rewards: whether they are.
        gamma: discount of the return.
        clip: greatest size of a normalised number.
        epsilon: added to variances.
    """

    observations: bool
    rewards: bool
    gamma: float
    clip: float
    epsilon: float


class ScaledEnvs(VectorWrapper):
    """Environments that are normalised, and count their episodes.

    Args:
        env: begins new episodes in a step of their own, `AutoresetMode.NEXT_STEP`.
        scaling: how they are normalised.
    """

    def __init__(self, env: Any, scaling: Scaling) -> None:
        super().__init__(env)
        self._scaling = scaling
        self._shape = env.single_observation_space.shape
        self.known = Statistics.none(self._shape)
        """From which observations and rewards are scaled."""
        self._new = Statistics.none(self._shape)
        self._ended: list[tuple[float, int]] = []
        self._begin()

    def take(self) -> tuple[Statistics, list[tuple[float, int]]]:
        """What was seen since the last time: statistics, and return and length of episodes."""
        taken = self._new, self._ended
        self._new, self._ended = Statistics.none(self._shape), []
        return taken

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[np.ndarray, dict[str, Any]]:
        observations, _ = self.env.reset(seed=seed, options=options)
        self._begin()
        return self._observed(observations), {}

    def step(
        self, actions: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        stepped = ~self._over  # the others only begin anew
        observations, rewards, ended, cut, _ = self.env.step(actions)
        self._returns[stepped] += rewards[stepped]
        self._lengths += stepped
        scaled = self._rewarded(rewards, stepped)
        self._over = ended | cut
        for number in np.flatnonzero(self._over):
            self._ended.append((float(self._returns[number]), int(self._lengths[number])))
        for array in (self._returns, self._lengths, self._discounted):
            array[self._over] = 0
        return self._observed(observations), scaled, ended, cut, {}

    def _begin(self) -> None:
        self._returns, self._discounted = np.zeros(self.num_envs), np.zeros(self.num_envs)
        self._lengths = np.zeros(self.num_envs, int)
        self._over = np.zeros(self.num_envs, bool)

    def _observed(self, observations: np.ndarray) -> np.ndarray:
        if not self._scaling.observations:
            return observations
        self._see(0, observations)
        known, how = self.known.observations, self._scaling
        scaled = (observations - known.mean) / np.sqrt(known.var + how.epsilon)
        return np.clip(scaled, -how.clip, how.clip).astype(np.float32)

    def _rewarded(self, rewards: np.ndarray, stepped: np.ndarray) -> np.ndarray:
        how = self._scaling
        if not how.rewards:
            return rewards
        self._discounted = self._discounted * how.gamma + np.where(stepped, rewards, 0.0)
        if stepped.any():
            self._see(1, self._discounted[stepped])
        scaled = rewards / np.sqrt(self.known.returns.var + how.epsilon)
        return np.clip(scaled, -how.clip, how.clip)

    def _see(self, which: int, values: np.ndarray) -> None:
        self.known[which].update(values)
        self._new[which].update(values)
