"""The Go1 by its name, and its task of commanded velocities."""

import itertools
import math
import sys
from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar
from xml.etree import ElementTree

import gymnasium as gym
import mujoco
import numpy as np
import pytest

from mjgranular import InputError, UnknownNameError
from mjgranular.envs import SandRanges, SandVectorEnv
from mjgranular.envs.single import SandEnv
from mjgranular.envs.velocity import G1Velocity, Gait, Go1Velocity, Go2Velocity, Motor
from mjgranular.experiment.drop import Drop, load
from mjgranular.models import robot_path
from mjgranular.models.hexapod import LEGS, Hexapod

STILL = {"push_scale": 0.0, "reset_noise_scale": 0.0}
STAND = {"command_x": (0.0, 0.0), "command_y": (0.0, 0.0), "command_yaw": (0.0, 0.0)}
ZERO = np.zeros(12, np.float32)


@pytest.fixture(autouse=True)
def go1(robots):
    return robots / "unitree_go1" / "go1.xml"


class Menagerie:
    """The documented interface of the package mujoco-menagerie, without a network."""

    class MenagerieError(Exception):
        pass

    default_model = "go1"

    @staticmethod
    def names():
        return ["unitree_g1", "unitree_go1"]

    def get(self, name):
        return self

    def path(self, progress):
        raise self.MenagerieError("no network")


def test_a_robot_is_found_by_its_name_or_its_path(go1, monkeypatch):
    assert robot_path("unitree_go1") == go1
    assert robot_path(go1) == go1
    model, _ = load(Drop("unitree_go1"))
    assert model.body("trunk").id > 0
    monkeypatch.delenv("MENAGERIE_ROOT")
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", Menagerie())
    with pytest.raises(InputError, match=r"no network; give the path .* unitree_go1/go1\.xml"):
        robot_path("unitree_go1")
    with pytest.raises(UnknownNameError, match="unitree_go1"):
        robot_path("unitree_go")
    with pytest.raises(InputError, match="a name or a path, not None"):
        robot_path(None)
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    with pytest.raises(InputError, match=r"mjgranular\[robots\].*; or give the path of its MJCF"):
        gym.make("mjgranular/Go1Velocity-v0")


def test_another_robot_is_refused_by_its_joints():
    with pytest.raises(InputError, match="must have the bodies FR_calf"):
        SandEnv(Go1Velocity(robot_file=mujoco_humanoid()))


def test_files_that_are_not_such_a_robot_are_named(go1, tmp_path):
    def made_from(old, new):
        file = tmp_path / "robot.xml"
        text = go1.read_text().replace('meshdir="', f'meshdir="{go1.parent}/')
        assert old in text
        file.write_text(text.replace(old, new, 1))
        return SandEnv(Go1Velocity(robot_file=file))

    with pytest.raises(InputError, match=r"nothing\.xml"):
        SandEnv(Go1Velocity(robot_file="nothing.xml"))
    with pytest.raises(InputError, match="must be a free joint"):
        made_from('<freejoint name="floating_base_joint"/>', "")
    with pytest.raises(InputError, match="must have the bodies FR_calf"):
        made_from('<body name="FR_calf"', '<body name="FR_shin"')
    with pytest.raises(InputError, match="go1 has no gravity"):
        made_from("<worldbody>", '<option gravity="0 0 0"/><worldbody>')
    floor = '<worldbody><geom name="floor" type="plane" size="1 1 1"/>'
    observation, _ = made_from("<worldbody>", floor).reset(seed=0)
    assert observation.shape == (47,)


def mujoco_humanoid():
    from gymnasium.envs import mujoco as robots

    return f"{robots.__path__[0]}/assets/humanoid.xml"


@pytest.mark.parametrize("robot", [Go1Velocity, pytest.param(Go2Velocity, marks=pytest.mark.slow)])
def test_it_stands_with_its_weight_on_its_feet(robot):
    task = robot(**STILL, **STAND)
    env = SandEnv(task)
    observation, info = env.reset(seed=0)
    reward = 0.0
    for _ in range(100):
        observation, reward, terminated, _, info = env.step(ZERO)
        assert not terminated
    weight = task.model.body_mass.sum() * 9.81
    assert info["sand/force"][2] == pytest.approx(weight, rel=0.02)
    assert info["sand/depth"] < 0.05
    assert observation[:3] == pytest.approx([0, 0, -1], abs=0.05)
    assert 7 * task.dt < reward < 8 * task.dt
    assert sum(info[name] for name in info if name.startswith("reward_")) == pytest.approx(reward)


