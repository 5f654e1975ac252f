"""A custom environment: the quad of quad.xml, on its floor and on sand."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.spaces import Box

from mjgranular.envs import on_sand


class MyQuad(MujocoEnv):
    """Walk ahead: a reward for speed, a cost of effort, an end when the torso is down."""

    metadata: ClassVar = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"]}

    def __init__(self, **options: Any) -> None:
        space = Box(-np.inf, np.inf, (27,), np.float64)
        model = str(Path(__file__).with_name("quad.xml"))
        super().__init__(model, frame_skip=10, observation_space=space, **options)
        self.metadata = {**self.metadata, "render_fps": round(1 / self.dt)}

    def _observation(self) -> np.ndarray:
        return np.concatenate([self.data.qpos[2:], self.data.qvel])

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        before = self.data.qpos[0]
        self.do_simulation(action, self.frame_skip)
        speed = (self.data.qpos[0] - before) / self.dt
        reward = speed + 0.2 - 0.05 * float(np.square(action).sum())
        fallen = bool(self.data.qpos[2] < 0.15)
        return self._observation(), reward, fallen, False, {"x_velocity": speed}

    def reset_model(self) -> np.ndarray:
        tremble = 0.01 * self.np_random.standard_normal(self.model.nq)
        self.set_state(self.init_qpos + tremble, self.init_qvel)
        return self._observation()


def quad_on_sand(**options: Any) -> gym.Env:
    """The same on sand; arguments as for `on_sand`."""
    return on_sand("my_quad/Quad-v0", **options).unwrapped


gym.register("my_quad/Quad-v0", "my_quad:MyQuad", max_episode_steps=500)
gym.register("QuadOnSand-v0", "my_quad:quad_on_sand", max_episode_steps=500)
