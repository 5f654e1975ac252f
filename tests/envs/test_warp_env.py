"""Tasks in MuJoCo Warp, on its CPU back end, against the same tasks on the processor."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
import pytest

from mjgranular import InputError
from mjgranular.envs import SandRanges, SandVectorEnv
from mjgranular.envs.gym_robots import Hopper

pytestmark = pytest.mark.slow
pytest.importorskip("mujoco_warp")


@dataclass(frozen=True, kw_only=True)
class DiscreteHopper(Hopper):
    """With the integrator that MuJoCo Warp needs, so that both do the same."""

    def robot(self):
        spec = super().robot()
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        return spec


@pytest.fixture(scope="module")
def warp_env():
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    from mjgranular.envs import WarpVectorEnv

    return WarpVectorEnv


def both(warp_env, task, **settings):
    return warp_env(task, 3, device="cpu", **settings), SandVectorEnv(task, 3, **settings)


def test_episodes_are_those_of_the_processor(warp_env):
    """Sand of each world drawn; through the fall into the sand, ends and new beginnings."""
    ranges = SandRanges(strength=(0.5, 2.0), density=(0.5, 2.0), slope=(-0.1, 0.1))
    task = DiscreteHopper(randomise=ranges, observe_sand=True)
    envs = both(warp_env, task, max_episode_steps=60)
    seen, told = zip(*(env.reset(seed=3) for env in envs), strict=True)
    np.testing.assert_allclose(seen[0], seen[1], atol=1e-6)
    for name in ("sand/strength", "sand/density", "sand/slope"):
        np.testing.assert_allclose(told[0][name], told[1][name], rtol=1e-12)
    random = np.random.default_rng(0)
    ends, forces, powers = 0, [], []
    for step in range(300):
        action = 0.3 * random.uniform(-1, 1, envs[0].action_space.shape)
        one, other = (env.step(action) for env in envs)
        positions = slice(0, 5)  # velocities turn round within steps
        np.testing.assert_allclose(one[0][:, positions], other[0][:, positions], atol=0.02)
        np.testing.assert_array_equal(one[3], other[3])
        differ = one[2] != other[2]
        if differ.any():  # one of them leans a hair more, at the angle at which episodes end
            np.testing.assert_allclose(np.abs(other[0][differ, 1]), 0.2, atol=0.02)
            for env in envs:
                env.reset(seed=step)
            continue
        np.testing.assert_allclose(one[1], other[1], atol=0.2)
        if step < 16:  # the fall into the sand
            speeds = [out[4]["sand/froude"] for out in (one, other)]
            np.testing.assert_allclose(*speeds, rtol=0.01)
        ends += int((one[2] | one[3]).sum())
        forces.append([out[4]["sand/force"] for out in (one, other)])
        assert not one[4]["sand/lost"].any()
        powers.append(one[4]["sand/power"])
    assert ends >= 14
    assert np.max(powers) <= -1e-6 * np.min(powers)  # some roundings of single precision
    # A foot at rest touches in some steps and not in others, and not in the same ones in single
    # precision. So one step's force says little, and the means agree within their standard error.
    forces = np.array(forces)
    weight = forces[:, 1].mean(0)[:, 2]
    differences = forces[:, 0] - forces[:, 1]
    error = differences.std(0) / np.sqrt(len(differences))
    assert weight.min() > 20
    assert (error < 0.015 * weight.max()).all()
    assert (np.abs(differences.mean(0)) < 3 * error + 1e-3).all()
    assert np.abs(differences.mean((0, 1))).max() < 0.015 * weight.max()  # over worlds too


def test_a_world_that_is_lost_begins_anew_and_the_others_go_on(warp_env):
    env, reference = both(warp_env, DiscreteHopper())
    for each in (env, reference):
        each.reset(seed=0)
    action = np.zeros(env.action_space.shape)
    batch = env.batch
    broken = batch.bind("qpos")[1].copy()
    batch.bind("qpos")[1] = np.nan
    batch.forward(np.arange(3))
    observation, _, terminated, _, info = env.step(action)
    right = reference.step(action)[0]
    assert info["sand/lost"].tolist() == [False, True, False] == terminated.tolist()
    np.testing.assert_allclose(observation[[0, 2]], right[[0, 2]], atol=1e-3)
    assert np.isfinite(observation).all()
    assert np.isfinite(broken).all()
    observation, _, terminated, _, info = env.step(action)
    assert not info["sand/lost"].any()
    assert not terminated.any()


def test_a_task_may_write_to_what_it_reads(warp_env):
    @dataclass(frozen=True, kw_only=True)
    class Led(DiscreteHopper):
        reads: ClassVar[tuple[str, ...]] = ("xfrc_applied", "mocap_pos")

        def robot(self):
            spec = super().robot()
            hand = spec.worldbody.add_body(name="hand", mocap=True, pos=[0, 0, 1.25])
            weld = mujoco.mjtEq.mjEQ_WELD, mujoco.mjtObj.mjOBJ_BODY
            spec.add_equality(type=weld[0], objtype=weld[1], name1="torso", name2=hand.name)
            return spec

        def act(self, action, state):
            state.xfrc_applied[:, 1, 2], state.mocap_pos[:, 0, 2] = 50.0, 1.3
            return action

    seen = []
    for env in both(warp_env, Led()):
        observation = env.reset(seed=0)[0]
        for _ in range(5):
            observation = env.step(np.zeros((3, 3)))[0]
        seen.append(observation[:, 0])
    np.testing.assert_allclose(*seen, atol=1e-4)
    assert seen[0].min() > 1.27  # untouched it falls


def test_delayed_actuators_forget_the_last_episode(warp_env):
    @dataclass(frozen=True, kw_only=True)
    class Late(DiscreteHopper):
        def robot(self):
            spec = super().robot()
            for actuator in spec.actuators:
                actuator.delay, actuator.nsample = 0.03, 24
            return spec

    envs = both(warp_env, Late())
    for size in (0.3, 0.0):
        for env in envs:
            env.reset(seed=0)
        for _ in range(5):
            one, other = (env.step(np.full((3, 3), size))[0] for env in envs)
            np.testing.assert_allclose(one, other, atol=1e-4)


def test_worlds_remember_until_their_episode_ends(warp_env):
    """Through the fall into the sand; then one world is begun anew."""
    envs = both(warp_env, DiscreteHopper(memory=True), max_episode_steps=40)
    for env in envs:
        env.reset(seed=3)
    random = np.random.default_rng(0)
    for _ in range(30):
        action = 0.3 * random.uniform(-1, 1, envs[0].action_space.shape)
        one, other = (env.step(action) for env in envs)
        np.testing.assert_allclose(one[0][:, :5], other[0][:, :5], atol=0.03)
    batch = envs[0].batch
    pressed = batch._sand.volumes()["pressed"]
    assert (pressed > 1e-6).all()
    batch.reset(np.array([1]))
    batch.forward(np.array([1]))
    np.testing.assert_array_equal(batch._sand.volumes()["pressed"], pressed * [1, 0, 1])


def test_what_has_no_place_is_said(warp_env):
    with pytest.raises(InputError, match="leave media, laws and surfaces out of randomise"):
        warp_env(
            Hopper(
                randomise=SandRanges(media=("glass_beads", "poppy_seed_loose"), laws=("rft2d",))
            ),
            2,
        )
    with pytest.raises(InputError, match="device"):
        warp_env("Hopper", 2, device="gpu7")
    with pytest.raises(InputError, match=r"no opt\.timestep for each world"):
        warp_env("Hopper", 2, device="cpu").batch.expand("opt.timestep")

    @dataclass(frozen=True, kw_only=True)
    class WithoutSlip(Hopper):
        def robot(self):
            spec = super().robot()
            spec.option.noslip_iterations = 3
            return spec

    with pytest.raises(InputError, match="does not take the task's model: noslip"):
        warp_env(WithoutSlip(), 2)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of packages that RSL-RL imports
def test_runners_of_rsl_rl_end_first_episodes_at_different_times():
    torch = pytest.importorskip("torch")
    pytest.importorskip("rsl_rl.env")
    from mjgranular.envs.rsl import RslVecEnv

    env = RslVecEnv(SandVectorEnv("Hopper", 3, max_episode_steps=9, autoreset_mode="SameStep"))
    env.episode_length_buf = torch.tensor([2, 8, 5])  # as `learn(..., init_at_random_ep_len=True)`
    over = [env.step(torch.zeros(3, 3))[2].tolist() for _ in range(7)]
    assert [ends.index(True) for ends in zip(*over, strict=True)] == [6, 0, 3]
    assert env.episode_length_buf.tolist() == [0, 6, 3]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of packages that RSL-RL imports
def test_each_world_has_its_motors_and_a_critic_knows_them(robots, warp_env):
    pytest.importorskip("rsl_rl.env")
    from mjgranular.envs.rsl import RslVecEnv

    drawn = {"motor_strength": (0.5, 1.0), "privileged": True}
    worlds = warp_env("Go1Velocity", 3, max_episode_steps=20, autoreset_mode="SameStep", **drawn)
    env = RslVecEnv(worlds)
    env.seed(1)
    privileged = env.get_observations()["privileged"].numpy()
    assert privileged.shape == (3, 15)
    full = worlds.task.model.actuator_gainprm[:, 0]
    on_device = worlds.batch._m.actuator_gainprm.numpy()[:, :, 0]
    np.testing.assert_allclose(on_device, privileged[:, 13:14] * full, rtol=1e-6)
    assert len(set(privileged[:, 13])) == 3

    worlds.batch.bind("qvel")[0, 0] = np.nan
    info = worlds.step(np.zeros((3, 12), np.float32))[-1]
    assert info["final_info"]["sand/lost"].tolist() == [True, False, False]
    ended = info["final_info"]["privileged"][0, 13:]
    np.testing.assert_allclose(ended, privileged[0, 13:], rtol=1e-6)
