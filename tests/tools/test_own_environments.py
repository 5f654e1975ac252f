"""Environments of a user's own: found beside him, on sand, in processes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mjgranular._util.user_modules import import_own
from mjgranular.cli import main
from mjgranular.envs import on_sand
from mjgranular.errors import UnknownArgumentError, UnknownNameError
from mjgranular.learn import environments
from mjgranular.learn.settings import change, find_settings

# A robot of somebody's own, beside a helper of his: two legs' worth of hopper.
HELPER = 'NAME = "MyQuadSand-v0"\n'
MODULE = """
from pathlib import Path
import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.mujoco import MujocoEnv
from my_helper import NAME

MODEL = Path(__file__).with_name("my_quad.xml")


class MyQuad(MujocoEnv):
    metadata = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"]}

    def __init__(self, reward=1.0, **kwargs):
        space = spaces.Box(-np.inf, np.inf, (4,), np.float64)
        self.reward = reward
        super().__init__(str(MODEL), 5, observation_space=space, **kwargs)

    def step(self, action):
        self.do_simulation(action, self.frame_skip)
        return self._get_obs(), self.reward * self.data.qvel[0], False, False, {}

    def reset_model(self):
        self.set_state(self.init_qpos, 0.1 * self.np_random.standard_normal(2))
        return self._get_obs()

    def _get_obs(self):
        return np.concatenate([self.data.qpos, self.data.qvel])


def sandy(**kwargs):
    from mjgranular.envs import on_sand

    return on_sand(MyQuad, bodies="trunk", max_episode_steps=20, **kwargs)


gym.register("MyQuad-v0", entry_point="my_quad:MyQuad", max_episode_steps=20)
gym.register("MyQuadClass-v0", entry_point=MyQuad)
gym.register(NAME, entry_point=sandy, max_episode_steps=20)
"""
MODEL = """
<mujoco>
  <option timestep="0.01" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="trunk" pos="0 0 0.1">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom name="trunk" type="capsule" size="0.05 0.1" euler="90 0 0" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor joint="x" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
OWN = "my_quad:MyQuadSand-v0"


@pytest.fixture
def beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder with the module, the current one."""
    for name, text in (
        ("my_quad.py", MODULE),
        ("my_helper.py", HELPER),
        ("my_quad.xml", MODEL),
        ("script.py", "raise SystemExit('usage')\n"),
        ("needy.py", "import nowhere_to_be_found\n"),
    ):
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    return tmp_path


def few(*changes: str) -> Any:
    given = ("num_envs=2", "total_steps=128", "n_steps=32", "batch_size=32", "n_epochs=1")
    return change(find_settings(OWN, algorithm="ppo"), (*given, *changes))


@pytest.mark.slow
def test_the_command_finds_what_lies_beside_the_user(beside: Path) -> None:
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        # As the command is installed: its own folder is on the path, the current one is not.
        script = "import sys; from mjgranular.cli import main; sys.exit(main(sys.argv[1:]))"
        return subprocess.run(
            [sys.executable, "-P", "-c", script, *arguments],
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )

    changes = ("num_envs=2", "n_steps=32", "batch_size=32", "n_epochs=1")
    done = run("train", OWN, "--total-steps", "64", "--set", *changes, "--json")
    assert done.returncode == 0, done.stderr
    done = run("evaluate", OWN, "--agent", "zero", "--seeds", "2", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)[0]["length"]["mean"] == 20


@pytest.mark.parametrize("named", ["my_quad:MyQuad-v0", "my_quad:MyQuadClass-v0", "class"])
def test_an_environment_of_ones_own_is_put_on_sand(beside: Path, named: str) -> None:
    given = import_own("my_quad", "a test").MyQuad if named == "class" else named
    env = on_sand(given, bodies="trunk", reward=2.0, medium="poppy_seed_loose")
    _, info = env.reset(seed=0)
    assert info["sand/depth"] == pytest.approx(-0.05, abs=0.01)
    assert env.unwrapped.reward == 2.0
    for _ in range(19):
        *_, info = env.step(np.zeros(1))
    assert info["sand/force"][2] > 1.0
    with pytest.raises(UnknownArgumentError, match=r"'rewrad'.*did you mean reward"):
        on_sand(given, rewrad=2.0)


def test_what_was_searched_is_said(beside: Path) -> None:
    with pytest.raises(UnknownNameError) as caught:
        environments.find_spec("my_qaud:MyQuadSand-v0")
    said = str(caught.value)
    assert "no module 'my_qaud'; there are: my_helper, my_quad, needy, script" in said
    assert "did you mean my_quad?" in said
    assert "for the environment my_qaud:MyQuadSand-v0 was searched: what is inst" in said
    assert f"and the current folder, {beside}" in said


@pytest.mark.parametrize(
    ("named", "said"),
    [
        ("my_quad:MyQuadSnd-v0", "importing my_quad has registered no MyQuadSnd-v0"),
        ("my_quad:MyQuadSnd-v0", "did you mean MyQuadSand-v0"),
        ("my_quad:", "lacks the id behind the colon"),
        (":MyQuad-v0", "name it as in an import, my_module"),
        ("my_quad", "is named with its module, my_module:My-v0"),
        ("needy:A-v0", "it needs nowhere_to_be_found, which is not installed"),
        ("script:A-v0", '__name__ == "__main__"'),
    ],
)
def test_other_slips_with_a_module(
    beside: Path, capsys: pytest.CaptureFixture[str], named: str, said: str
) -> None:
    for command in (["train", named], ["evaluate", named, "--agent", "zero"]):
        assert main(command) == 2
        assert said in capsys.readouterr().err


def test_nothing_beside_takes_the_place_of_what_is_installed(beside: Path) -> None:
    (beside / "colorsys.py").write_text("raise RuntimeError\n", encoding="utf-8")
    sys.modules.pop("colorsys", None)
    assert Path(import_own("colorsys", "a test").__file__).parent != beside
