"""Environments by Gymnasium id, including custom ones."""

import difflib
from pathlib import Path
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
    module, colon, name = env_id.partition(":")
    if not colon:
        name = module
    elif not name:
        raise InputError(f"{env_id!r} lacks the id behind the colon: {module}:My-v0, for example")
    else:
        before = set(gym.registry)
        import_own(module, f"the environment {env_id}")
        _of_modules.setdefault(module, set()).update(set(gym.registry) - before)
    try:
        return gym.spec(name)
    except gym.error.Error:
        own = _registered_by(module) if colon else []
        if own:
            hint = f"importing {module} has registered no {name}"
            raise UnknownNameError("environment", env_id, own, hint) from None
        known = sorted(gym.registry)
        ours = [one for one in known if one.startswith("mjgranular/")]
        others = [one for one in known if one not in ours]
        near = difflib.get_close_matches(name, others, n=5, cutoff=0.5)
        hint = f"importing {module} has registered no {name}" if colon else _how(name)
        raise UnknownNameError("environment", env_id, [*near, *ours], hint) from None


def creator_of(entry_point: Any) -> Any:
    """Return the class of an environment, or the function that makes it."""
    return load_env_creator(entry_point) if isinstance(entry_point, str) else entry_point


_of_modules: dict[str, set[str]] = {}  # ids that an import of a module registered


def _registered_by(module: str) -> list[str]:
    """Return the ids that a module has registered, as far as known."""
    made = {
        name
        for name, spec in gym.registry.items()
        if str(spec.entry_point).partition(":")[0] == module
        or getattr(spec.entry_point, "__module__", None) == module
    }
    return sorted(f"{module}:{name}" for name in made | _of_modules.get(module, set()))


def _how(name: str) -> str:
    """Return how to name a custom environment."""
    stem = Path(name).stem if name.endswith(".py") else name
    if not stem.isidentifier() or not Path(f"{stem}.py").is_file():
        return "one of your own is named with its module, my_module:My-v0"
    return f"one that {stem}.py registers is named {stem}:ID"
