"""Batches: exactly what Gymnasium makes of single environments, and Stable-Baselines3 too."""

import pickle
from dataclasses import dataclass, replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env as make_dummy

from mjgranular import InputError
from mjgranular.envs import SandVectorEnv, on_sand, tasks
from mjgranular.envs.gym_robots import Hopper
from mjgranular.envs.ids import id_of
from mjgranular.envs.sb3 import SandVecEnv, make_vec_env
from mjgranular.envs.single import SandEnv

pytest.importorskip("mujoco.batch", reason="a MuJoCo without batches")

NUM = 3


def pair(name, *, autoreset=AutoresetMode.NEXT_STEP, **options):
    """As many simulations one by one, by Gymnasium's own, and in a batch."""
    sync = gym.make_vec(
        id_of(name),
        num_envs=NUM,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": autoreset},
        **options,
    )
    batch = gym.make_vec(
        id_of(name),
        num_envs=NUM,
        vectorization_mode="vector_entry_point",
        autoreset_mode=autoreset,
        **options,
    )
    return sync, batch


def assert_same(first, second):
    """The same numbers of the same kind, in whatever they are nested."""
    assert type(first) is type(second)
    if isinstance(first, dict):
        assert first.keys() == second.keys()
        for key in first:
            assert_same(first[key], second[key])
    elif isinstance(first, tuple):
        for one, other in zip(first, second, strict=True):
            assert_same(one, other)
    elif first.dtype == object:
        for one, other in zip(first, second, strict=True):
            assert np.array_equal(one, other)
    else:
        assert first.dtype == second.dtype
        assert np.array_equal(first, second)


@pytest.mark.parametrize("name", tasks)
def test_a_batch_is_the_single_environments_to_the_last_bit(name):
    sync, batch = pair(name, max_episode_steps=6)
    assert sync.observation_space == batch.observation_space
    assert sync.action_space == batch.action_space
    assert_same(sync.reset(seed=7), batch.reset(seed=7))
    sync.action_space.seed(0)
    for _ in range(20):
        actions = sync.action_space.sample()
        assert_same(sync.step(actions), batch.step(actions))
    assert_same(sync.reset(seed=[5, None, 7]), batch.reset(seed=[5, None, 7]))


@pytest.mark.parametrize("name", ["Hopper", "LinkDrop"])
def test_episodes_may_begin_in_the_step_that_ends_the_last(name):
    sync, batch = pair(name, autoreset=AutoresetMode.SAME_STEP, max_episode_steps=9)
    assert_same(sync.reset(seed=1), batch.reset(seed=1))
    sync.action_space.seed(0)
    for _ in range(25):
        actions = sync.action_space.sample()
        assert_same(sync.step(actions), batch.step(actions))


def test_what_diverges_ends_its_episode_with_no_reward():
    """MuJoCo resets it within the step: sand, controls and data of the episode are gone."""
    sync, batch = pair("Hopper", randomise={"strength": (0.3, 0.5)})
    sandy = on_sand("Hopper-v5", randomise={"strength": (0.3, 0.5)})
    action = np.zeros((NUM, 3), np.float32)
    for env in (sync, batch, sandy):
        env.reset(seed=0)
    for data in (sync.envs[1].unwrapped.data, sandy.unwrapped.data):
        data.qvel[0] = np.inf
    batch.unwrapped.state.qvel[1, 0] = np.inf
    for lost in ([False, True, False], [False, False, False]):
        steps = [env.step(action) for env in (sync, batch)]
        assert_same(*steps)
        assert steps[0][2].tolist() == lost == steps[0][4]["sand/lost"].tolist()
    assert steps[0][1][1] == 0.0
    _, reward, terminated, _, info = sandy.step(action[0])
    assert (reward, terminated, info["sand/lost"]) == (0.0, True, True)


def test_what_a_task_varies_is_of_one_episode():
    """A factor on the model, in every other episode."""

    @dataclass(frozen=True, kw_only=True)
    class Laden(Hopper):
        @property
        def varied(self):
            return ("body_mass",)

        def start(self, random, height):
            begin = super().start(random, height)
            heavy = {"body_mass": 3 * self.model.body_mass}
            return replace(begin, numbers=heavy if random.uniform() < 0.5 else {})

    single, batch = SandEnv(Laden()), SandVectorEnv(Laden(), 1)
    built = single.task.model.body_mass.sum()
    factors = set()
    for seed in range(6):
        single.reset(seed=seed)
        batch.reset(seed=seed)
        masses = single.model.body_mass.sum(), batch.batch.expand("body_mass").sum()
        assert masses[0] == masses[1]
        factors.add(round(masses[0] / built, 9))
    assert factors == {1.0, 3.0}


def test_some_may_be_reset():
    sync, batch = pair("Hopper", autoreset=AutoresetMode.DISABLED, max_episode_steps=2)
    assert_same(sync.reset(seed=1), batch.reset(seed=1))
    actions = np.zeros(sync.action_space.shape, np.float32)
    for _ in range(2):
        assert_same(sync.step(actions), batch.step(actions))
    with pytest.raises(InputError, match=r"simulations \[0, 1, 2\] are over: reset them"):
        batch.step(actions)
    for mask in ([True, False, True], [False, True, False]):
        options = [{"reset_mask": np.array(mask)} for _ in range(2)]
        assert_same(sync.reset(options=options[0]), batch.reset(options=options[1]))
    assert_same(sync.step(actions), batch.step(actions))
    with pytest.raises(InputError, match="reset_mask must be 3 bools"):
        batch.reset(options={"reset_mask": np.zeros(3, bool)})