def test_a_robot_on_two_legs_meets_the_sand_with_its_soles():
    task = G1Velocity(**STILL, **STAND, privileged=True)
    model = task.model
    assert (model.nu, model.nv) == (12, 18)  # waist and arms are locked
    feet = [model.geom(f"{side}_ankle_roll_link sole") for side in ("left", "right")]
    for foot in feet:
        length, width, height = 2 * foot.size
        assert 0.19 < length < 0.22
        assert 0.06 < width < 0.08
        assert foot.pos[2] + height / 2 == pytest.approx(0.0)
    env = SandEnv(task)
    _, info = env.reset(seed=0)
    assert info["privileged"].shape == (13,)
    assert info["privileged"][3:5] == pytest.approx([0.0, 0.0], abs=2e-3)
    terminated = False
    for _ in range(15):
        _, _, terminated, _, info = env.step(ZERO)
    assert not terminated
    weight = model.body_mass.sum() * 9.81
    assert info["sand/force"][2] == pytest.approx(weight, rel=0.3)
    assert 0.0 < info["sand/depth"] < 0.03
    # It keeps no balance: the policy has to.
    for _ in range(85):
        terminated = env.step(ZERO)[2]
        if terminated:
            break
    assert terminated


def test_the_scripted_walk_lifts_one_leg_in_turn_with_level_soles():
    env = SandEnv(G1Velocity(**STILL, **{**STAND, "command_x": (0.4, 0.4)}))
    env.reset(seed=0)
    task, targets = env.task, []
    for step in range(25, 65):  # after half a second of standing
        env.data.userdata[0] = step
        env.state.found.clear()
        targets.append(task._trot(env.state)[0].reshape(2, 6))
    hip, knee, ankle = (np.array(targets)[:, :, part] for part in (0, 3, 4))
    assert np.abs(hip + knee + ankle).max() == pytest.approx(0.0, abs=1e-12)
    assert knee.max(axis=0) == pytest.approx([0.7, 0.7], rel=0.01)
    assert np.all(knee.min(axis=1) == 0.0)


@pytest.mark.parametrize("times", [(0.0, 0.0), (0.1, 0.4), (0.5, 0.5)])
def test_the_first_command_comes_after_a_time_that_is_drawn(times):
    env = SandEnv(Go1Velocity(**STILL, settling_time=times, command_x=(0.4, 0.4)))
    shortest, longest = np.round(np.array(times) / env.task.dt)
    firsts = set()
    for seed in range(12):
        env.reset(seed=seed)
        firsts.add(env.task.drawn(env.state)["commands"][0, 1, 0])
    assert shortest <= min(firsts) <= max(firsts) <= longest
    assert len(firsts) == 1 if shortest == longest else len(firsts) > 4
    step = 0
    while not env.task.command(env.state).any():
        env.step(ZERO)
        step += 1
    assert step == env.task.drawn(env.state)["commands"][0, 1, 0]


def test_only_the_motors_limit_torques(robots, tmp_path):
    limits = 'range="-2.5307 2.8798"'
    text = (robots / "unitree_g1" / "g1.xml").read_text()
    assert limits in text
    file = tmp_path / "g1.xml"  # as in MuJoCo Menagerie
    file.write_text(text.replace(limits, f'{limits} actuatorfrcrange="-88 88"'))
    assert not G1Velocity(robot_file=file).model.jnt_actfrclimited.any()


def test_what_refers_to_a_locked_joint_is_an_error(robots, tmp_path):
    text = (robots / "unitree_g1" / "g1.xml").read_text()
    tendon = '<tendon><fixed><joint joint="waist_yaw_joint" coef="1"/></fixed></tendon></mujoco>'
    file = tmp_path / "g1.xml"
    file.write_text(text.replace("</mujoco>", tendon))
    with pytest.raises(InputError, match="waist_yaw_joint"):
        SandEnv(G1Velocity(robot_file=file))


