"""Environments: Gymnasium's and Stable-Baselines3's own checks, Gymnasium's numbers, physics."""

import math
import pickle
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_for_sb3

import mjgranular.envs
from mjgranular import InputError, Plane, RenderError, Sand, UnknownNameError
from mjgranular.envs import SandEnv, SandVectorEnv, on_sand, tasks
from mjgranular.envs.gaits import gait, gaits
from mjgranular.envs.ground import RIGID
from mjgranular.envs.gym_robots import Hopper
from mjgranular.envs.ids import id_of, register_task
from mjgranular.errors import UnknownArgumentError
from mjgranular.law.validity import findings_of, found_at
from mjgranular.models import Link

ROBOTS = ("Hopper", "Walker2d", "HalfCheetah", "Ant", "Humanoid")
SECTIONS = (
    "Description",
    "Action Space",
    "Observation Space",
    "Rewards",
    "Starting State",
    "Episode End",
    "Arguments",
    "Version History",
)

pytestmark = [
    # Unbounded observations are what Gymnasium's own robots have.
    pytest.mark.filterwarnings("ignore:.*A Box observation space"),
    pytest.mark.filterwarnings("ignore:.*Your observation .* has an unconventional"),
    pytest.mark.filterwarnings("ignore:.*We recommend you to use a symmetric"),
]


def rollout(env, actions, seed=0):
    """Observations, rewards and ends of some steps, the first of them the start."""
    observation, _ = env.reset(seed=seed)
    seen = [(observation, 0.0, False)]
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        seen.append((observation, reward, terminated))
        if terminated or truncated:
            env.reset()
    return seen


@cache
def made(name):
    """An environment that tests share: any that steps it begins with a reset."""
    return gym.make(id_of(name))


def same(first, second):
    return all(
        np.array_equal(a[0], b[0]) and a[1] == b[1] and a[2] == b[2]
        for a, b in zip(first, second, strict=True)
    )


def samples(env, count, seed=0):
    env.action_space.seed(seed)
    return [env.action_space.sample() for _ in range(count)]


@pytest.mark.parametrize("name", tasks)
def test_gymnasium_and_stable_baselines_find_nothing(name):
    env = made(name).unwrapped
    check_env(env, skip_render_check=True)
    check_for_sb3(env)


@pytest.mark.parametrize("name", tasks)
def test_a_seed_decides_all_and_nothing_is_constant(name):
    first, second = made(name), gym.make(id_of(name))
    actions = samples(first, 12)
    one, other = rollout(first, actions), rollout(second, actions)
    assert same(one, other)
    assert not same(one, rollout(second, actions, seed=1))
    assert same(one, rollout(pickle.loads(pickle.dumps(first.unwrapped)), actions))
    seen = np.array([observation for observation, _, _ in one])
    for column in np.flatnonzero(np.ptp(seen, axis=0) == 0):
        # Gymnasium's own: quantities of bodies welded to others, and forces on what hangs free.
        # And a command holds for some seconds.
        assert name in ("Ant", "Humanoid", "Go1Velocity", "Go2Velocity", "G1Velocity"), column


@pytest.mark.parametrize("name", tasks)
def test_the_docstring_is_the_specification(name):
    task = tasks[name]
    assert re.findall(r"^ *## (.*)$", task.__doc__, re.MULTILINE) == list(SECTIONS)
    env = made(name)
    text = " ".join(task.__doc__.split())
    size = env.observation_space.shape[0]
    if "links" in text:
        text = text.replace("2 links + 2", "16").replace("2 links + 3", "17")
        text = text.replace("links - 1", "6")
    assert f"({size},), float64)" in text
    assert f"({env.action_space.shape[0]},), float32)" in text
    assert f"`frame_skip={env.unwrapped.task.frame_skip}`" in text or name in (*ROBOTS, "Swimmer")


