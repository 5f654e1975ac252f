"""Scripted gaits: actions as functions of time, with parameters; for baselines and searches."""

import inspect
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from mjgranular._util.checks import check_kind, check_name
from mjgranular.envs.task import Task, check_number
from mjgranular.errors import InputError


def travelling_wave(
    time: float,
    size: int,
    *,
    amplitude: float = 0.9,
    frequency: float = 1.0,
    waves: float = 1.0,
    offset: float = 0.0,
) -> np.ndarray:
    """Return the actions of a sine wave of joint angles at a time [s], shape (size,).

    Of `waves` along the body, negative ones run from the tail to the head. The frequency is in Hz,
    and the offset, a constant bend, is added to all actions.
    """
    along = np.arange(1, size + 1) / (size + 1)
    phase = 2 * math.pi * (frequency * time - waves * along)
    return np.clip(offset + amplitude * np.sin(phase), -1.0, 1.0)


def tripod(
    time: float,
    size: int,
    *,
    stride: float = 0.8,
    lift: float = 0.7,
    press: float = 0.2,
    frequency: float = 1.5,
    duty: float = 0.5,
) -> np.ndarray:
    """Return the actions of a tripod gait at a time [s], shape (size,).

    Front and rear leg of a side step, `frequency` times a second, with the middle leg of the other
    side. `stride` is the amplitude of the hips' actions; those of the knees are `lift` upward while
    a leg steps, and `press` downward while it stands, a share `duty` of the cycle.
    """
    action = np.zeros(size)
    for leg in range(size // 2):
        left = leg < size // 4
        first = (leg % 3 == 1) != left  # front and rear left, middle right
        phase = (frequency * time + (0.0 if first else 0.5)) % 1.0
        if phase < duty:  # stands and pushes back
            action[2 * leg] = stride * (1 - 2 * phase / duty)
            action[2 * leg + 1] = -press
        else:  # steps ahead
            step = (phase - duty) / (1 - duty)
            action[2 * leg] = stride * (2 * step - 1)
            action[2 * leg + 1] = lift * math.sin(math.pi * step)
    return np.clip(action, -1.0, 1.0)


def release(time: float, size: int, *, angle: float = 0.0, spin: float = 0.0) -> np.ndarray:
    """Return the two actions of a drop."""
    return np.array([angle, spin])


gaits: dict[str, Callable[..., np.ndarray]] = {
    "ChainSwim": travelling_wave,
    "ChainCrawl": partial(travelling_wave, amplitude=0.6, waves=2 / 3),  # moves it forward
    "Hexapod": tripod,
    "LinkDrop": release,
}
"""Gaits by the names of their tasks."""


def gait(task: Task, **parameters: Any) -> Callable[[float], np.ndarray]:
    """Return the scripted gait of a task: a function from time [s] to actions.

    Args:
        task: the task, as `env.unwrapped.task`.
        **parameters: parameters of its gait that differ from the defaults.

    Raises:
        UnknownNameError: the task has no gait; lists the tasks with one.
        InputError: no such parameter; lists the valid ones.
    """
    check_kind(task, Task, "gait", "env.unwrapped.task")
    name = type(task).__name__
    check_name("gait for", name, gaits)
    known = [*inspect.signature(gaits[name]).parameters][2:]
    for given, value in parameters.items():
        if given not in known:
            raise InputError(f"the gait of {name} has no {given!r}; it has: {', '.join(known)}")
        check_number(f"the gait's {given}", value)
    act = partial(gaits[name], size=int(np.prod(task.action_space.shape)), **parameters)
    return lambda time: act(time).astype(np.float32)
