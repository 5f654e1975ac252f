"""Agents that need no training: zero, random, a scripted gait. `policies.Policy` is another."""

import copy
import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from mjgranular.errors import InputError

BASELINES = ("zero", "random", "gait")


class Agent(Protocol):
    """Chooses actions for n simulations, shape (n, m).

    `steps` are the numbers of steps since the episodes began, shape (n,).
    """

    def act(self, observations: np.ndarray, steps: np.ndarray) -> np.ndarray: ...


@dataclass(frozen=True)
class Baseline:
    """An agent that observes nothing; `choose` returns actions for numbers of steps."""

    choose: Callable[[np.ndarray], np.ndarray]

    def act(self, observations: np.ndarray, steps: np.ndarray) -> np.ndarray:
        return self.choose(steps)


def make_baseline(
    name: str, env_id: str, env: Any, *, gait: Mapping[str, float] | None = None
) -> Agent:
    """Return an agent that needs no training: one of `BASELINES`.

    "zero" acts with the middle of the action space, or the first of discrete actions. `env` is one
    environment or several, `gait` has the parameters of the gait that differ from its defaults.
    """
    if name == "gait":
        gaits = importlib.import_module("mjgranular.envs.gaits")
        task: Any = getattr(env.unwrapped, "task", None)
        if type(task).__name__ not in gaits.gaits:
            raise InputError(
                f"there is no scripted gait for {env_id}; there are some for "
                f"{', '.join(f'mjgranular/{name}-v0' for name in gaits.gaits)}"
            )
        script = gaits.gait(task, **(gait or {}))
        return Baseline(lambda steps: np.array([script(time) for time in steps * task.dt]))
    space = getattr(env, "single_action_space", None) or env.action_space
    if name == "random":
        return Baseline(partial(_sample, env, space, []))
    middle: Any = 0
    if hasattr(space, "low"):
        middle = np.clip(0.0, space.low, space.high).astype(space.dtype)
    return Baseline(lambda steps: np.array([middle] * len(steps)))


def _sample(env: Any, space: Any, own: list[Any], steps: np.ndarray) -> np.ndarray:
    """Return random actions, in each environment by the seed of its first episode."""
    while len(own) < len(steps):  # seeds are consecutive
        first = np.atleast_1d(getattr(env, "np_random_seed", 0)).tolist()[0]
        own.append(copy.deepcopy(space))
        own[-1].seed(first + len(own) - 1)
    return np.array([each.sample() for each in own])