@pytest.mark.parametrize("name", ["ChainSwim", "Hopper"])
def test_an_episode_is_as_long_as_it_says(name):
    env = gym.make(id_of(name), max_episode_steps=5)
    env.reset(seed=0)
    zero = np.zeros(env.action_space.shape, np.float32)
    assert [env.step(zero)[3] for _ in range(5)] == [False] * 4 + [True]
    assert gym.spec(id_of(name)).max_episode_steps == tasks[name].episode


@pytest.mark.slow
def test_environments_work_in_processes_of_their_own():
    batch = gym.make_vec(
        id_of("LinkDrop"),
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": "spawn"},
    )
    sync = gym.make_vec(id_of("LinkDrop"), num_envs=2, vectorization_mode="sync")
    assert np.array_equal(batch.reset(seed=3)[0], sync.reset(seed=3)[0])
    action = np.full((2, 2), 0.3, np.float32)
    assert np.array_equal(batch.step(action)[1], sync.step(action)[1])
    batch.close()


@pytest.mark.parametrize("name", ROBOTS)
def test_the_robots_are_gymnasiums_on_sand_to_the_last_bit(name):
    theirs, ours = on_sand(f"{name}-v5"), gym.make(id_of(name))
    assert theirs.observation_space == ours.observation_space
    assert theirs.action_space == ours.action_space
    actions = samples(ours, 60)
    assert same(rollout(theirs, actions), rollout(ours, actions))
    assert theirs.reset(seed=2)[1].keys() == ours.reset(seed=2)[1].keys()
    their_info, our_info = theirs.step(actions[0])[4], ours.step(actions[0])[4]
    assert their_info.keys() == our_info.keys()
    for key, value in their_info.items():
        assert our_info[key] == pytest.approx(value, rel=1e-12), key


@pytest.mark.parametrize("name", ["Hopper", "Ant"])
def test_out_of_the_sands_reach_it_is_gymnasiums_own(name, tmp_path):
    original = gym.make(f"{name}-v5").unwrapped
    text = Path(original.fullpath).read_text()
    text = text.replace('conaffinity="1" condim="3"', 'contype="0" conaffinity="0" condim="3"')
    text = text.replace('integrator="RK4"', 'integrator="implicitfast"')
    (tmp_path / "robot.xml").write_text(text)
    floorless = gym.make(f"{name}-v5", xml_file=str(tmp_path / "robot.xml"))
    deep = on_sand(f"{name}-v5", surface=Plane(height=-50.0))
    actions = samples(deep, 25)
    for a, b in zip(rollout(floorless, actions), rollout(deep, actions), strict=True):
        assert b[0] == pytest.approx(a[0], rel=1e-9, abs=1e-9)
        assert b[1] == pytest.approx(a[1], rel=1e-9)
        assert a[2] == b[2]


def test_an_ant_at_rest_feels_its_weight_in_cfrc_ext():
    env = on_sand("Ant-v5", terminate_when_unhealthy=False, reset_noise_scale=0.0).unwrapped
    _, info = env.reset(seed=0)
    for _ in range(120):
        *_, info = env.step(np.zeros(8))
    weight = 9.81 * env.model.body_mass.sum()
    assert env.data.cfrc_ext[:, 5].sum() == pytest.approx(weight, rel=1e-3)
    assert info["sand/force"][2] == pytest.approx(weight, rel=1e-3)
    assert info["reward_contact"] < 0


def test_on_sand_takes_what_sand_takes():
    soft = on_sand("Hopper-v5", medium="poppy_seed_loose", reset_noise_scale=0.0)
    hard = on_sand("Hopper-v5", medium="quikrete_medium", reset_noise_scale=0.0)
    depths = []
    for env in (soft, hard):
        _, info = env.reset(seed=0)
        for _ in range(60):
            *_, info = env.step(np.zeros(3))
        depths.append(info["sand/depth"])
    assert depths[0] > 2 * depths[1] > 0
    again = pickle.loads(pickle.dumps(soft.unwrapped))
    again.reset(seed=0)
    for _ in range(60):
        *_, info = again.step(np.zeros(3))
    assert info["sand/depth"] == depths[0]
    swimmer = on_sand("Swimmer-v5", surface=Plane(height=0.3), medium="poppy_seed_loose")
    _, info = swimmer.reset(seed=0)
    assert info["sand/depth"] == pytest.approx(0.4, abs=0.03)  # though its geoms make no contacts
    assert swimmer.unwrapped.model.opt.density == 0


