"""Environments by their ids: one, several at once, or for Stable-Baselines3."""

from __future__ import annotations

import importlib
import inspect
import signal
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TypeVar

import numpy as np

from mjgranular._util.checks import check_count
from mjgranular._util.extras import require
from mjgranular.errors import GranularError, GranularWarning, InputError, RenderError

T = TypeVar("T")
_PURPOSE = "Training and evaluating policies"


def find_spec(env_id: str) -> Any:
    """Return Gymnasium's specification of an environment.

    Raises:
        UnknownNameError: no environment has that id, or no module has the name before its colon.
        InputError: that module cannot be imported.
        MissingExtraError: Gymnasium is not installed.
    """
    require("gymnasium", extra="train", purpose=_PURPOSE)
    return importlib.import_module("mjgranular.envs.known").find_spec(env_id)


def one(env_id: str, arguments: Mapping[str, Any]) -> Any:
    """Return one environment, a `gymnasium.Env`."""
    gym = require("gymnasium", extra="train", purpose=_PURPOSE)
    find_spec(env_id)
    return _made(env_id, arguments, lambda given: gym.make(env_id, **given))


def several(
    env_id: str, arguments: Mapping[str, Any], *, num_envs: int, threads: int | None = None
) -> Any:
    """Return several environments stepped together, a `gymnasium.vector.VectorEnv`.

    Those that have a vector form run in it, on `threads` threads (None: one per core); others run
    one after another.
    """
    gym = require("gymnasium", extra="train", purpose=_PURPOSE)
    options: dict[str, Any] = {"num_envs": num_envs, "vectorization_mode": "sync"}
    if _has_vector_form(env_id):
        options["vectorization_mode"] = "vector_entry_point"
        if threads is not None:
            options["threads"] = threads
    return _made(env_id, arguments, lambda given: gym.make_vec(env_id, **{**options, **given}))


def for_training(
    env_id: str,
    arguments: Mapping[str, Any],
    *,
    num_envs: int,
    processes: bool = False,
    threads: int | None = None,
    warp: str | None = None,
) -> Any:
    """Return environments as a `VecEnv` of Stable-Baselines3 that reports finished episodes.

    Args:
        env_id: Gymnasium id.
        arguments: arguments of the environment.
        num_envs: number of environments.
        processes: whether each is stepped in a separate process.
        threads: threads that step a batch; None for one per core.
        warp: device of MuJoCo Warp that steps the batch; None for MuJoCo on this machine's cores.

    Raises:
        InputError: the environment does not take the arguments, `processes` is set for environments
            that step in one batch, or `warp` for others.
    """
    require("stable_baselines3", extra="train", purpose="Training a policy")
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecMonitor

    batch = _has_vector_form(env_id)
    if warp is not None and (processes or not batch):
        raise InputError(
            "MuJoCo Warp steps environments of mjgranular, such as mjgranular/Hopper-v0, in one "
            f"batch, not {'in processes' if processes else env_id}: train with --engine local"
        )
    if processes and batch:
        raise InputError(f"{env_id} steps in a batch on all cores: omit processes")
    if processes:
        return _in_processes(env_id, arguments, num_envs)
    if not batch:
        return _made(
            env_id, arguments, lambda given: make_vec_env(env_id, num_envs, env_kwargs=given)
        )
    make = importlib.import_module("mjgranular.envs.sb3").make_vec_env
    options = {} if threads is None else {"threads": threads}
    env = _made(
        env_id, arguments, lambda given: make(env_id, num_envs, warp=warp, **{**options, **given})
    )
    return VecMonitor(env)


def _in_processes(env_id: str, arguments: Mapping[str, Any], num_envs: int) -> Any:
    """Return environments in one process each, which import all that they need."""
    from stable_baselines3.common.vec_env import SubprocVecEnv

    class Processes(SubprocVecEnv):
        def step_wait(self) -> Any:
            # Single precision, as the rewards of a DummyVecEnv: results are the same to the bit.
            observations, rewards, *others = super().step_wait()
            return observations, np.asarray(rewards, np.float32), *others

    # Spawned rather than forked: MuJoCo and numba may hold threads and locks.
    make = partial(_monitored, env_id, dict(arguments))
    return Processes([make] * num_envs, start_method="spawn")


