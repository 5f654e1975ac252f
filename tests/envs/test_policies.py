"""The policies that come with the package: they load, act, and do what their page says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mjgranular.envs.single import SandEnv
from mjgranular.envs.velocity import G1Velocity, Go1Velocity, Go2Velocity
from mjgranular.learn import environments
from mjgranular.learn.evaluate import FIRST_SEED, Agent, make_baseline
from mjgranular.learn.policies import POLICY_FILES, load_policy, shipped_policies

# Another MuJoCo than the one they were trained with is warned of; what they do is to be the same.
pytestmark = pytest.mark.filterwarnings(
    "ignore:.*was trained with MuJoCo:mjgranular.errors.GranularWarning"
)

SHIPPED = shipped_policies()


class Straight(Go1Velocity):
    """Its commands are those of the ranges, for the whole episode."""

    def _draw_commands(self, random):
        table = super()._draw_commands(random)
        table[:, 0] = 0.0
        table[:, 1:] = self.command_x[0], self.command_y[0], self.command_yaw[0]
        return table


class StraightGo2(Straight, Go2Velocity):
    """The same with the other robot."""


class StraightG1(Straight, G1Velocity):
    """The same on two legs."""


STEPS = 100  # of 500: four seconds

# The best of `search_gaits(..., count=200, by="x_velocity")` (docs/training.md).
BEST_GAITS = {
    "ChainSwim": {"amplitude": 1.0, "frequency": 1.6, "waves": 0.5},
    "ChainCrawl": {"amplitude": 0.733, "frequency": 0.5, "waves": 0.667, "offset": 0.133},
    "Hexapod": {"stride": 1.0, "lift": 1.0, "press": 0.0, "frequency": 3.25, "duty": 0.7},
}


def way(
    env_id: str, agent: Agent | None, gait: dict[str, float] | None = None, **arguments: str
) -> float:
    """How far an agent, or a gait, comes along x in the first steps of an episode [m]."""
    env = environments.several(env_id, arguments, num_envs=2)
    try:
        if agent is None:
            agent = make_baseline("gait", env_id, env, gait=gait)
        observations, _ = env.reset(seed=[FIRST_SEED, FIRST_SEED + 1])
        total = np.zeros(2)
        for step in range(STEPS):
            actions = agent.act(observations, np.full(2, step))
            observations, _, ended, _, info = env.step(actions)
            assert not ended.any()
            total += info["x_velocity"] * env.unwrapped.task.dt
    finally:
        env.close()
    return float(total.mean())


def first_of(robot: str) -> str:
    """The first policy of a robot."""
    return min(name for name in SHIPPED if name.startswith(f"{robot}-v0/"))


def test_there_are_three_policies_for_each_of_five_robots_and_some_that_follow_commands():
    robots = sorted(name.partition("-v0/")[0] for name in SHIPPED)
    three = ["ChainSwim", "ChainCrawl", "Hexapod", "Hopper", "Ant"]
    assert robots == sorted([*3 * three, *3 * ["Go1Velocity"], "Go2Velocity", "G1Velocity"])


@pytest.mark.parametrize("robot", ["ChainSwim", "ChainCrawl", "Hexapod", "Hopper", "Ant"])
def test_a_policy_acts_on_its_environment(robot):
    policy = load_policy(first_of(robot))
    env = environments.one(policy.run.environment, policy.run.settings.environment)
    policy.checked(policy.run.environment, env)
    observation, _ = env.reset(seed=0)
    (action,) = policy.act(observation[None], np.zeros(1))
    assert env.action_space.contains(action)
    assert np.abs(action).max() > 0.01
    env.close()


@pytest.mark.parametrize("name", SHIPPED)
def test_a_policy_is_small_and_names_no_machine(name):
    folder = SHIPPED[name].path
    assert {file.name for file in folder.iterdir()} == set(POLICY_FILES)
    assert sum(file.stat().st_size for file in folder.iterdir()) < 400_000
    assert load_policy(name).run.environment == f"mjgranular/{Path(name).parent}"
    config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
    assert config["versions"]["platform"] == "Linux"
    assert Path(name).name == f"{config['settings']['algorithm']}-{config['seed']}"


@pytest.mark.parametrize("robot", BEST_GAITS)
def test_policies_are_faster_than_the_best_of_a_search_among_gaits(robot):
    env_id = f"mjgranular/{robot}-v0"
    scripted = way(env_id, None, BEST_GAITS[robot])
    assert scripted > 0
    # 17 % for the swimmer, which was trained on drawn sand.
    assert way(env_id, load_policy(first_of(robot))) > 1.1 * scripted


def test_the_hopper_hops_and_the_ant_runs():
    # In the first 0.8 s and 5 s: standing would be no way at all.
    assert way("mjgranular/Hopper-v0", load_policy("Hopper-v0/ppo-0")) > 0.5
    assert way("mjgranular/Ant-v0", load_policy("Ant-v0/ppo-0")) > 10.0


def walk(policy, env, steps):
    """Return velocities ahead, to the left and in yaw, after the first 50 steps; without a fall."""
    observation, _ = env.reset(seed=0)
    found = []
    for step in range(steps):
        (action,) = policy.act(observation[None], np.array([step]))
        observation, _, terminated, _, info = env.step(action)
        assert not terminated
        found.append([*info["velocity"][:2], observation[5]])
    return np.mean(found[50:], axis=0)


@pytest.mark.usefixtures("robots")
@pytest.mark.parametrize("ground", [{}, {"rigid": np.inf}])
@pytest.mark.parametrize(
    "name",
    [
        "Go1Velocity-v0/ppo-0",
        "Go1Velocity-v0/ppo-1",
        "Go1Velocity-v0/ppo-6",
        "Go2Velocity-v0/ppo-2",
    ],
)
def test_a_robot_follows_commands_on_sand_and_on_a_floor(name, ground):
    policy = load_policy(name)
    robot = {"Go1": Straight, "Go2": StraightGo2}[name[:3]]
    history = policy.run.settings.environment.get("history", 0)
    for command in ((0.6, 0.0, 0.0), (0.4, 0.0, 0.6), (0.0, 0.0, 0.0)):
        names = ("command_x", "command_y", "command_yaw")
        fixed = {name: (value, value) for name, value in zip(names, command, strict=True)}
        env = SandEnv(robot(**fixed, push_scale=0.0, history=history, **ground))
        assert walk(policy, env, 150) == pytest.approx(command, abs=0.15)


@pytest.mark.usefixtures("robots")
def test_the_go2_keeps_its_trunk_out_of_weak_sand():
    policy = load_policy("Go2Velocity-v0/ppo-2")
    ahead = {"command_x": (0.6, 0.6), "command_y": (0.0, 0.0), "command_yaw": (0.0, 0.0)}
    env = SandEnv(StraightGo2(**ahead, medium="yuma_sand", push_scale=0.0, history=4))
    assert walk(policy, env, 250)[0] == pytest.approx(0.6, abs=0.15)


@pytest.mark.usefixtures("robots")
@pytest.mark.parametrize("medium", ["quikrete_medium", "yuma_sand"])
def test_a_robot_on_two_legs_walks_at_once_in_weak_sand(medium):
    policy = load_policy("G1Velocity-v0/ppo-12")
    weak = {"strength": (0.5, 0.5) if medium == "quikrete_medium" else (1.0, 1.0)}
    still = {"command_x": (0.5, 0.5), "command_yaw": (0.0, 0.0), "push_scale": 0.0}
    env = SandEnv(StraightG1(medium=medium, randomise=weak, history=4, **still))
    assert 0.2 < walk(policy, env, 250)[0] < 0.6