@pytest.mark.parametrize(
    ("name", "steps", "least"),
    [("ChainSwim", 60, 0.02), ("ChainCrawl", 75, 0.1), ("Hexapod", 50, 0.1)],
)
def test_scripted_gaits_go_ahead(name, steps, least):
    env = SandEnv(name)
    env.reset(seed=0)
    script = gait(env.task)
    way = paid = 0.0
    for step in range(steps):
        _, _, _, _, info = env.step(script(step * env.dt))
        way += info["x_velocity"] * env.dt
        paid += info["reward_forward"]
        assert info["sand/power"] <= 1e-9
    assert way > least
    assert paid > 0


def speed(env, script, seconds=3.0):
    """Mean of the mass centre's velocity along x [m/s], without the first second."""
    env.reset(seed=0)
    ways = [env.step(script(i * env.dt))[4]["x_velocity"] for i in range(round(seconds / env.dt))]
    return np.mean(ways[round(1 / env.dt) :])


@pytest.mark.parametrize("frequency", [1.0, 3.0])
def test_a_wave_from_the_tail_swims_backwards_as_fast(frequency):
    # One whole wave from the tail is that from the head, seen after half a turn about z, but for
    # how it begins: the longer the mean, the less of that is in it (5.5 % after 3 s, 2.3 after 5).
    env = SandEnv("ChainSwim", reset_noise_scale=0)
    ahead, back = (
        speed(env, gait(env.task, waves=w, frequency=frequency), 5.0) for w in (1.0, -1.0)
    )
    assert ahead > 0.01
    assert back == pytest.approx(-ahead, rel=0.05)


@pytest.mark.parametrize(
    ("name", "frequency"),
    [("ChainSwim", 1.0), ("ChainSwim", 2.0), ("ChainCrawl", 0.5), ("ChainCrawl", 1.0),
     ("Hexapod", 1.5), ("Hexapod", 3.0)],
)  # fmt: skip
def test_gaits_are_as_fast_in_steps_half_as_long(name, frequency):
    coarse = SandEnv(name, reset_noise_scale=0.0)
    fine = SandEnv(name, reset_noise_scale=0.0, frame_skip=2 * coarse.task.frame_skip)
    for model in (fine.model, fine.task.model):
        model.opt.timestep /= 2
    fine.task.__dict__.pop("dt", None)  # a task caches the duration of a step
    assert fine.task.dt == coarse.task.dt
    first, second = (speed(env, gait(env.task, frequency=frequency)) for env in (coarse, fine))
    assert first == pytest.approx(second, rel=0.08)


@pytest.mark.parametrize(("angle", "spin"), [(-0.6, 0.0), (0.2, 0.4)])
def test_a_drop_is_that_of_sand_step(angle, spin):
    env = SandEnv("LinkDrop", frame_skip=300)
    observation, _ = env.reset(seed=4)
    *_, info = env.step(np.array([angle, spin], np.float32))
    link, tilt = Link(), np.radians(75) * (np.float32(angle).item() + 1) / 2
    turn = 40 * np.float32(spin).item()
    model = link.model(timestep=5e-4)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    half = link.length / 2
    data.qpos[:] = -half * np.sin(tilt), half * np.cos(tilt), tilt
    data.qvel[:] = 0.0, -observation[1] - half * np.sin(tilt) * turn, turn
    sand = Sand(model, medium="play_sand", law="link_distributed", scheme="implicit")
    depth = 0.0
    for _ in range(300):
        depth = sand.report(data)["link"].depth
        sand.step(data)
    assert info["sand/depth"] == pytest.approx(depth, rel=1e-6)
    assert info["reward_depth"] == pytest.approx(-abs(depth / 0.2 - observation[0]), rel=1e-6)