def test_legs_may_be_in_any_order(go1, tmp_path):
    tree = ElementTree.parse(go1)
    trunk = tree.find("worldbody/body")
    legs = {body.get("name")[:2]: body for body in trunk.findall("body")}
    for leg in ("FL", "FR", "RL", "RR"):  # as in the Go2's file
        trunk.remove(legs[leg])
        trunk.append(legs[leg])
    tree.find("compiler").set("meshdir", f"{go1.parent}/assets")
    tree.write(tmp_path / "go1.xml")
    envs = [SandEnv(Go1Velocity(robot_file=file, **STILL)) for file in (go1, tmp_path / "go1.xml")]
    one, other = envs
    assert list(other.task._angles) != list(one.task._angles)
    np.testing.assert_array_equal(*(env.reset(seed=0)[0] for env in envs))
    one.action_space.seed(0)
    for _ in range(20):
        action = 0.3 * one.action_space.sample()
        seen, same = (env.step(action) for env in envs)
        # 1e-6 with MuJoCo 4.0, 8e-6 with 3.17: other orders round otherwise.
        assert same[0] == pytest.approx(seen[0], abs=1e-5)
        assert same[1] == pytest.approx(seen[1], abs=1e-7)


def test_velocities_are_those_of_the_trunk_in_its_own_frame():
    env = SandEnv(Go1Velocity(**STILL))
    _, info = env.reset(seed=1)
    for _ in range(10):
        _, _, _, _, info = env.step(env.action_space.sample())
    mujoco.mj_forward(env.model, env.data)
    found = np.zeros(6)
    mujoco.mj_objectVelocity(env.model, env.data, mujoco.mjtObj.mjOBJ_XBODY, 1, found, 1)
    assert info["velocity"] == pytest.approx(found[3:], abs=1e-9)
    assert env.task.observe(env.state)[0, 3:6] == pytest.approx(found[:3], abs=1e-9)


def test_gravity_leans_with_the_slope():
    ranges = SandRanges(slope=(0.1, 0.1))
    env = SandEnv(Go1Velocity(**STILL, randomise=ranges))
    observation, _ = env.reset(seed=0)
    turn = env.data.body("trunk").xmat.reshape(3, 3)
    assert observation[:3] == pytest.approx(turn.T @ env.model.opt.gravity / 9.81, abs=1e-9)


def test_commands_and_pushes_come_within_an_episode():
    env = gym.make("mjgranular/Go1Velocity-v0", command_x=(-0.7, 0.7), reset_noise_scale=0.0)
    task = env.unwrapped.task
    env.reset(seed=4)
    seen, jumps = set(), 0
    for _ in range(450):
        before = env.unwrapped.data.qvel.copy()
        _, _, terminated, _, info = env.step(ZERO)
        seen.add(tuple(info["command"]))
        assert np.all(np.abs(info["command"]) <= [0.7, 0.4, 1.0])
        jumps += int(np.abs(env.unwrapped.data.qvel[:3] - before[:3]).max() > 0.1)
        if terminated:
            break
    assert len(seen) > 1
    assert jumps >= 2
    commands = np.array([task._draw_commands(np.random.default_rng(k)) for k in range(300)])
    assert np.array_equal(commands[:, :2, 0], np.tile([0, 25], (300, 1)))
    assert not commands[:, 0, 1:].any()  # to stand, until it carries itself
    commands = commands[:, 1:]
    stand = np.all(commands[:, :, 1:] == 0, axis=2).mean()
    ahead = np.mean((commands[:, :, 1] > 0) & (commands[:, :, 2] == 0))
    assert stand == pytest.approx(0.1, abs=0.02)
    assert ahead == pytest.approx(0.2, abs=0.03)
    assert np.all(np.diff(commands[:, :, 0], axis=1) >= 3.0 / task.dt)


def test_a_fall_ends_the_episode():
    env = SandEnv(Go1Velocity(**STILL))
    env.reset(seed=0)
    env.data.qpos[3:7] = math.cos(0.7), math.sin(0.7), 0, 0  # 80 degrees
    assert env.task.terminated(env.state)[0]
    env.data.qpos[3:7] = 1, 0, 0, 0
    assert not env.task.terminated(env.state)[0]
    env.data.qpos[2] = 0.065
    assert not env.task.terminated(env.state)[0]
    env.data.qpos[2] = 0.055  # the head is in the sand
    assert env.task.terminated(env.state)[0]


