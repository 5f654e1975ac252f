"""Gymnasium's robots on sand."""

import inspect
from collections.abc import Callable
from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.envs.registration import EnvSpec

from mjgranular._util.checks import check_count
from mjgranular.engine import rne_post_constraint
from mjgranular.engine.instances import sands_in
from mjgranular.engine.sensor import SandReadings
from mjgranular.envs.cameras import check_camera, check_mode, check_screen
from mjgranular.envs.figures import BAD, Figures
from mjgranular.envs.ground import put_on_sand, quiet
from mjgranular.envs.ids import creator_of, find_spec
from mjgranular.envs.ranges import Sample, SandRanges, choices_of, ranges_of, sampled_info
from mjgranular.envs.single import first_of
from mjgranular.errors import InputError, UnknownArgumentError, UnknownNameError, loading
from mjgranular.sand.spec import SAND_FIELDS, SandSpec, combined

ROBOT_SAND = SandSpec(medium="quikrete_medium", resolution=4)
"""The default sand. Its resolution is chosen: docs/environments.md has cost and accuracy."""


def on_sand(
    environment: str | type[MujocoEnv],
    sand: SandSpec = ROBOT_SAND,
    *,
    randomise: SandRanges | None = None,
    curriculum: Callable[[int], SandRanges] | None = None,
    **options: Any,
) -> gym.Env:
    """Make a Gymnasium MuJoCo environment with sand in place of its floor.

    Observation, reward, start and end are those of the environment. The differences:

    - the floor makes no contact; the sand acts at every substep, as an engine plugin;
    - a model with RK4 is integrated with `implicitfast`, so that sand can hold a body at rest;
    - `cfrc_ext`, which some environments observe or penalize, includes the sand's forces;
    - `info` has the sand's metrics (docs/environments.md); what diverges ends its episode.

    Args:
        environment: a class that derives from `MujocoEnv`, or the id of an environment of such a
            class, from Gymnasium or custom (`my_module:My-v0` imports the module).
        sand: the sand; without a surface it is the level plane where the floor was. It always
            replaces the floor; `instead_of` names other geoms. The default is Quikrete medium sand,
            with a coarse, fast resolution; with only a law's name, the medium follows from it.
        randomise: ranges of the sand of each episode; None for a fixed sand. Dunes are only for
            mjgranular's environments: Gymnasium's robots start at a fixed height.
        curriculum: returns the ranges for the next episode, given the number of episodes begun.
        **options: fields of `mjgranular.SandSpec`, which replace those of `sand`; others are
            options of the environment or of `gymnasium.make`.

    Returns:
        The environment with the wrappers of `gymnasium.make`.

    Raises:
        UnknownNameError: no such environment; lists Gymnasium's MuJoCo robots.
        UnknownArgumentError: an option of neither the sand, nor the environment.
        InputError: an environment that is not a `MujocoEnv`, that makes its simulation itself, or
            has no floor if no surface is given; or an error from `add_sand`.
    """
    spec = _find(environment)
    _check_options(spec, options)
    for name in ("frame_skip", "width", "height"):
        if name in options:
            check_count(name, options[name])
    fields: Any = {name: options.pop(name) for name in SAND_FIELDS if name in options}
    if sand is ROBOT_SAND and isinstance(fields.get("law"), (str, type)):
        fields.setdefault("medium", None)  # it follows from the law
    drawn = {"randomise": randomise, "curriculum": curriculum}
    described = {**vars(combined(sand, fields)), **drawn}
    ours = EnvSpec(
        id=spec.id.replace("-v", "OnSand-v") if spec.version is not None else f"{spec.id}OnSand",
        entry_point="mjgranular.envs.robots:make_robot",
        reward_threshold=None,  # the threshold for rigid ground does not apply
        max_episode_steps=spec.max_episode_steps,
        kwargs={**spec.kwargs, "environment": spec.entry_point, "sand": described},
    )
    return gym.make(ours, **options)


def make_robot(environment: str | type, sand: dict[str, Any], **options: Any) -> gym.Env:
    """Make the environment without wrappers; see `on_sand`.

    The environment is a class, or `module:Class`, which worker processes can import.
    """
    return _sandy(creator_of(environment), environment)(sand, **options)


@cache  # by class: a module that is imported again has another class of the same name
def _sandy(base: Any, environment: str | type) -> "type[OnSand]":
    return type(f"{base.__name__}OnSand", (OnSand, base), {"environment": environment})


_OF_MUJOCO = tuple(inspect.signature(MujocoEnv).parameters)  # what a class passes on to it