def test_the_lower_end_meets_the_sand_at_the_speed_that_is_asked_for():
    env = SandEnv("LinkDrop", frame_skip=1)
    observation, _ = env.reset(seed=0)
    task, state = env.task, env.state
    task.act(np.array([[0.3, -0.7]]), state)
    mujoco.mj_forward(env.model, env.data)
    velocity = np.zeros(6)
    site = env.model.site("T").id
    mujoco.mj_objectVelocity(env.model, env.data, mujoco.mjtObj.mjOBJ_SITE, site, velocity, 0)
    assert velocity[5] == pytest.approx(-observation[1], rel=1e-12)
    assert env.data.site_xpos[site][2] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("name", ["ChainCrawl", "Hexapod", "Hopper", "Ant", "LinkDrop"])
def test_starts_are_on_the_surface_that_is_given(name):
    level = SandEnv(name).reset(seed=0)[1]["sand/depth"]
    raised = SandEnv(name, surface=Plane(height=0.7)).reset(seed=0)[1]["sand/depth"]
    assert raised == pytest.approx(level, abs=1e-9)
    sloped = SandEnv(name, surface=Plane(height=-0.3, slope=0.1, uphill=2.0))
    assert level - 0.25 < sloped.reset(seed=0)[1]["sand/depth"] < max(level, 0) + 0.05


def test_the_crawler_pays_for_changes_of_its_actions():
    env = gym.make("mjgranular/ChainCrawl-v0", rate_cost_weight=0.1)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.5, 1.5, (4, 6)).astype(np.float32)
    actions[2] = actions[1]
    last = np.zeros(6)  # straight, as the episode begins
    for action in actions:
        *_, info = env.step(action)
        asked = np.clip(action, -1, 1)
        assert info["reward_rate"] == pytest.approx(-0.1 * np.sum((asked - last) ** 2), abs=1e-6)
        last = asked
    env.close()


def test_the_law_is_said_to_hold_or_not():
    env = SandEnv("ChainSwim")
    _, info = env.reset(seed=0)
    assert info["sand/valid"] is True
    assert info["sand/depth"] == pytest.approx(0.056, abs=0.003)
    deep = SandEnv("ChainSwim", surface=Plane(height=0.2))
    assert deep.reset(seed=0)[1]["sand/valid"] is False
    tilted = SandEnv("Hopper", surface=Plane(slope=0.3))
    assert tilted.reset(seed=0)[1]["sand/valid"] is False


def test_an_unknown_argument_of_a_registered_environment_on_sand_is_named():
    # Gymnasium raises a TypeError of an environment again, with another message.
    gym.register("HopperOnSand-v0", lambda **options: on_sand("Hopper-v5", **options).unwrapped)
    try:
        with pytest.raises(UnknownArgumentError, match=r"no argument 'mediun'; .*mean medium\?"):
            gym.make("HopperOnSand-v0", mediun="play_sand")
    finally:
        del gym.registry["HopperOnSand-v0"]