def test_a_trunk_near_the_sand_is_penalized():
    env = SandEnv(Go1Velocity(height_weight=10.0, **STILL))
    env.reset(seed=0)
    for height in (0.12, 0.15, 0.17, 0.3):
        env.data.qpos[2] = height
        *_, info = env.step(np.zeros(12))
        spare = env.data.qpos[2] - 0.06  # where an episode ends
        wanted = 10.0 * env.task.dt * min(spare - 0.1, 0.0)
        assert info["reward_height"] == pytest.approx(wanted, abs=1e-5)


def test_heights_are_those_over_the_drawn_surface():
    task = Go1Velocity(randomise={"surfaces": ("plane", "dunes")})
    state = SimpleNamespace(active=np.array([1, 0]))
    heights = task._ground(state, np.array([[[1.0, 2.0, 0.3]], [[1.0, 2.0, 0.3]]]))
    assert heights.tolist() == [[task.dunes.height(1.0, 2.0)], [0.0]]


@pytest.mark.slow
def test_drawn_sand_in_a_batch_is_that_of_single_environments():
    media = ("quikrete_medium", "poppy_seed_loose")
    ranges = SandRanges(strength=(0.5, 2.0), slope=(-0.1, 0.1), media=media)
    options = {"randomise": ranges, "observe_sand": True, "history": 1}
    batch = SandVectorEnv("Go1Velocity", 2, max_episode_steps=8, **options)
    make = [lambda: gym.make("mjgranular/Go1Velocity-v0", max_episode_steps=8, **options)] * 2
    sync = gym.vector.SyncVectorEnv(make)
    assert np.array_equal(batch.reset(seed=2)[0], sync.reset(seed=2)[0])
    for _ in range(20):
        actions = sync.action_space.sample()
        for one, other in zip(batch.step(actions)[:4], sync.step(actions)[:4], strict=True):
            assert np.array_equal(one, other)


def test_the_clock_runs_unless_the_command_is_to_stand():
    walking = {**STAND, "command_x": (0.5, 0.5)}
    for options, moves in ((STAND, False), (walking, True)):
        env = SandEnv(Go1Velocity(**STILL, **options))
        env.reset(seed=0)
        clocks = [env.step(ZERO)[0][45:] for _ in range(50)]
        sizes = np.linalg.norm(clocks, axis=1)
        assert not sizes[:24].any()
        assert sizes[24:] == pytest.approx(np.full(26, float(moves)))


def test_a_command_of_ones_own():
    for env in (SandEnv(Go1Velocity(history=1)), SandVectorEnv("Go1Velocity", 2, history=1)):
        env.reset(seed=0)
        task, n = env.task, len(env.state.qpos)
        action = np.zeros(env.action_space.shape, np.float32)
        for command in ((0.5, 0.0, -0.25), np.linspace(0.0, 0.4, 3 * n).reshape(n, 3)):
            task.set_command(env.state, command)
            for _ in range(3):
                info = env.step(action)[-1]
                known = np.reshape(info["command"], (n, 3))
                assert np.array_equal(known, np.broadcast_to(command, (n, 3)))
        for wrong in ((0.5, 0.0), (0.5, math.nan, 0.0), np.zeros((n + 1, 3)), "ahead", [1, [2]]):
            with pytest.raises(InputError, match="three finite numbers"):
                task.set_command(env.state, wrong)
        drawn = env.reset(seed=0)[1]["command"]
        assert not np.any(drawn)  # the next episode has its own


def test_a_history_has_what_was_sensed_before():
    env = SandEnv(Go1Velocity(**STILL, history=2))
    seen = [env.reset(seed=0)[0]]
    assert seen[0].shape == (47 + 2 * 42,)
    assert not seen[0][47:].any()
    seen += [env.step(env.action_space.sample())[0] for _ in range(4)]
    for before, after in itertools.pairwise(seen):
        assert np.array_equal(after[47:89], before[:42])
        assert np.array_equal(after[89:], before[47:89])
    assert not env.reset(seed=1)[0][47:].any()
    for wrong in (-1, 1.5, True):
        with pytest.raises(InputError, match="history"):
            Go1Velocity(history=wrong)


