"""Tasks: environments over a leading axis of simulations.

A task is independent of Gymnasium environments and batches: it reads arrays whose first axis counts
simulations, and works on them element by element. `SandEnv` passes it one simulation and
`SandVectorEnv` many; both get bit-identical results.

To achieve this, a task sums only along the last axis, of row-major arrays, and uses no function
that NumPy computes differently for short and long arrays.
"""

import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from numbers import Real
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar, NoReturn

import mujoco
import numpy as np
from gymnasium.spaces import Box

from mjgranular import HeightField, InputError, Medium, Plane, SandSpec
from mjgranular._util.checks import check_count, check_switch
from mjgranular._util.parse import Registry
from mjgranular.envs.figures import Figures
from mjgranular.envs.ground import DUNES, Dunes, add_dunes, put_on_sand
from mjgranular.envs.ranges import Choice, Sample, SandRanges, choices_of, ranges_of, sampled_info
from mjgranular.errors import shown
from mjgranular.sand.spec import SAND_FIELDS
from mjgranular.surface import surface_of

State = SimpleNamespace
"""Live arrays of n simulations: `qpos`, `qvel`, `sensordata`, ..., each of shape (n, ...); and
`active`, `strength`, `density`, `slope` of the sand of each, shape (n,). `found` is for `once`."""

ACTION_LIMIT = 1.0  # actions are within [-1, 1]; the task defines their meaning


