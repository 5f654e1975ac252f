"""Who acts: nobody, chance, a scripted gait, or a trained policy (`policies.Policy`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from mjgranular.errors import InputError

BASELINES = ("zero", "random", "gait")


class Agent(Protocol):
    """Chooses actions for several simulations."""

    def act(self, observations: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Actions, shape (n, m).

        Args:
            observations: shape (n, k).
            steps: since the episodes began, shape (n,).
        """
        ...


@dataclass(frozen=True)
class Zero:
    """Does nothing: the middle of the actions that there are, or the first of them.

    Attributes:
        space: of one action.
    """

    space: Any

    def act(self, observations: np.ndarray, steps: np.ndarray) -> np.ndarray:
        return np.array([self._idle()] * len(steps))

    def _idle(self) -> Any:
        if hasattr(self.space, "low"):
            middle = np.clip(0.0, self.space.low, self.space.high)
            return middle.astype(self.space.dtype)
        return 0


@dataclass(frozen=True)
class Random:
    """Draws every action evenly from those that there are.

    Attributes:
        space: of one action, seeded by whoever made it.
    """

    space: Any

    def act(self, observations: np.ndarray, steps: np.ndarray) -> np.ndarray:
        return np.array([self.space.sample() for _ in steps])


def make_baseline(name: str, env_id: str, env: Any, *, seed: int = 0) -> Agent:
    """An agent that needs no training.

    Args:
        name: zero, random or gait.
        env_id: of the environment.
        env: the environment itself, one or several.
        seed: of the random agent.

    Raises:
        InputError: there is no scripted gait for this environment.
    """
    space = getattr(env, "single_action_space", None) or env.action_space
    if name == "zero":
        return Zero(space)
    if name == "random":
        space.seed(seed)
        return Random(space)
    return make_gait(env_id, env, {})


def make_gait(env_id: str, env: Any, parameters: Mapping[str, float]) -> Agent:
    """The scripted gait of an environment.

    Raises:
        InputError: it has none; lists the environments that have.
    """
    raise InputError(f"there is no scripted gait for {env_id}")