class OnSand(MujocoEnv):
    """Sand for a Gymnasium environment; `sand` has the arguments of `on_sand` for it.

    `sands` are those in the model, in the order of their instances.
    """

    environment: str | type

    def __init__(self, sand: dict[str, Any], **options: Any) -> None:
        self._made_of = sand, options
        base = dict(sand)
        self._curriculum = base.pop("curriculum", None)
        self._ranges = ranges_of(base.pop("randomise", None), self._curriculum, base.get("memory"))
        if self._ranges is not None and "dunes" in self._ranges.surfaces:
            raise InputError(
                "on_sand draws no dunes, because Gymnasium's robots start at their own height: "
                "take an environment of mjgranular's, or a surface of the model's own"
            )
        self._choices = choices_of(self._ranges, SandSpec(**base), None)
        self.sands = [choice.sand for choice in self._choices]
        self._drawn, self._episodes = Sample(), 0
        check_mode(options.get("render_mode"), self.metadata["render_modes"])
        check_screen(options.get("render_mode"))
        super().__init__(**options)
        check_camera(self.model, options.get("camera_name"))

    def __reduce__(self) -> tuple[Any, ...]:
        sand, options = self._made_of
        return partial(make_robot, **options), (self.environment, sand)

    def _initialize_simulation(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        with quiet():
            spec = mujoco.MjSpec.from_file(self.fullpath)
            tunable = self._ranges is not None
            # Sensors would lengthen `sensordata`, which an environment may observe.
            model = put_on_sand(spec, self.sands, sensors=False, tunable=tunable)
        screen = model.vis.global_
        screen.offwidth = max(screen.offwidth, self.width)
        screen.offheight = max(screen.offheight, self.height)
        self._readings = SandReadings(model, sands_in(model))
        self._figures = Figures(model, self.sands, self._readings)
        with loading(self.fullpath):
            return model, mujoco.MjData(model)

    def _step_mujoco_simulation(self, ctrl: np.ndarray, n_frames: int) -> None:
        super()._step_mujoco_simulation(ctrl, n_frames)
        # There Gymnasium calls MuJoCo's own function, which omits the sand.
        rne_post_constraint(self.model, self.data)

    def reset_model(self) -> Any:
        if self._ranges is not None:
            ranges = self._ranges.in_episode(self._curriculum, self._episodes)
            self._drawn = ranges.draw(self._choices, self.np_random)
            state, gravity = self.data.plugin_state, self.model.opt.gravity
            self._drawn.lay(self.model, self._figures, state, gravity)
        self._episodes += 1
        return super().reset_model()

    def step(self, action: Any) -> Any:
        observation, reward, terminated, truncated, info = super().step(action)
        lost = bool(self.data.warning.number[BAD].any())
        info |= self.sand_figures() | {"sand/lost": lost}
        return observation, 0.0 if lost else reward, terminated or lost, truncated, info

    def _get_reset_info(self) -> dict[str, Any]:
        return super()._get_reset_info() | self.sand_figures()

    def sand_figures(self) -> dict[str, Any]:
        """Return the current metrics of the sand; see `Figures.read`."""
        drawn = SimpleNamespace(**{k: np.array([value]) for k, value in vars(self._drawn).items()})
        read = self._figures.read(self._readings.read(self.data), drawn.active, drawn.slope)
        if self._ranges is not None:
            read |= sampled_info(self._choices, drawn)
        return first_of(read)


def _find(environment: Any) -> EnvSpec:
    """Return the specification of an environment whose class supports sand."""
    if isinstance(environment, gym.Env):
        raise InputError(
            "on_sand makes the environment itself, from its class or its id, not of one that is "
            f"made already: on_sand({environment.spec.id if environment.spec else 'its id'!r})"
        )
    if isinstance(environment, type):
        spec = EnvSpec(environment.__name__, environment)
    else:
        try:
            spec = find_spec(environment)
        except UnknownNameError as error:
            if error.kind != "environment":  # but for a module
                raise
            raise UnknownNameError("environment", environment, _robots(), error.hint) from None
    base = creator_of(spec.entry_point)
    if not (isinstance(base, type) and issubclass(base, MujocoEnv)):
        raise InputError(
            f"{spec.id} is not one of Gymnasium's MuJoCo environments: on_sand takes classes that "
            f"derive from MujocoEnv, such as {', '.join(_robots())}; for any other there is "
            "add_sand, for its MjSpec"
        )
    if base._initialize_simulation is not MujocoEnv._initialize_simulation:
        raise InputError(
            f"{spec.id} has its own _initialize_simulation, which on_sand replaces: change the "
            "model in its file, or in __init__ after super().__init__()"
        )
    return spec


def _check_options(spec: EnvSpec, options: dict[str, Any]) -> None:
    own = inspect.signature(creator_of(spec.entry_point)).parameters
    taken = {*SAND_FIELDS, *own, *inspect.signature(gym.make).parameters, *_OF_MUJOCO}
    for name in options:
        if name not in taken:
            known = [*SAND_FIELDS, *(one for one in own if one not in ("args", "kwargs"))]
            raise UnknownArgumentError(f"on_sand({spec.id})", name, known)


def _robots() -> list[str]:
    """Return the ids of Gymnasium's MuJoCo environments, latest versions only."""
    begin = "gymnasium.envs.mujoco."
    return [
        name
        for name, spec in gym.registry.items()
        if str(spec.entry_point).startswith(begin) and name.endswith("-v5")
    ]