@dataclass(frozen=True)
class Start:
    """Beginning of an episode.

    Attributes:
        qpos: positions, shape (nq,).
        qvel: velocities, shape (nv,).
        userdata: other data of the episode, shape (nuserdata,).
        numbers: fields of the model in this episode, of those `varied`; others are as built.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    userdata: np.ndarray | None = None
    numbers: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Task(SandSpec, ABC):
    """A robot, its sand, and its goal.

    A final task is a frozen dataclass; its fields are the options of the environment. Its docstring
    is the environment's specification, in Gymnasium's sections; it may omit those of `sections`.

    The sand has the fields of `mjgranular.SandSpec` too. It always replaces the floor.

    Attributes:
        randomise: ranges of the sand of each episode, or {"strength": (0.5, 2)}; None if fixed.
        curriculum: returns the ranges for the next episode, given the number of episodes that this
            simulation has begun; must be within `randomise`.
        rigid: the x up to which the ground is a rigid floor [m]. Robots start at x = 0: 0.5 makes
            one walk from the floor onto sand, inf leaves no sand. None or -inf for sand alone.
        observe_sand: append the sampled sand to the observation: strength, density, slope, and a
            one-hot vector if there are several sands.
        frame_skip: substeps in a step.

    Raises:
        InputError: a value outside its range, or a curriculum without `randomise`.
    """

    title: ClassVar[str]
    episode: ClassVar[int] = 1000
    """Steps after which `gymnasium.make` truncates an episode."""
    reads: ClassVar[tuple[str, ...]] = ()
    """Fields of `MjData` that are read in addition to qpos, qvel, userdata and sensordata."""
    dunes: ClassVar[Dunes] = Dunes()
    """The dunes, if sampled."""
    cut: ClassVar[float] = 0.0
    """Depth of the cut at which the sand is rendered [m]."""
    tile: ClassVar[float] = 0.5
    """Edge length of the ground's texture [m]."""
    camera: ClassVar[dict[str, Any]] = {}
    """Settings of the free camera: trackbodyid, distance, azimuth, elevation, lookat."""

    sections: ClassVar[dict[str, str]] = {
        **dict.fromkeys(("Description", "Action Space", "Observation Space", "Rewards"), ""),
        **dict.fromkeys(("Starting State", "Episode End", "Arguments"), ""),
        "Version History": "v0: first.",
    }
    """Sections of the specification in their order; "{}" stands for the name of the class."""

    medium: str | Path | Medium = "quikrete_medium"
    resolution: int | None = 4
    randomise: SandRanges | None = None
    curriculum: Callable[[int], SandRanges] | None = field(default=None)
    rigid: float | None = None
    observe_sand: bool = False
    frame_skip: int = 5

    def __init_subclass__(cls) -> None:
        title, *own = inspect.cleandoc(cls.__doc__ or "").split("\n\n## ")
        if own:
            texts = {head: text.format(cls.__name__) for head, text in cls.sections.items()}
            texts |= {head: text for head, _, text in (part.partition("\n") for part in own)}
            parts = [f"## {head}\n{text}" for head, text in texts.items() if text]
            cls.__doc__ = "\n\n".join([title, *parts])

    def __post_init__(self) -> None:
        check_count("frame_skip", self.frame_skip)
        for option in fields(self):
            if option.name not in SAND_FIELDS:
                check_option(option.name, getattr(self, option.name), option.default)
        object.__setattr__(
            self, "randomise", ranges_of(self.randomise, self.curriculum, self.memory)
        )
        if self.observe_sand and self.randomise is None:
            raise InputError("observe_sand needs randomise=SandRanges(...): else it is constant")

    # Defined by a task.

    @abstractmethod
    def robot(self) -> mujoco.MjSpec:
        """Return the robot over a floor, a plane geom of the world."""

    @abstractmethod
    def start(self, random: np.random.Generator, height: Callable[[float, float], float]) -> Start:
        """Return an episode's start; `height` is that of the sand over the floor at x, y [m]."""

    @abstractmethod
    def observe(self, state: State) -> np.ndarray:
        """Return observations, shape (n, k), in new arrays."""

    @abstractmethod
    def rewards(self, before: Any, action: np.ndarray, state: State) -> dict[str, np.ndarray]:
        """Return the terms of the reward by their names in `info`, each of shape (n,).

        `before` is what `mark` returned before the step, the action has the shape (n, nu).
        """

    def mark(self, state: State) -> Any:
        """Copy what `rewards` needs from the state before a step: the first two positions."""
        return state.qpos[:, :2].copy()

    def total(self, terms: dict[str, np.ndarray]) -> np.ndarray:
        """Return the reward from its terms, shape (n,)."""
        total = np.asarray(sum(terms.values()))
        if total.ndim != 1:
            self._refuse("rewards", {name: np.shape(term) for name, term in terms.items()}, "(n,)")
        return total

    def act(self, action: np.ndarray, state: State) -> np.ndarray:
        """Return controls for actions, shape (n, nu).

        It may write to the state, which is the one before the step.
        """
        return action

    def terminated(self, state: State) -> np.ndarray:
        """Return True if an episode is over, shape (n,)."""
        return np.zeros(len(state.qpos), bool)

    def place(self, state: State) -> dict[str, np.ndarray]:
        """Return entries of `info` after resets and steps, by name, each of shape (n, ...)."""
        return {}

    def progress(self, before: Any, state: State) -> dict[str, np.ndarray]:
        """Return entries of `info` only after steps, by name, each of shape (n, ...)."""
        return {}

    @cached_property
    def action_space(self) -> Box:
        """Space of one simulation."""
        return Box(-ACTION_LIMIT, ACTION_LIMIT, (self.model.nu,), np.float32)

    # Built from it, once.

    @cached_property
    def choices(self) -> Sequence[Choice]:
        """The sands of the model."""
        return choices_of(self.randomise, self, HeightField(DUNES))

    @property
    def sands(self) -> Sequence[SandSpec]:
        """The sands of the model, as specified."""
        return [choice.sand for choice in self.choices]

    def scene(self) -> mujoco.MjSpec:
        """Return the robot, with dunes if sampled, before sand replaces the floor."""
        spec = self.robot()
        if any(choice.surface == "dunes" for choice in self.choices):
            add_dunes(spec, self.dunes)
        return spec

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The robot on sand, never changed: gravity is tilted in copies."""
        spec, drawn = self.scene(), self.randomise is not None
        return put_on_sand(
            spec, self.sands, rigid=self.rigid, tunable=drawn, cut=self.cut, tile=self.tile
        )

    @cached_property
    def figures(self) -> Figures:
        """Reader of the sand's metrics."""
        return Figures(self.model, self.sands)

    @cached_property
    def dt(self) -> float:
        """Duration of a step [s]."""
        return float(self.model.opt.timestep * self.frame_skip)

    @cached_property
    def observation_space(self) -> Box:
        """Space of one simulation."""
        state = self.state_of(mujoco.MjData(self.model))
        for name, right, dims in (("observe", "(n, k)", 2), ("terminated", "(n,)", 1)):
            shape = np.shape(getattr(self, name)(state))
            if shape[:1] != (1,) or len(shape) != dims:
                self._refuse(name, shape, right)
        size = self.observation(state).shape[1]
        return Box(-np.inf, np.inf, (size,), np.float64)

    def _refuse(self, name: str, shape: Any, right: str) -> NoReturn:
        raise InputError(
            f"{type(self).__name__}.{name} must return arrays of shape {right} for n simulations, "
            f"not {shape}"
        )

    @staticmethod
    def once(state: State, name: str, find: Callable[[State], Any]) -> Any:
        """Return a quantity that follows from a state; `find` is called once for each state."""
        if name not in state.found:
            state.found[name] = find(state)
        return state.found[name]

    # Called by an environment.

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the `MjModel` fields that differ between episodes."""
        return () if self.randomise is None else ("opt.gravity",)

    @property
    def bound(self) -> tuple[str, ...]:
        """Names of the `MjData` fields in a state."""
        always = ("qpos", "qvel", "sensordata")
        return (*always, *(("userdata",) if self.model.nuserdata else ()), *self.reads)

    def new_state(self, arrays: dict[str, np.ndarray]) -> State:
        """Return a state of these arrays, on the initial sand of the model."""
        n = len(arrays["qpos"])
        return State(
            **arrays,
            active=np.zeros(n, int),
            strength=np.ones(n),
            density=np.ones(n),
            slope=np.zeros(n),
            found={},
        )

    def state_of(self, data: mujoco.MjData) -> State:
        """Return the state of one simulation: views of its data with a leading axis of one."""
        return self.new_state({name: getattr(data, name)[None] for name in self.bound})

    def sample(
        self, random: np.random.Generator, episode: int, ranges: SandRanges | None
    ) -> Sample | None:
        """Sample the sand of an episode of that number; return None for a fixed sand.

        The curriculum acts on `randomise` alone: `InputError` if it leaves these ranges.
        """
        if ranges is None:
            return None
        if ranges is self.randomise:
            ranges = ranges.in_episode(self.curriculum, episode)
        return ranges.draw(self.choices, random, span=self.dunes.wavelength)

    def lay(
        self,
        sample: Sample | None,
        start: Start,
        state: State,
        row: int,
        plugin_state: np.ndarray,
        numbers: Mapping[str, np.ndarray],
    ) -> None:
        """Apply a start and the sampled sand to the simulation with index `row` in a state.

        Its plugin state and its `varied` fields, `numbers`, are written to.
        """
        state.qpos[row], state.qvel[row] = start.qpos, start.qvel
        if start.userdata is not None:
            state.userdata[row] = start.userdata
        for name in numbers.keys() | start.numbers.keys():
            numbers[name][:] = start.numbers.get(name, attrgetter(name)(self.model))
        if sample is not None:
            sample.lay(self.model, self.figures, plugin_state, numbers["opt.gravity"])
            for name in ("active", "strength", "density", "slope"):
                getattr(state, name)[row] = getattr(sample, name)

    def begin(self, random: np.random.Generator, sample: Sample | None) -> Start:
        """Return the start of an episode on the sampled sand; None for a fixed sand."""
        number, place = (0, 0.0) if sample is None else (sample.active, sample.place)
        ground = self.ground(number) or (lambda x, y: 0.0)
        start = self.start(random, lambda x, y: ground(x + place, y))
        start.qpos[0] += place  # x comes first in all our models
        return start

    def ground(self, number: int) -> Callable[[float, float], float] | None:
        """Return the height over the floor at x, y of the surface of the sand of that index [m].

        None is zero everywhere, or unknown, as for the model's own geom.
        """
        if self.choices[number].surface == "dunes":
            return self.dunes.height
        surface = surface_of(self.surface)
        if not isinstance(surface, Plane) or (surface.height == 0.0 and surface.slope == 0.0):
            return None
        rise = math.tan(surface.slope)
        along, across = rise * math.cos(surface.uphill), rise * math.sin(surface.uphill)
        return lambda x, y: surface.height + along * x + across * y

    def observation(self, state: State) -> np.ndarray:
        """Return observations, shape (n, k), with the sampled sand if `observe_sand` is set."""
        seen = self.observe(state)
        if not self.observe_sand:
            return seen
        drawn = [state.strength, state.density, state.slope]
        if len(self.choices) > 1:
            drawn += [state.active == number for number in range(len(self.choices))]
        return np.concatenate([seen, np.stack(drawn, axis=1)], axis=1)

    def reset_info(self, state: State) -> dict[str, np.ndarray]:
        """Return `info` after a reset, by name, each of shape (n, ...)."""
        info = self.place(state)
        info |= self.figures.read(state.sensordata, state.active, state.slope)
        if self.randomise is not None:
            info |= sampled_info(self.choices, state)
        return info

    def options(self) -> dict[str, Any]:
        """Return the task's fields by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), **self.options()), ()  # its model is built again


