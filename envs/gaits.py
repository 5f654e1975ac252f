"""Scripted gaits: actions as functions of time, with parameters; for baselines and searches."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from mjgranular._util.checks import kind_of
from mjgranular.envs.task import Task, check_number
from mjgranular.errors import InputError, UnknownNameError


@dataclass(frozen=True)
class Gait(ABC):
    """Actions as a function of time; a final gait is a frozen dataclass of its parameters."""

    # Range of each parameter, (low, high), for searches.
    bounds: ClassVar[dict[str, tuple[float, float]]]

    def __post_init__(self) -> None:
        for field in fields(self):
            check_number(f"the gait's {field.name}", getattr(self, field.name))

    @abstractmethod
    def action(self, time: float, size: int) -> np.ndarray:
        """Return the action at a time [s], shape (size,), within [-1, 1]."""


@dataclass(frozen=True)
class TravellingWave(Gait):
    """A sine wave of joint angles, from head to tail."""

    bounds: ClassVar[dict[str, tuple[float, float]]] = {
        "amplitude": (0.2, 1.0),
        "frequency": (0.5, 6.0),
        "waves": (0.5, 2.0),
    }

    amplitude: float = 0.9  # amplitude of the actions
    frequency: float = 1.0  # frequency [Hz]
    # Number of waves along the body; negative ones run from the tail to the head
    waves: float = 1.0
    offset: float = 0.0  # added to all actions: a constant bend

    def action(self, time: float, size: int) -> np.ndarray:
        along = np.arange(1, size + 1) / (size + 1)
        phase = 2 * math.pi * (self.frequency * time - self.waves * along)
        return np.clip(self.offset + self.amplitude * np.sin(phase), -1.0, 1.0)


@dataclass(frozen=True)
class CrawlingWave(TravellingWave):
    """A sine wave in the vertical plane; nearly one wave from head to tail moves it forward."""

    bounds: ClassVar[dict[str, tuple[float, float]]] = {
        **TravellingWave.bounds,
        "waves": (-2.0, 2.0),
        "offset": (-0.4, 0.4),
    }

    amplitude: float = 0.6
    waves: float = 2 / 3


@dataclass(frozen=True)
class Tripod(Gait):
    """Tripod gait: front and rear leg of a side step with the middle leg of the other side."""

    bounds: ClassVar[dict[str, tuple[float, float]]] = {
        "stride": (0.2, 1.0),
        "lift": (0.1, 1.0),
        "press": (0.0, 0.6),
        "frequency": (0.5, 6.0),
        "duty": (0.4, 0.7),
    }

    stride: float = 0.8  # amplitude of the hips' actions
    lift: float = 0.7  # height of the knees' actions while a leg steps
    press: float = 0.2  # downward amplitude of the knees' actions while a leg stands
    frequency: float = 1.5  # step frequency of a leg [Hz]
    duty: float = 0.5  # share of the cycle for which a leg stands

    def action(self, time: float, size: int) -> np.ndarray:
        action = np.zeros(size)
        for leg in range(size // 2):
            left = leg < size // 4
            first = (leg % 3 == 1) != left  # front and rear left, middle right
            phase = (self.frequency * time + (0.0 if first else 0.5)) % 1.0
            if phase < self.duty:  # stands and pushes back
                swing = self.stride * (1 - 2 * phase / self.duty)
                lift = -self.press
            else:  # steps ahead
                step = (phase - self.duty) / (1 - self.duty)
                swing = self.stride * (2 * step - 1)
                lift = self.lift * math.sin(math.pi * step)
            action[2 * leg], action[2 * leg + 1] = swing, lift
        return np.clip(action, -1.0, 1.0)


@dataclass(frozen=True)
class Release(Gait):
    """A drop without spin, at an angle: the two actions are `angle` and `spin`."""

    bounds: ClassVar[dict[str, tuple[float, float]]] = {"angle": (-1.0, 1.0), "spin": (-1.0, 1.0)}

    angle: float = 0.0
    spin: float = 0.0

    def action(self, time: float, size: int) -> np.ndarray:
        return np.array([self.angle, self.spin])


gaits: dict[str, type[Gait]] = {
    "ChainSwim": TravellingWave,
    "ChainCrawl": CrawlingWave,
    "Hexapod": Tripod,
    "LinkDrop": Release,
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
    if not isinstance(task, Task):
        raise InputError(
            f"a gait is of a task, which an environment has as env.unwrapped.task, not of "
            f"{kind_of(task)}"
        )
    name = type(task).__name__
    if name not in gaits:
        raise UnknownNameError("gait for", name, gaits)
    cls = gaits[name]
    known = [field.name for field in fields(cls)]
    for given in parameters:
        if given not in known:
            raise InputError(f"the gait of {name} has no {given!r}; it has: {', '.join(known)}")
    made, size = cls(**parameters), int(np.prod(task.action_space.shape))
    return lambda time: made.action(time, size).astype(np.float32)