def test_wrong_input_is_told():
    with pytest.raises(UnknownNameError, match=r"no environment 'Nobody-v5'.*Ant-v5"):
        on_sand("Nobody-v5")
    with pytest.raises(InputError, match="not one of Gymnasium's MuJoCo environments"):
        on_sand("CartPole-v1")
    with pytest.raises(InputError, match="no floor"):
        on_sand("InvertedPendulum-v5")
    with pytest.raises(UnknownNameError, match=r"no medium 'mud'; there are: glass_beads"):
        on_sand("Hopper-v5", medium="mud")
    with pytest.raises(UnknownNameError, match=r"no law 'wet'; there are: depth_velocity"):
        gym.make(id_of("ChainSwim"), law="wet")
    with pytest.raises(UnknownNameError, match=r"no environment 'Chain'; .*ChainC"):
        SandEnv("Chain")
    with pytest.raises(
        InputError, match=r"ChainSwim has no option 'link'; it has: medium, .*links"
    ):
        gym.make(id_of("ChainSwim"), link=3)
    with pytest.raises(InputError, match="links must be at least 2, not 1"):
        SandEnv("ChainCrawl", links=1)
    with pytest.raises(InputError, match="frame_skip must be at least 1, not 0"):
        SandEnv("Hexapod", frame_skip=0)
    with pytest.raises(InputError, match="target_range must be"):
        SandEnv("LinkDrop", target_range=(0.2, 0.1))
    with pytest.raises(InputError, match="render_mode must be None or one of human, rgb_array"):
        SandEnv("Hopper", render_mode="text")
    with pytest.raises(UnknownNameError, match="no camera 'mine'; there are: track"):
        SandEnv("Hopper", camera_name="mine")
    with pytest.raises(UnknownNameError, match="no camera 'mine'; there are: track"):
        on_sand("Hopper-v5", camera_name="mine")
    with pytest.raises(UnknownNameError, match="no gait for 'Hopper'"):
        gait(SandEnv("Hopper").task)
    with pytest.raises(InputError, match=r"has no 'speed'; it has: amplitude"):
        gait(SandEnv("ChainSwim").task, speed=1)


def test_actions_are_looked_at():
    env = SandEnv("ChainSwim")
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"Action dimension mismatch. Expected \(6,\), found"):
        env.step(np.zeros(5))
    with pytest.raises(InputError, match="an action must be finite"):
        env.step(np.full(6, np.nan))
    before = env.data.time
    env.step(np.full(6, 7.0))  # beyond the space: as far as it goes
    assert env.data.time > before
    assert np.abs(env.data.ctrl).max() == env.task.worm.bend


def test_pictures_show_sand_and_need_gl(monkeypatch):
    env = gym.make(id_of("Hexapod"), render_mode="rgb_array", width=120, height=90)
    env.reset(seed=0)
    try:
        picture = env.render()
    except RenderError:
        pytest.skip("this machine cannot draw")
    assert picture.shape == (90, 120, 3)
    red, green, blue = picture[60:].reshape(-1, 3).mean(axis=0)
    assert red > green > blue  # sand
    env.close()

    def refuse(*_):
        raise OSError("no EGL")

    monkeypatch.setattr(mujoco, "Renderer", refuse)
    env.reset(seed=0)
    with pytest.raises(RenderError, match=r"no EGL.*libegl1"):
        env.render()


def test_a_window_needs_a_screen(monkeypatch):
    glfw = pytest.importorskip("glfw")
    monkeypatch.setattr(glfw, "init", lambda: False)
    env = SandEnv("ChainSwim", render_mode="human")
    with pytest.raises(RenderError, match="needs a screen"):
        env.reset(seed=0)
    with pytest.raises(RenderError, match="needs a screen"):  # GLFW would end the process
        on_sand("Ant-v5", render_mode="human")


def test_without_gymnasium_there_is_an_install_line():
    code = (
        "import sys; sys.modules['gymnasium'] = None\n"
        "import mjgranular\n"
        "try:\n    import mjgranular.envs\n"
        "except mjgranular.MissingExtraError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == (
        "mjgranular.envs needs gymnasium, which is not installed: pip install 'mjgranular[envs]'"
    )


def test_ids_are_registered_by_the_import():
    for name in tasks:
        assert id_of(name) in gym.registry
    code = "import gymnasium; print(gymnasium.make('mjgranular.envs:mjgranular/LinkDrop-v0'))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "SandEnv" in done.stdout