def coordinates(quantity: str, values: np.ndarray, axes: str) -> dict[str, np.ndarray]:
    """Return entries of `info`, such as `x_position`, for copies of columns of shape (n, k)."""
    return {f"{axis}_{quantity}": values[:, k].copy() for k, axis in enumerate(axes)}


tasks: Registry[type[Task]] = Registry("environment")
"""Tasks by the names in their ids: `ChainSwim` for `mjgranular/ChainSwim-v0`."""


def get_task(task: str | Task, options: dict[str, Any]) -> Task:
    """Return a task from its name and its options, with a model that no other simulation has."""
    if isinstance(task, Task):
        if options:
            raise InputError(f"a task has its options already: {', '.join(options)}")
        return replace(task)
    cls = tasks[task]
    known = [item.name for item in fields(cls)]
    for name in options:
        if name not in known:
            raise InputError(f"{task} has no option {name!r}; it has: {', '.join(known)}")
    return cls(**options)


def check_actions(actions: Any, shape: tuple[int, ...] | None) -> np.ndarray:
    """Return actions as an array."""
    array = np.asarray(actions)
    if array.shape != shape:
        raise InputError(f"Action dimension mismatch. Expected {shape}, found {array.shape}")
    if array.dtype.kind not in "fiub":
        raise InputError(f"an action must be real numbers, not {array}")
    # The sum is faster, and finite if all are, unless they are enormous.
    if not math.isfinite(array.sum()) and not np.isfinite(array).all():
        raise InputError(f"an action must be finite, not {array}")
    return array


def check_number(name: str, value: Any) -> None:
    """Check that a value is a finite number."""
    if not isinstance(value, Real) or isinstance(value, bool) or not math.isfinite(value):
        raise InputError(f"{name} must be a finite number, not {shown(value)}")


def check_option(name: str, value: Any, default: Any) -> None:
    """Check that a value has the type of the default: a boolean, a number, a range."""
    if isinstance(default, bool):
        check_switch(name, value)
    elif isinstance(default, (int, float)):
        check_number(name, value)
        if name.endswith("_scale") and value < 0:
            raise InputError(f"{name} must not be negative, not {shown(value)}")
    elif _is_range(default):
        if not _is_range(value):
            raise InputError(f"{name} must be a range, (low, high), not {shown(value)}")
        if value[0] > value[1]:
            raise InputError(f"{name} must be a range with its low end first, not {shown(value)}")


def _is_range(value: Any) -> bool:
    """Return True if a value is two numbers, which may be infinite."""
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        return False
    return all(isinstance(one, Real) and not math.isnan(one) for one in value)
