"""Environments for RLlib."""

import importlib
from collections.abc import Mapping
from functools import partial
from typing import Any

import gymnasium as gym

from mjgranular._util.checks import require
from mjgranular.envs.ids import find_spec


def register_env(env_id: str) -> str:
    """Register an environment with RLlib under its Gymnasium id; return it, for its `config`.

    RLlib needs this to make environments itself: the ids of this package are not registered in its
    workers. Use `env_runners(gym_env_vectorize_mode="vector_entry_point")` to step the
    `num_envs_per_env_runner` environments of a worker as one batch. `env_config` has the arguments
    of the environment. The id may name a module, `my_module:My-v0`.

    Raises:
        UnknownNameError: no such environment.
        MissingExtraError: Ray is not installed.
    """
    find_spec(env_id)
    tune = require("ray.tune.registry", extra="ray", purpose="Training with RLlib")
    tune.register_env(env_id, partial(_make, env_id))
    return env_id


def _make(env_id: str, context: Mapping[str, Any]) -> Any:
    """Return one environment, or with `num_envs` in the context several as a vector environment."""
    importlib.import_module("mjgranular.envs")  # registers the ids in this worker
    arguments = dict(context)
    num_envs = arguments.pop("num_envs", None)
    if num_envs is None:
        return gym.make(env_id, **arguments)
    mode = "sync" if find_spec(env_id).vector_entry_point is None else "vector_entry_point"
    return gym.make_vec(env_id, num_envs=num_envs, vectorization_mode=mode, **arguments)
