"""Environments by their ids: one, several at once, or for Stable-Baselines3."""

import importlib
import inspect
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from mjgranular._util.checks import require
from mjgranular.errors import GranularError, InputError, RenderError

_PURPOSE = "Training and evaluating policies"


def find_spec(env_id: str) -> Any:
    """Return Gymnasium's specification of an environment."""
    require("gymnasium", extra="train", purpose=_PURPOSE)
    return importlib.import_module("mjgranular.envs.ids").find_spec(env_id)


def one(env_id: str, arguments: Mapping[str, Any]) -> Any:
    """Return one environment, a `gymnasium.Env`."""
    find_spec(env_id)
    with _making(env_id) as gym:
        return gym.make(env_id, **arguments)


def several(env_id: str, arguments: Mapping[str, Any], *, num_envs: int) -> Any:
    """Return several environments stepped together, a `gymnasium.vector.VectorEnv`.

    Those that have a vector form run in it; others run one after another.
    """
    mode = "vector_entry_point" if _has_vector_form(env_id) else "sync"
    options: dict[str, Any] = {"num_envs": num_envs, "vectorization_mode": mode}
    with _making(env_id) as gym:
        return gym.make_vec(env_id, **{**options, **arguments})


def for_training(
    env_id: str, arguments: Mapping[str, Any], *, num_envs: int, warp: str | None = None
) -> Any:
    """Return environments as a `VecEnv` of Stable-Baselines3 that reports finished episodes."""
    require("stable_baselines3", extra="train", purpose="Training a policy")
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecMonitor

    if _has_vector_form(env_id):
        make = importlib.import_module("mjgranular.envs.sb3").make_vec_env
        with _making(env_id):
            return VecMonitor(make(env_id, num_envs, warp=warp, **arguments))
    if warp is not None:
        raise InputError(
            "MuJoCo Warp steps environments of mjgranular, such as mjgranular/Hopper-v0, in one "
            f"batch, not {env_id}: train with --engine local"
        )
    with _making(env_id):
        return make_vec_env(env_id, num_envs, env_kwargs=dict(arguments))


def for_filming(
    env_id: str, arguments: Mapping[str, Any], *, width: int, height: int, camera: str | None
) -> Any:
    """Return one environment that renders itself."""
    ids = importlib.import_module("mjgranular.envs.ids")
    creator = ids.creator_of(ids.find_spec(env_id).entry_point)
    parameters = inspect.signature(creator).parameters
    takes_all = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    if camera is not None and not (takes_all or "camera_name" in parameters):
        raise InputError(f"{env_id} has no cameras to choose from: omit --camera")
    named = {} if camera is None else {"camera_name": camera}
    wanted: dict[str, Any] = {"width": width, "height": height, **named}
    options = {name: wanted[name] for name in wanted if takes_all or name in parameters}
    return one(env_id, {**arguments, "render_mode": "rgb_array", **options})


def _has_vector_form(env_id: str) -> bool:
    ours = env_id.rpartition(":")[2].startswith("mjgranular/")
    return find_spec(env_id).vector_entry_point is not None and ours


@contextmanager
def _making(env_id: str) -> Iterator[Any]:
    """Yield Gymnasium; turn errors of an environment that is made into one sentence."""
    gym = require("gymnasium", extra="train", purpose=_PURPOSE)
    try:
        yield gym
    except GranularError:
        raise
    except gym.error.DependencyNotInstalled as error:
        raise RenderError(f"{env_id}: {' '.join(str(error).split())}") from None
    except Exception as error:  # neither the arguments nor the environment are trusted
        expected = isinstance(error, (gym.error.Error, TypeError, ValueError))
        kind = "" if expected else f"{type(error).__name__}: "
        text = f"{env_id} cannot be made: {kind}{' '.join(str(error).split())}"
        raise InputError(text) from (None if expected else error)
