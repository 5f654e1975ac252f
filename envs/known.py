"""Environments by Gymnasium id, including custom ones."""

import difflib
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec, load_env_creator

from mjgranular._util.user_modules import import_own
from mjgranular.errors import InputError, UnknownNameError


def find_spec(env_id: Any) -> EnvSpec:
    """Return Gymnasium's specification of an environment, from its id.

    `my_module:My-v0` imports the module that registers it, also from the current folder
    (`mjgranular._util.user_modules`). Errors list ids of mjgranular and similar ones.
    """
    if not isinstance(env_id, str):
        raise InputError(f"an environment is named by a text such as 'Ant-v5', not {env_id!r}")
    module, colon, name = env_id.rpartition(":")
    hint = "one of your own is named with its module, my_module:My-v0"
    if colon:
        if not name:
            raise InputError(f"{env_id!r} lacks the id behind the colon: {module}:My-v0, say")
        import_own(module, f"the environment {env_id}")
        hint = f"importing {module} has registered no {name}"
    try:
        return gym.spec(name)
    except gym.error.Error:
        known = sorted(gym.registry)
        ours = [one for one in known if one.startswith("mjgranular/")]
        others = [one for one in known if one not in ours]
        near = difflib.get_close_matches(name, others, n=5, cutoff=0.5)
        raise UnknownNameError("environment", env_id, [*near, *ours], hint) from None


def creator_of(entry_point: Any) -> Any:
    """Return the class of an environment, or the function that makes it."""
    return load_env_creator(entry_point) if isinstance(entry_point, str) else entry_point