def test_part_of_the_ground_can_be_rigid():
    weight = Go1Velocity(**STILL).model.body_mass.sum() * 9.81
    for rigid, share in ((math.inf, 0.0), (-1.0, 1.0), (-math.inf, 1.0)):
        env = SandEnv(Go1Velocity(**STILL, **STAND, rigid=rigid))
        env.reset(seed=0)
        info = {}
        for _ in range(100):
            _, _, terminated, _, info = env.step(ZERO)
            assert not terminated
        assert info["sand/force"][2] / weight == pytest.approx(share, abs=0.03)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rigid": math.nan}, "within 1000 m, or inf, not nan"),
        ({"rigid": -2000.0}, "within 1000 m, or inf, not -2000"),
        ({"rigid": "0.5"}, "within 1000 m, or inf, not '0.5'"),
        ({"rigid": True}, "within 1000 m, or inf, not True"),
        ({"rigid": 0.5, "surface": "plane slope=0.1"}, "level sand"),
        ({"rigid": 0.5, "randomise": {"surfaces": ("plane", "dunes")}}, "level sand"),
    ],
)
def test_a_rigid_ground_that_cannot_be_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        _ = Go1Velocity(**options).model


def test_commands_are_finite():
    with pytest.raises(InputError, match=r"command_x must be a range of finite numbers"):
        Go1Velocity(command_x=(0.0, math.inf))


def test_targets_follow_from_the_state_where_a_command_changes():
    class Stops(Go1Velocity):
        def _draw_commands(self, random):
            table = super()._draw_commands(random)
            table[:, 0] = np.inf
            table[:2] = [[0, 0.5, 0, 0], [6, 0, 0, 0]]
            return table

    env = SandEnv(Stops(**STILL))
    env.reset(seed=0)
    for _ in range(5):
        env.step(ZERO)
    userdata, state = env.data.userdata.copy(), env.state
    first = env.task.act(ZERO[None], state)
    env.data.userdata[:] = userdata
    state.found.clear()
    assert np.array_equal(env.task.act(ZERO[None], state), first)
    assert np.array_equal(first[0], env.task._stance)


def test_motors_are_drawn_in_strength_and_delay():
    drawn = {"motor_strength": (0.7, 1.3), "delay": (0, 2), "privileged": True}
    batch = SandVectorEnv("Go1Velocity", 3, **drawn)
    singles = [SandEnv("Go1Velocity", **drawn) for _ in range(3)]
    observations, info = batch.reset(seed=4)
    rng = np.random.default_rng(0)
    for number, env in enumerate(singles):
        observation, alone = env.reset(seed=4 + number)
        np.testing.assert_array_equal(observation, observations[number])
        np.testing.assert_array_equal(alone["privileged"], info["privileged"][number])
    strength, delay = info["privileged"][:, 13], info["privileged"][:, 14]
    assert len(set(strength)) == 3
    assert ((strength > 0.7) & (strength < 1.3)).all()
    assert set(delay) <= {0.0, 1.0, 2.0}
    for _ in range(4):
        actions = rng.uniform(-0.3, 0.3, (3, 12)).astype(np.float32)
        observations, _, _, _, info = batch.step(actions)
        for number, env in enumerate(singles):
            observation, _, _, _, alone = env.step(actions[number])
            np.testing.assert_array_equal(observation, observations[number])
            np.testing.assert_array_equal(alone["privileged"], info["privileged"][number])
    for number, env in enumerate(singles):
        full = env.task.model.actuator_gainprm[0, 0]
        assert env.model.actuator_gainprm[0, 0] == pytest.approx(full * strength[number])


