"""The same environment in finer time steps: does what was learned hold in them?

A policy finds every fault of a simulation. If it does otherwise in steps a fifth as long, between
the same actions, it has learned the step and not the robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mjgranular.errors import InputError

ARGUMENT = "refine"
"""The argument of an environment that says how many times finer; understood here, for any of
MuJoCo's environments that takes `frame_skip`."""


def split(arguments: Mapping[str, Any]) -> tuple[dict[str, Any], int]:
    """The arguments without `refine`, and its value; 1 without it.

    Raises:
        InputError: not a whole number of at least 1.
    """
    rest = dict(arguments)
    times = rest.pop(ARGUMENT, 1)
    if not isinstance(times, int) or isinstance(times, bool) or times < 1:
        raise InputError(f"refine must be a whole number of at least 1, not {times!r}")
    return rest, times


def frame_skip_of(env: Any) -> int:
    """Substeps between two actions.

    Raises:
        InputError: not an environment of MuJoCo's.
    """
    inner = getattr(env.unwrapped, "task", env.unwrapped)
    if not hasattr(inner, "frame_skip") or not hasattr(inner, "model"):
        raise InputError(f"refine is for environments of MuJoCo's; {env.unwrapped} is none")
    return int(inner.frame_skip)


def refine(env: Any, times: int) -> None:
    """Makes the substeps shorter; `frame_skip` must be longer by as much already.

    Args:
        env: an environment, or several of them: a batch, with or without `SandVecEnv`
            around it, a `SyncVectorEnv`, a `DummyVecEnv`.
        times: how many times shorter.
    """
    inside = getattr(env, "batch", None)
    if hasattr(inside, "task"):  # `SandVecEnv` around `SandVectorEnv`
        env = inside
    for one in getattr(env, "envs", None) or [env]:
        inner = getattr(one.unwrapped, "task", one.unwrapped)
        inner.model.opt.timestep /= times
        # A task notes its duration of a step the first time that it is asked.
        inner.__dict__.pop("dt", None)
        batch = getattr(one, "batch", None)
        if batch is not None:  # which has copied the model
            batch.expand("opt.timestep")[:] = inner.model.opt.timestep