def _monitored(env_id: str, arguments: Mapping[str, Any]) -> Any:
    """Return the environment of a worker process, which reports finished episodes."""
    from stable_baselines3.common.monitor import Monitor

    # Ctrl-C reaches all processes: the training process decides when to end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore", GranularWarning)  # the training process has shown them
    return Monitor(one(env_id, arguments))


def for_filming(
    env_id: str, arguments: Mapping[str, Any], *, width: int, height: int, camera: str | None
) -> Any:
    """Return one environment that renders itself.

    Raises:
        RenderError: rendering fails on this machine.
        InputError: it has no cameras, and one was requested.
    """
    from gymnasium.envs.registration import load_env_creator

    creator = find_spec(env_id).entry_point
    if isinstance(creator, str):
        creator = load_env_creator(creator)
    parameters = inspect.signature(creator).parameters
    takes_all = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    if camera is not None and not (takes_all or "camera_name" in parameters):
        raise InputError(f"{env_id} has no cameras to choose from: omit --camera")
    options: dict[str, Any] = {"width": width, "height": height}
    if camera is not None:
        options["camera_name"] = camera
    options = {name: options[name] for name in options if takes_all or name in parameters}
    return one(env_id, {**arguments, "render_mode": "rgb_array", **options})


def _has_vector_form(env_id: str) -> bool:
    ours = env_id.rpartition(":")[2].startswith("mjgranular/")
    return find_spec(env_id).vector_entry_point is not None and ours


def _made(env_id: str, arguments: Mapping[str, Any], make: Callable[[dict[str, Any]], T]) -> T:
    """Call `make`; turn an environment's own errors into one sentence.

    The argument `refine` divides the substeps of a MuJoCo environment by that factor, and
    multiplies their number between two actions by it: a policy that behaves differently then has
    learned the time step and not the robot.
    """
    gym = require("gymnasium", extra="train", purpose=_PURPOSE)
    given = dict(arguments)
    refine = given.pop("refine", 1)
    check_count("refine", refine)
    try:
        if refine == 1:
            return make(given)
        coarse = gym.make(env_id, **given)
        frame_skip = getattr(_inner(coarse), "frame_skip", None)
        coarse.close()
        if frame_skip is None or not hasattr(_inner(coarse), "model"):
            raise InputError(f"refine must be for a MuJoCo environment, got {env_id}")
        env = make({**given, "frame_skip": refine * frame_skip})
        _divide_timestep(env, refine)
        return env
    except GranularError:
        raise
    except gym.error.DependencyNotInstalled as error:
        raise RenderError(f"{env_id}: {' '.join(str(error).split())}") from None
    except Exception as error:  # neither the arguments nor the environment are trusted
        expected = isinstance(error, (gym.error.Error, TypeError, ValueError))
        kind = "" if expected else f"{type(error).__name__}: "
        text = f"{env_id} cannot be made: {kind}{' '.join(str(error).split())}"
        raise InputError(text) from (None if expected else error)


def _inner(env: Any) -> Any:
    """Return the object with model and time step: a task of mjgranular or a MuJoCo environment."""
    return getattr(env.unwrapped, "task", env.unwrapped)


def _divide_timestep(env: Any, divisor: int) -> None:
    """Divide the time step of one environment, or of several: a batch, or a vector environment."""
    batch = getattr(env, "batch", None)
    if hasattr(batch, "task"):  # `SandVecEnv` around `SandVectorEnv`
        env = batch
    for each in getattr(env, "envs", None) or [env]:
        inner = _inner(each)
        inner.model.opt.timestep /= divisor
        inner.__dict__.pop("dt", None)  # a task caches the duration of a step
        batch = getattr(each, "batch", None)
        if batch is not None:  # it has copied the model
            batch.expand("opt.timestep")[:] = inner.model.opt.timestep
