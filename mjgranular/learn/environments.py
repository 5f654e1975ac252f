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
    mode = "vector_entry_point" if _has_vector_form(env_id) else "sync"
    more = {"threads": threads} if mode != "sync" and threads is not None else {}
    return _made(
        env_id,
        arguments,
        lambda given: gym.make_vec(
            env_id, num_envs=num_envs, vectorization_mode=mode, **{**more, **given}
        ),
    )


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
    if warp is not None and (processes or not _has_vector_form(env_id)):
        raise InputError(
            f"MuJoCo Warp steps environments of mjgranular's own, such as mjgranular/Hopper-v0, in "
            f"one batch, not {'in processes' if processes else env_id}: train with --engine local"
        )
    if processes:
        return _in_processes(env_id, arguments, num_envs)
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecMonitor

    if not _has_vector_form(env_id):
        return _made(
            env_id,
            arguments,
            lambda given: make_vec_env(env_id, n_envs=num_envs, env_kwargs=given),
        )
    make = importlib.import_module("mjgranular.envs.sb3").make_vec_env
    more: dict[str, Any] = {} if threads is None else {"threads": threads}
    if warp is not None:
        more["warp"] = warp
    env = _made(
        env_id, arguments, lambda given: make(env_id, num_envs=num_envs, **{**more, **given})
    )
    return VecMonitor(env)


def _in_processes(env_id: str, arguments: Mapping[str, Any], num_envs: int) -> Any:
    """Return environments in one process each, which import all that they need."""
    from stable_baselines3.common.vec_env import SubprocVecEnv

    if _has_vector_form(env_id):
        raise InputError(f"{env_id} steps in a batch on all cores: omit processes")

    class Processes(SubprocVecEnv):
        def step_wait(self) -> Any:
            # In single precision, as a DummyVecEnv has rewards: learning is the same to the bit.
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
    warnings.simplefilter("ignore", GranularWarning)  # given once, by the training process
    return Monitor(one(env_id, arguments))


def for_filming(
    env_id: str, arguments: Mapping[str, Any], *, width: int, height: int, camera: str | None
) -> Any:
    """Return one environment that renders itself.

    Raises:
        RenderError: rendering fails on this machine.
        InputError: it has no cameras, and one was requested.
    """
    spec = find_spec(env_id)
    wanted: dict[str, Any] = {"width": width, "height": height}
    if camera is not None:
        wanted["camera_name"] = camera
    taken = _parameters(spec)
    if camera is not None and not _takes(taken, "camera_name"):
        raise InputError(f"{env_id} has no cameras to choose from; leave --camera away")
    wanted = {name: value for name, value in wanted.items() if _takes(taken, name)}
    return one(env_id, {**arguments, "render_mode": "rgb_array", **wanted})


def _parameters(spec: Any) -> Mapping[str, inspect.Parameter]:
    from gymnasium.envs.registration import load_env_creator

    point = spec.entry_point
    return inspect.signature(
        load_env_creator(point) if isinstance(point, str) else point
    ).parameters


def _takes(parameters: Mapping[str, inspect.Parameter], name: str) -> bool:
    return name in parameters or any(p.kind is p.VAR_KEYWORD for p in parameters.values())


def _has_vector_form(env_id: str) -> bool:
    return find_spec(env_id).vector_entry_point is not None and env_id.rpartition(":")[
        2
    ].startswith("mjgranular/")


def _resolved(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return arguments for environments: a table of ranges of sand becomes `SandRanges`."""
    resolved = dict(arguments)
    table = resolved.get("randomise")
    if isinstance(table, Mapping):
        from mjgranular.envs.ranges import SandRanges  # pyright: ignore[reportMissingImports]

        try:
            resolved["randomise"] = SandRanges(
                **{name: tuple(value) for name, value in table.items()}
            )
        except TypeError as error:
            raise InputError(f"randomise must be a table of ranges of sand: {error}") from None
    return resolved


def _made(env_id: str, arguments: Mapping[str, Any], make: Callable[[dict[str, Any]], T]) -> T:
    """Call `make`; turn an environment's own errors into one sentence.

    The argument `refine` divides the substeps of a MuJoCo environment by that factor, and
    multiplies their number between two actions by it: a policy that behaves differently then has
    learned the time step and not the robot.
    """
    gym = require("gymnasium", extra="train", purpose=_PURPOSE)
    given = _resolved(arguments)
    times = given.pop("refine", 1)
    check_count("refine", times)
    try:
        if times == 1:
            return make(given)
        coarse = gym.make(env_id, **given)
        try:
            given["frame_skip"] = times * _frame_skip_of(coarse)
        finally:
            coarse.close()
        env = make(given)
        _shorten_steps(env, times)
        return env
    except GranularError:
        raise
    except gym.error.DependencyNotInstalled as error:
        raise RenderError(f"{env_id}: {' '.join(str(error).split())}") from None
    except (gym.error.Error, TypeError, ValueError) as error:
        raise InputError(f"{env_id} cannot be made: {' '.join(str(error).split())}") from None
    except Exception as error:  # neither the arguments nor the environment are trusted
        raise InputError(
            f"{env_id} cannot be made: {type(error).__name__}: {' '.join(str(error).split())}"
        ) from error


def _frame_skip_of(env: Any) -> int:
    """Return the number of substeps between two actions.

    Raises:
        InputError: not a MuJoCo environment.
    """
    inner = getattr(env.unwrapped, "task", env.unwrapped)
    if not hasattr(inner, "frame_skip") or not hasattr(inner, "model"):
        raise InputError(f"refine is for environments of MuJoCo's; {env.unwrapped} is none")
    return int(inner.frame_skip)


def _shorten_steps(env: Any, times: int) -> None:
    """Shorten the substeps of one environment, or of several: a batch, or a vector environment."""
    inside = getattr(env, "batch", None)
    if hasattr(inside, "task"):  # `SandVecEnv` around `SandVectorEnv`
        env = inside
    for one in getattr(env, "envs", None) or [env]:
        inner = getattr(one.unwrapped, "task", one.unwrapped)
        inner.model.opt.timestep /= times
        # A task caches the duration of a step at the first access.
        inner.__dict__.pop("dt", None)
        batch = getattr(one, "batch", None)
        if batch is not None:  # which has copied the model
            batch.expand("opt.timestep")[:] = inner.model.opt.timestep
