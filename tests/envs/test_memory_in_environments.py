"""Environments on sand that remembers: batches, resets, pictures of the state."""

from __future__ import annotations

import json
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest

from mjgranular import Memory
from mjgranular.cli import main
from mjgranular.engine import relief_of
from mjgranular.envs import SandEnv, SandRanges, SandVectorEnv, on_sand
from mjgranular.envs.ids import id_of
from mjgranular.errors import InputError
from mjgranular.learn.evaluate import parse_variant

pytest.importorskip("mujoco.batch", reason="a MuJoCo without batches")

MEMORY = Memory(cell=0.02, extent=3.0)
ROBOTS = ["Hexapod", pytest.param("Hopper", marks=pytest.mark.slow)]
ROBOTS += [pytest.param("Ant", marks=pytest.mark.slow)]


def played(env: Any, steps: int, seed: int) -> list[np.ndarray]:
    """Observations of an episode of random actions, and what the sand remembers at its end."""
    observation, _ = env.reset(seed=seed)
    env.action_space.seed(seed)
    found = [observation]
    for _ in range(steps):
        found.append(env.step(env.action_space.sample())[0])
    return [*found, env.unwrapped.data.plugin_state.copy()]


@pytest.mark.parametrize("name", ROBOTS)
def test_memory_is_an_option_and_a_reset_clears_the_prints(name: str) -> None:
    env = SandEnv(name, memory=MEMORY)
    env.action_space.seed(0)
    first = played(env, 40, 3)
    assert relief_of(env.model, env.data).height.min() < -0.002
    env.reset(seed=4)
    assert not relief_of(env.model, env.data).height.any()
    for one, other in zip(played(env, 40, 3), first, strict=True):
        np.testing.assert_array_equal(one, other)
    env.close()


def test_prints_are_felt() -> None:
    plain, remembering = (SandEnv("Hexapod", memory=memory) for memory in (None, MEMORY))
    first, second = (played(env, 60, 0)[-2] for env in (plain, remembering))
    assert np.isfinite(second).all()
    assert not np.array_equal(first, second)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_batch_is_the_single_environments_to_the_last_bit(name: str) -> None:
    options = {"memory": MEMORY, "max_episode_steps": 25}
    sync = gym.make_vec(id_of(name), num_envs=3, vectorization_mode="sync", **options)
    batch: Any = gym.make_vec(
        id_of(name), num_envs=3, vectorization_mode="vector_entry_point", **options
    )
    assert isinstance(batch.unwrapped, SandVectorEnv)
    np.testing.assert_array_equal(sync.reset(seed=7)[0], batch.reset(seed=7)[0])
    sync.action_space.seed(0)
    for _ in range(60):  # over two resets
        actions = sync.action_space.sample()
        for one, other in zip(sync.step(actions)[:4], batch.step(actions)[:4], strict=True):
            np.testing.assert_array_equal(one, other)
    assert np.asarray(batch.unwrapped._plugin_state)[:, 20:].any()


def test_stable_baselines_batch_takes_memory() -> None:
    from mjgranular.envs.sb3 import make_vec_env

    vec = make_vec_env(id_of("Hexapod"), 2, seed=0, memory=0.02)
    observations = vec.reset()
    for _ in range(3):
        observations, *_ = vec.step(np.zeros((2, 12), np.float32))
    assert np.isfinite(observations).all()
    vec.close()


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("memory=true", Memory()),
        ("memory=0.02", Memory(cell=0.02)),
        ('memory="cell=0.02 extent=3"', MEMORY),
    ],
)
def test_a_variant_of_an_evaluation_may_have_memory(given: str, expected: Memory) -> None:
    options = parse_variant(given)
    model = SandEnv("Hexapod", **options).model
    assert model.npluginstate == expected.state_size


@pytest.mark.slow
def test_an_agent_is_evaluated_with_memory(capsys: Any) -> None:
    command = ["evaluate", id_of("Hexapod"), "--agent", "gait", "--on", "memory=0.02"]
    assert main([*command, "--seeds", "2", "--json"]) == 0
    own, remembering = json.loads(capsys.readouterr().out)
    assert remembering["variant"] == "memory=0.02"
    assert remembering["return"]["mean"] != own["return"]["mean"]


@pytest.mark.slow
def test_state_of_an_environment_is_saved_and_restored() -> None:
    env = SandEnv("Hexapod", memory=MEMORY)
    played(env, 30, 0)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    saved = np.zeros(mujoco.mj_stateSize(env.model, kind))
    mujoco.mj_getState(env.model, env.data, saved, kind)
    actions = [env.action_space.sample() for _ in range(20)]
    first = [env.step(action)[0] for action in actions]
    env.reset(seed=1)
    mujoco.mj_setState(env.model, env.data, saved, kind)
    for action, expected in zip(actions, first, strict=True):
        np.testing.assert_array_equal(env.step(action)[0], expected)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["Ant-v5", "HalfCheetah-v5", "Hopper-v5"])
def test_a_memory_is_as_large_as_the_robot_needs(robot: str) -> None:
    """Without a word of how far it is to reach: room for the torso's surroundings, and for all."""
    env = on_sand(robot, memory=0.02)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    model = env.unwrapped.model
    reach = {"Ant-v5": 2.9, "HalfCheetah-v5": 2.0, "Hopper-v5": 2.0}[robot]
    assert model.npluginstate == Memory(0.02, extent=reach).state_size


def test_sand_with_memory_is_not_drawn_and_empty_ranges_say_so() -> None:
    env = SandEnv("Hexapod", memory=MEMORY, randomise={})  # as `render --on` of a shipped policy
    env.reset(seed=0)
    env.close()
    with pytest.raises(InputError, match="cannot be drawn"):  # nor does a curriculum
        SandEnv("Hexapod", memory=MEMORY, randomise={}, curriculum=lambda _: SandRanges())
    for name in ("Hexapod", "Ant-v5"):
        with pytest.raises(InputError, match=r"use randomise=\{\}"):
            (SandEnv if name == "Hexapod" else on_sand)(
                name, memory=MEMORY, randomise={"strength": (0.5, 2)}
            )
