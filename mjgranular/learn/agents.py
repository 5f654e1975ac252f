"""Agents that need no training: zero, random, a scripted gait. `policies.Policy` is another."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from mjgranular.errors import InputError

BASELINES = ("zero", "random", "gait")


class Agent(Protocol):
    """Chooses actions for several simulations."""

    def act(self, observations: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Return actions, shape (n, m).

        Args:
            observations: shape (n, k).
            steps: number of steps since the episodes began, shape (n,).
        """
        ...


@dataclass(frozen=True)
class Zero:
    """Acts with the middle of the action space, or the first of discrete actions.

    Attributes:
        space: space of one action.
    """

    space: Any

    def act(self, observations: np.ndarray, steps: np.ndarray) -> np.ndarray:
        action: Any = 0
        if hasattr(self.space, "low"):
            action = np.clip(0.0, self.space.low, self.space.high).astype(self.space.dtype)
        return np.array([action] * len(steps))


@dataclass(frozen=True)
class Random:
    """Draws every action uniformly from the action space.

    Attributes:
        space: space of one action, seeded by the caller.
    """

    space: Any

    def act(self, observations: np.ndarray, steps: np.ndarray) -> np.ndarray:
        return np.array([self.space.sample() for _ in steps])


@dataclass(frozen=True)
class Gaits:
    """Acts as a function of time only.

    Attributes:
        scripts: functions from times to actions: one for all simulations, or one for each.
        dt: duration of a step [s].
    """

    scripts: tuple[Callable[[float], np.ndarray], ...]
    dt: float

    def act(self, observations: np.ndarray, steps: np.ndarray) -> np.ndarray:
        scripts = self.scripts * (len(steps) if len(self.scripts) == 1 else 1)
        times = steps * self.dt
        return np.array([script(float(t)) for script, t in zip(scripts, times, strict=True)])


def make_baseline(
    name: str, env_id: str, env: Any, *, seed: int = 0, gait: Mapping[str, float] | None = None
) -> Agent:
    """Return an agent that needs no training.

    Args:
        name: zero, random or gait.
        env_id: Gymnasium id of the environment.
        env: the environment itself, one or several.
        seed: seed of the random agent.
        gait: parameters of the gait that differ from its defaults.
    """
    space = getattr(env, "single_action_space", None) or env.action_space
    if name == "zero":
        return Zero(space)
    if name == "random":
        space.seed(seed)
        return Random(space)
    return make_gait(env_id, env, gait or {})


def make_gait(
    env_id: str, env: Any, parameters: Mapping[str, float] | Sequence[Mapping[str, float]]
) -> Gaits:
    """Return the scripted gait of an environment."""
    gaits = importlib.import_module("mjgranular.envs.gaits")
    task: Any = getattr(env.unwrapped, "task", None)
    if type(task).__name__ not in gaits.gaits:
        raise InputError(
            f"there is no scripted gait for {env_id}; there are some for "
            f"{', '.join(f'mjgranular/{name}-v0' for name in gaits.gaits)}"
        )
    several = [parameters] if isinstance(parameters, Mapping) else parameters
    return Gaits(tuple(gaits.gait(task, **given) for given in several), task.dt)
