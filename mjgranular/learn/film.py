"""Episodes of an agent: as a film, or in real time at commands of a user."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from mjgranular.errors import InputError, drawing
from mjgranular.learn import environments
from mjgranular.learn.evaluate import Agent
from mjgranular.picture.video import Film
from mjgranular.picture.viewer import Command


def frames_of_episode(
    env_id: str,
    arguments: Mapping[str, Any],
    make_agent: Callable[[Any], Agent],
    film: Film,
    *,
    seed: int,
    camera: str | None,
) -> tuple[Film, int, Iterator[np.ndarray]]:
    """Return the frames of an episode in real time, from its beginning, for `film.seconds` at most.

    Returns:
        The film with the size and rate of the frames, their largest number, and the frames.
    """
    env = environments.for_filming(
        env_id, arguments, width=film.width, height=film.height, camera=camera
    )
    with ExitStack() as until_made:
        until_made.callback(env.close)
        step_time = getattr(env.unwrapped, "dt", None)
        rate = 1 / step_time if step_time else env.metadata.get("render_fps") or film.fps
        every = max(1, math.ceil(rate / film.fps))  # steps from one frame to the next
        steps = math.ceil(film.seconds * rate)
        observation, _ = env.reset(seed=seed)
        first = _frame(env)
        height, width = first.shape[:2]
        agent = make_agent(env)
        until_filmed = until_made.pop_all()

    def frames(observation: np.ndarray) -> Iterator[np.ndarray]:
        with until_filmed:
            yield first
            for step in range(steps):
                action = agent.act(observation[None], np.array([step]))[0]
                observation, _, terminated, truncated, _ = env.step(action)
                if (step + 1) % every == 0:
                    yield _frame(env)
                if terminated or truncated:
                    break

    shown = replace(film, width=width, height=height, fps=rate / every)
    return shown, 1 + steps // every, frames(observation)


def _frame(env: Any) -> np.ndarray:
    with drawing("the environment cannot be drawn"):
        return np.asarray(env.render(), dtype=np.uint8)


class Live:
    """An agent in an environment, episode after episode, without a limit of time.

    The environment, of the package or a `MujocoEnv` of Gymnasium, has the `model`, the `data` and
    the settings of the `camera`. `seed` is of the first episode; `command` is the velocity that the
    robot is to have, None if its task has no commands.
    """

    def __init__(self, env: Any, agent: Agent, seed: int) -> None:
        self._env, self._agent, bare = env, agent, env.unwrapped
        self.model, self.data = getattr(bare, "model", None), getattr(bare, "data", None)
        if not (isinstance(self.model, mujoco.MjModel) and isinstance(self.data, mujoco.MjData)):
            raise InputError("only environments of MuJoCo are shown so: use `render` for films")
        self._task: Any = getattr(bare, "task", None)
        renderer = getattr(bare, "mujoco_renderer", None)
        self.camera = (
            getattr(self._task, "camera", getattr(renderer, "default_cam_config", None)) or {}
        )
        self.command: Command | None = None
        if hasattr(self._task, "set_command"):
            limits = self._task.command_x, self._task.command_y, self._task.command_yaw
            self.command = Command(limits)
        self.restart(seed)

    def restart(self, seed: int | None = None) -> None:
        self._observation, _ = self._env.reset(seed=seed)
        self._steps = 0

    def step(self) -> None:
        if self.command is not None:
            self._task.set_command(self._env.unwrapped.state, self.command.values)
        action = self._agent.act(self._observation[None], np.array([self._steps]))[0]
        self._observation, _, terminated, truncated, _ = self._env.step(action)
        self._steps += 1
        if terminated or truncated:
            self.restart()
