"""Environments that observe their own sensors see those, and nothing beside them, on sand."""

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.mujoco import MujocoEnv

from mjgranular.envs import on_sand

XML = """
<mujoco>
  <option timestep="2e-3"/>
  <worldbody>
    <geom name="floor" type="plane" size="3 3 .1"/>
    <body name="block" pos="0 0 0.04"><freejoint/>
      <geom type="box" size=".1 .05 .03"/><site name="s"/>
      <body name="arm"><joint name="j" axis="0 1 0"/><geom size=".02" pos=".15 0 0"/></body></body>
  </worldbody>
  <actuator><motor joint="j" ctrlrange="-1 1"/></actuator>
  <sensor><accelerometer site="s"/><gyro site="s"/><jointpos joint="j"/></sensor>
</mujoco>
"""


class Sensing(MujocoEnv):
    metadata: ClassVar[Any] = {  # pyright: ignore[reportIncompatibleVariableOverride]
        "render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"],
    }

    def __init__(self, path, **options):
        super().__init__(str(path), 5, None, **options)
        size = (self.model.nsensordata,)
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, size, np.float64)

    def reset_model(self):
        self.set_state(self.init_qpos, self.init_qvel)
        return self.data.sensordata.copy()

    def step(self, action) -> Any:
        self.do_simulation(action, self.frame_skip)
        return self.data.sensordata.copy(), 0.0, False, False, {}


@pytest.fixture
def environment(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(XML)
    gym.register("Sensing-v0", entry_point=Sensing, kwargs={"path": path})
    yield "Sensing-v0"
    gym.registry.pop("Sensing-v0")


def test_observed_sensors_are_the_environments_own(environment, monkeypatch):
    import mjgranular.envs.robots as robots

    monkeypatch.setattr(robots, "creator_of", lambda _: Sensing)
    env = on_sand(environment)
    bare = env.unwrapped
    observation, info = env.reset(seed=0)
    assert bare.model.nsensordata == observation.size == 7
    for _ in range(40):
        observation, *_, info = env.step(np.zeros(1))
    assert env.observation_space.contains(observation)
    assert observation[:3] == pytest.approx([0, 0, 9.81], abs=0.3)
    weight = 9.81 * bare.model.body_mass.sum()
    assert info["sand/force"] == pytest.approx([0, 0, weight], abs=0.05 * weight)
    assert bare.data.cfrc_ext[1:, 3:].sum(axis=0) == pytest.approx(info["sand/force"])
    env.close()
