"""An agent in real time, at commands of a user."""

from typing import Any

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.learn.agents import Agent
from mjgranular.picture.viewer import Command


class Live:
    """An agent in an environment, episode after episode, without a limit of time.

    Args:
        env: the environment, of the package or a `MujocoEnv` of Gymnasium.
        agent: the agent.
        seed: seed of the first episode.

    Attributes:
        model: the environment's model.
        data: its simulation.
        camera: settings of a camera, as in Gymnasium.
        command: the velocity that the robot is to have; None if its task has no commands.
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
        """Begin an episode."""
        self._observation, _ = self._env.reset(seed=seed)
        self._steps = 0

    def step(self) -> None:
        """Advance by a step of the environment."""
        if self.command is not None:
            self._task.set_command(self._env.unwrapped.state, self.command.values)
        action = self._agent.act(self._observation[None], np.array([self._steps]))[0]
        self._observation, _, terminated, truncated, _ = self._env.step(action)
        self._steps += 1
        if terminated or truncated:
            self.restart()