@pytest.mark.parametrize("name", ["ChainSwim", "Ant"])
def test_threads_change_nothing(name):
    batches = [SandVectorEnv(name, 5, threads=threads) for threads in (1, 2, 4)]
    batches.append(pickle.loads(pickle.dumps(batches[0])))
    starts = [batch.reset(seed=3)[0] for batch in batches]
    batches[0].action_space.seed(0)
    actions = [batches[0].action_space.sample() for _ in range(8)]
    ways = [[batch.step(action)[:4] for action in actions] for batch in batches]
    for start, way in zip(starts[1:], ways[1:], strict=True):
        assert np.array_equal(start, starts[0])
        for one, other in zip(way, ways[0], strict=True):
            assert_same(one, other)


def test_observations_are_the_users_own():
    batch = SandVectorEnv("ChainCrawl", 2)
    first, info = batch.reset(seed=0)
    kept, noted = first.copy(), info["sand/force"].copy()
    batch.step(np.ones((2, 6), np.float32))
    assert np.array_equal(first, kept)
    assert np.array_equal(info["sand/force"], noted)


def test_wrong_input_is_told():
    with pytest.raises(InputError, match="num_envs must be at least 1, not 0"):
        SandVectorEnv("ChainSwim", 0)
    with pytest.raises(InputError, match="max_episode_steps must be at least 1"):
        SandVectorEnv("ChainSwim", 2, max_episode_steps=0)
    with pytest.raises(InputError, match="a batch has no window"):
        SandVectorEnv("ChainSwim", 2, render_mode="human")
    batch = SandVectorEnv("ChainSwim", 2)
    with pytest.raises(InputError, match="2 simulations need as many seeds, not 3"):
        batch.reset(seed=[1, 2, 3])
    with pytest.raises(InputError, match="must be reset before they are stepped"):
        batch.step(np.zeros((2, 6), np.float32))
    batch.reset(seed=0)
    with pytest.raises(ValueError, match=r"Expected \(2, 6\), found \(6,\)"):
        batch.step(np.zeros(6))
    with pytest.raises(InputError, match="must be finite"):
        batch.step(np.full((2, 6), np.inf))
    for wrong in (np.full((2, 6), "a"), np.zeros((2, 6), complex), np.full((2, 6), None)):
        with pytest.raises(InputError, match="must be real numbers"):
            batch.step(wrong)
    with pytest.raises(InputError, match="needs a batch made with autoreset_mode='SameStep'"):
        SandVecEnv(batch)
    with pytest.raises(InputError, match="CartPole-v1 has no batch of mjgranular's"):
        make_vec_env("CartPole-v1", 2)


@pytest.mark.parametrize("name", ["Hopper", "LinkDrop"])
def test_stable_baselines_sees_what_it_sees_of_single_environments(name):
    # Gymnasium's time limit is the id's own: with zero actions the hopper falls before.
    ours = make_vec_env(id_of(name), NUM, seed=5, full_info=True)
    theirs = make_dummy(id_of(name), NUM, seed=5)
    assert np.array_equal(ours.reset(), theirs.reset().astype(float))
    ours.action_space.seed(0)
    ended = 0
    for _ in range(60):
        actions = np.array([ours.action_space.sample() for _ in range(NUM)])
        got, expected = ours.step(actions), theirs.step(actions)
        for one, other in zip(got[:3], expected[:3], strict=True):
            assert np.array_equal(one, other)
        for done, one, other in zip(got[2], got[3], expected[3], strict=True):
            assert one["TimeLimit.truncated"] == other["TimeLimit.truncated"] if done else True
            keys = other.keys() - {"TimeLimit.truncated", "episode"}
            assert keys <= one.keys()
            for key in keys:
                assert np.array_equal(one[key], other[key]), key
            ended += done
    assert ended > 0
    for one, other in zip(ours.reset_infos, theirs.reset_infos, strict=True):
        assert one.keys() == other.keys()


def test_methods_act_on_all_simulations():
    vec = make_vec_env(id_of("Hopper"), 3, seed=0)
    vec.reset()
    assert len(vec.env_method("render")) == 3
    for call in (vec.set_attr, vec.env_method):
        with pytest.raises(InputError, match="share 'render_mode': omit indices, got 2"):
            call("render_mode", None, indices=2)


def test_options_of_stable_baselines_are_for_the_next_reset():
    env = make_vec_env(id_of("Hexapod"), 2, randomise={"strength": (0.5, 2.0)})
    env.set_options({"strength": 0.6})
    env.reset()
    assert [info["sand/strength"] for info in env.reset_infos] == [0.6, 0.6]
    env.reset()
    assert all(info["sand/strength"] != 0.6 for info in env.reset_infos)
    env.set_options([{"strength": 0.6}, {"strength": 0.7}])
    with pytest.raises(InputError, match="share set_options"):
        env.reset()


@pytest.mark.slow
def test_stable_baselines_learns_on_it():
    batch = make_vec_env(id_of("LinkDrop"), 4, seed=0, frame_skip=20)
    model = PPO("MlpPolicy", batch, n_steps=4, batch_size=8, n_epochs=1, device="cpu")
    model.learn(32)
    assert model.num_timesteps == 32
    assert batch.get_attr("num_envs") == [4] * 4
    assert batch.env_is_wrapped(gym.Wrapper) == [False] * 4
    batch.close()


def test_generators_follow_from_the_seed():
    batch = SandVectorEnv("ChainSwim", 2)
    batch.reset(seed=3)
    single = SandEnv("ChainSwim")
    single.reset(seed=4)
    assert batch.np_random_seed == (3, 4)
    assert batch.np_random[1].bit_generator.state == single.np_random.bit_generator.state