def test_a_delay_gives_the_targets_of_an_earlier_step():
    late, punctual = (SandEnv("Go1Velocity", delay=(steps, steps), **STILL) for steps in (2, 0))
    late.reset(seed=0)
    punctual.reset(seed=0)
    wanted = []
    for step in range(5):
        action = np.full(12, 0.01 * step, np.float32)
        late.step(action)
        punctual.step(action)
        wanted.append(punctual.data.ctrl.copy())
        before = late.task._stance if step < 2 else wanted[step - 2]
        np.testing.assert_allclose(late.data.ctrl, before, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"motor_strength": (0.0, 1.0)}, "motor_strength must be a range"),
        ({"delay": (0, 9)}, "delay must be at most 3"),
        ({"delay": (0, 0.5)}, "delay must be an integer"),
        ({"delay": (True, 2)}, "delay must be an integer"),
        ({"motor_strength": 1.0}, "range"),
        ({"settling_time": (-0.1, 0.5)}, "settling_time must be a range"),
        ({"settling_time": (0.5, 0.1)}, "range"),
    ],
)
def test_motors_and_times_that_cannot_be_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        Go1Velocity(**options)


@dataclass(frozen=True, kw_only=True)
class Insect(Go1Velocity):
    """The package's hexapod with three joints in each leg."""

    title = "a robot of your own follows commands"
    feet: ClassVar = dict(zip((f"{leg}_knee" for leg in LEGS), (1, -1, 1, -1, 1, -1), strict=True))
    motors: ClassVar = {
        "swing": Motor(3.0, 2e-3, 12.0, 0.25),
        "lift": Motor(3.0, 2e-3, 12.0, 0.25),
        "twist": Motor(3.0, 2e-3, 12.0, 0.25),
    }
    stance = 18 * (0.0,)
    pose = 18 * (0.3,)
    gait = Gait(2.0, 0.03, 0.07, 1.0, (0.0, 0.5, 0.0), (-1.0, 0.0, 0.0))

    def load(self):
        spec = Hexapod().spec(0.005)
        for leg in LEGS:
            knee = spec.body(f"{leg}_knee")
            knee.add_joint(name=f"{leg}_twist", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
        return spec


def test_a_robot_of_ones_own_follows_commands():
    task = Insect(
        **STILL, command_x=(0.1, 0.1), command_y=(0, 0), command_yaw=(0, 0),
        history=1, delay=(2, 2), privileged=True,
    )  # fmt: skip
    env, batch = SandEnv(task), SandVectorEnv(task, 2)
    observation, info = env.reset(seed=0)
    observations, _ = batch.reset(seed=0)
    heading = env.data.xmat[1].reshape(3, 3)[:, 0].copy()
    assert observation.shape == (6 + 3 * 18 + 5 + 6 + 3 * 18,)
    assert info["privileged"].shape == (3 + 6 + 8,)
    still = np.zeros(18, np.float32)
    for _ in range(100):
        observation, _, terminated, _, info = env.step(still)
        observations, *_ = batch.step(np.stack([still, still]))
        assert not terminated
    assert (observations[0] == observation).all()
    assert info["sand/depth"] < 0.05  # its legs bear it
    assert heading[:2] @ env.data.qpos[:2] > 0.03  # in 1.5 s at up to 0.1 m/s


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"stance": (0.0,)}, "Mine.stance must have 18 numbers, not 1"),
        ({"gait": Go1Velocity.gait._replace(stride=(1, 0))}, "Mine.gait.stride must have 3"),
        ({"motors": {"swing": Motor(3.0, 2e-3)}}, "Mine.stance must have 6 numbers, not 18"),
        (
            {"feet": {"torso": 1}, "stance": (0,) * 3, "pose": (0,) * 3},
            "hinges swing, .*, not none",
        ),
    ],
)
def test_what_a_robot_of_ones_own_lacks_is_said(changed, said):
    mine = dataclass(frozen=True, kw_only=True)(type("Mine", (Insect,), changed))
    with pytest.raises(InputError, match=said):
        SandEnv(mine())


def test_a_trunk_that_collides_with_nothing_needs_the_height_of_an_end(monkeypatch):
    spec = Insect().load()
    spec.geom("torso").conaffinity = 0
    monkeypatch.setattr(Insect, "load", lambda self: spec)
    with pytest.raises(InputError, match=r"set Insect\.low"):
        SandEnv(Insect())


def test_a_missing_mesh_is_named(tmp_path, go1):
    file = tmp_path / "robot.xml"
    file.write_text(go1.read_text())
    with pytest.raises(InputError, match="Error opening file"):
        SandEnv(Go1Velocity(robot_file=file))