def test_a_task_that_is_defined_again_has_its_own_time_limit(monkeypatch):
    monkeypatch.setattr(tasks, "_things", dict(tasks))
    limits = []
    for steps in (3, 7):
        identity = register_task(type("Again", (tasks["ChainCrawl"],), {"episode": steps}))
        limits.append(gym.make(identity).spec.max_episode_steps)
    gym.registry.pop(identity)
    assert limits == [3, 7]


def test_gaits_act_within_the_limits():
    for name in gaits:
        script = gait(mjgranular.envs.tasks[name]())
        action = script(0.7)
        assert action.dtype == np.float32
        assert np.abs(action).max() <= 1


def test_the_error_that_was_found_is_told_with_the_force():
    env = SandEnv("ChainSwim", medium="play_sand", law="link_distributed")
    _, info = env.reset(seed=0)
    found = found_at(findings_of("link_distributed"), info["sand/froude"])
    assert info["sand/error"] == min(found.error, 1.0)
    high = SandEnv("ChainSwim", surface=Plane(height=-1.0))
    assert high.reset(seed=0)[1]["sand/error"] == 0.0  # above the sand


def test_without_gravity_the_froude_number_is_that_of_reports():
    env = on_sand("Pusher-v5")
    env.reset(seed=0)
    info = env.step(env.action_space.high)[4]
    assert info["sand/froude"] == 0.0
    assert info["sand/valid"] is True


@pytest.mark.parametrize("name", ["Ant", "Hopper"])
def test_rigid_ground_is_the_floor_of_the_robots_own_model(name):
    task = tasks[name](rigid=math.inf)
    env = SandEnv(task)
    env.reset(seed=0)
    spec = task.robot()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.density = spec.option.viscosity = 0.0
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = env.data.qpos, env.data.qvel
    action = np.zeros(model.nu, np.float32)
    for _ in range(20):
        info = env.step(action)[4]
        mujoco.mj_step(model, data, task.frame_skip)
        assert info["sand/force"].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_allclose(env.data.qpos, data.qpos, atol=1e-9)


@pytest.mark.parametrize("name", ["ChainSwim", "Swimmer", "LinkDrop"])
def test_what_does_not_stand_on_the_ground_has_no_rigid_ground(name):
    with pytest.raises(InputError, match="rigid"):
        _ = tasks[name](rigid=0.0).model


def test_rigid_ground_has_the_contacts_of_the_floor_that_carries():
    class Drawn(Hopper):
        def robot(self):
            spec = super().robot()
            spec.geom("floor").contype = spec.geom("floor").conaffinity = 0
            plane = mujoco.mjtGeom.mjGEOM_PLANE
            spec.worldbody.add_geom(
                type=plane, size=[9, 9, 1], pos=[0, 0, -0.1], friction=[2, 0, 0]
            )
            return spec

    for end in (0.5, math.inf):
        model = Drawn(rigid=end).model
        rigid = model.geom(RIGID)
        assert rigid.friction.tolist() == [2, 0, 0]
        assert rigid.contype.item() == 1
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        block = rigid.type.item() == mujoco.mjtGeom.mjGEOM_BOX
        assert data.geom(RIGID).xpos[2] + block * rigid.size[2] == pytest.approx(-0.1)


@pytest.mark.parametrize(("name", "right"), [("observe", "k"), ("terminated", ""), ("rewards", "")])
@pytest.mark.parametrize("several", [False, True])
def test_a_task_that_returns_another_shape_is_refused(name: str, right: str, several: bool) -> None:
    found = {"observe": np.zeros(3), "terminated": np.zeros((3, 1), bool)}
    wrong = found.get(name, {"reward_x": np.zeros((3, 1))})
    task = type("Mine", (Hopper,), {name: lambda self, *arguments: wrong})()

    def step() -> None:
        env = SandVectorEnv(task, 3) if several else SandEnv(task)
        env.reset(seed=0)
        env.step(env.action_space.sample())

    with pytest.raises(InputError, match=rf"Mine.{name} .* \(n, ?{right}\)"):
        step()
