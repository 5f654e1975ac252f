"""Models of worms, hexapods and a measured robot: masses, poses, the sense of their joints."""

import math
from itertools import pairwise

import mujoco
import numpy as np
import pytest

from mjgranular import InputError, Sand
from mjgranular.models import Hexapod, LiRobot, Worm
from mjgranular.models.hexapod import LEGS
from mjgranular.shape.shells import mesh_faces


def posed(spec, qpos):
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize("posture", ["level", "upright"])
def test_a_worm_is_a_cylinder_of_its_length(posture):
    worm = Worm(5, length=0.5, width=0.05, density=1200.0, posture=posture)
    model, data = posed(worm.spec(0.01), worm.straight())
    mass = 1200 * math.pi * 0.025**2 * 0.5
    assert model.body_mass.sum() == pytest.approx(mass, rel=1e-12)
    # Its moment of inertia across, from those of its links: that of the whole cylinder.
    across = data.subtree_com[1]
    inertia = 0.0
    for body in range(1, model.nbody):
        turn = data.ximat[body].reshape(3, 3)
        own = turn @ np.diag(model.body_inertia[body]) @ turn.T
        arm = data.xipos[body] - across
        inertia += own[2, 2] + model.body_mass[body] * (arm[0] ** 2 + arm[1] ** 2)
    assert inertia == pytest.approx(mass * (3 * 0.025**2 + 0.5**2) / 12, rel=1e-9)
    # The head is ahead, and the body along x, at its depth or on the floor.
    ahead = [data.body(f"link{i}").xpos[0] for i in range(5)]
    assert ahead == pytest.approx([0.2, 0.1, 0.0, -0.1, -0.2], abs=1e-12)
    assert data.xpos[1:, 1] == pytest.approx(np.zeros(5), abs=1e-12)
    height = -worm.depth if posture == "level" else 0.025
    assert data.xpos[1:, 2] == pytest.approx(np.full(5, height), abs=1e-12)


@pytest.mark.parametrize("posture", ["level", "upright"])
@pytest.mark.parametrize("count", [1, 2, 3, 6, 7])
def test_a_joint_is_the_angle_of_the_link_behind_it(posture, count):
    worm = Worm(count, length=0.1 * count, width=0.05, posture=posture)
    qpos, bends = worm.straight(), np.linspace(0.1, 0.4, count - 1)
    qpos[list(worm.order)] += bends
    model, data = posed(worm.spec(0.01), qpos)
    assert [model.joint(i).name for i in worm.order] == [f"q{i}" for i in range(1, count)]
    links = [data.body(f"link{i}") for i in range(count)]
    ways = [link.xmat.reshape(3, 3)[:, 2] for link in links]  # to the head
    across = [0.0, 0.0, 1.0] if posture == "level" else [0.0, -1.0, 0.0]
    turns = [np.cross(a, b) @ across for a, b in pairwise(ways)]
    assert turns == pytest.approx(np.sin(bends), abs=1e-12)
    for (ahead, a), (behind, b) in pairwise(zip(links, ways, strict=True)):
        assert ahead.xpos - 0.05 * a == pytest.approx(behind.xpos + 0.05 * b, abs=1e-12)
    assert ways[worm.root] == pytest.approx([1, 0, 0], abs=1e-12)


def test_a_positive_bend_of_an_upright_worm_lifts_its_middle():
    worm = Worm(2, length=0.5, width=0.05, posture="upright")
    qpos = worm.straight()
    qpos[2] += 0.2  # the rear link, which is the root, with its end down
    qpos[3] += 0.4
    _, data = posed(worm.spec(0.01), qpos)
    joint, links = data.joint("q1").xanchor, (data.body("link0"), data.body("link1"))
    assert all(joint[2] > link.xpos[2] for link in links)


# What no servo can change: the motion of the whole. Drawn angles, in empty space.


def robots():
    level = Worm()
    upright = Worm(length=0.6, width=0.04, posture="upright", stiffness=20, torque=4, speed=5)
    robot = Hexapod()
    return [
        pytest.param(level.spec(0.005), level.straight(), 1.0, id="level worm"),
        pytest.param(upright.spec(0.005), upright.straight(), 1.0, id="upright worm"),
        pytest.param(robot.spec(0.005), robot.start(), 0.6, id="hexapod"),
    ]


@pytest.mark.parametrize(("spec", "start", "reach"), robots())
def test_in_empty_space_the_mass_centre_stays_where_it_is(spec, start, reach):
    model, data = posed(spec, start)
    model.opt.gravity[:] = 0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    random = np.random.default_rng(0)
    speeds = []
    for _ in range(500):  # an episode, with an action each 0.04 s
        data.ctrl[:] = reach * random.uniform(-1, 1, model.nu)
        mujoco.mj_step(model, data, round(0.04 / model.opt.timestep))
        mujoco.mj_subtreeVel(model, data)
        speeds.append(np.linalg.norm(data.subtree_linvel[1]))
    assert max(speeds) < 0.03
    assert np.abs(data.qvel).max() > 1.0  # the rest does move


@pytest.mark.parametrize(("spec", "start", "reach"), robots())
def test_a_servo_is_a_direct_current_motor(spec, start, reach):
    model, data = posed(spec, start)
    stall = model.actuator_forcerange[:, 1]
    joints = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    fastest = stall / model.dof_damping[joints]
    for share in (0.0, 0.5, 1.0):
        data.ctrl[:] = reach  # far off
        data.qvel[joints] = share * fastest
        mujoco.mj_forward(model, data)
        torque = data.qfrc_actuator[joints] + data.qfrc_passive[joints]
        assert torque == pytest.approx((1 - share) * stall, abs=1e-12)


def test_a_hexapod_stands_and_its_legs_go_where_they_say():
    robot = Hexapod()
    model, data = posed(robot.spec(0.01), robot.start())
    assert model.body_mass.sum() == pytest.approx(2.46, rel=1e-12)
    assert model.nu == 12
    feet = [model.geom(f"{leg}_foot").id for leg in LEGS]
    assert data.geom_xpos[feet][:, 2] == pytest.approx(np.full(6, robot.foot), abs=1e-12)
    standing = data.geom_xpos[feet].copy()
    for joint, axis in (("swing", 0), ("lift", 2)):
        qpos = robot.start()
        for leg in LEGS:
            qpos[model.joint(f"{leg}_{joint}").qposadr[0]] = 0.3
        _, data = posed(robot.spec(0.01), qpos)
        moved = data.geom_xpos[feet] - standing
        assert (moved[:, axis] > 0.004).all(), joint
    left, right = standing[:3], standing[3:]
    assert left * [1, -1, 1] == pytest.approx(right, abs=1e-12)
    assert (np.diff(left[:, 0]) < 0).all()  # front, middle, rear


@pytest.mark.parametrize("curvature", [-1.0, -0.5, 0.0, 0.5, 1.0])
def test_a_leg_of_the_robot_of_li_is_an_arc(curvature):
    robot = LiRobot(curvature)
    model = robot.model()
    vertices, faces, _ = mesh_faces(model, model.geom("front_left").id)  # warns of no open edge
    corners = vertices[faces]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geom = data.geom("front_left")
    at = corners @ geom.xmat.reshape(3, 3).T + geom.xpos - data.joint("front_left").xanchor
    half = math.asin(abs(curvature))
    long = robot.chord * (half / math.sin(half) if half else 1.0)
    signed = np.einsum("ni,ni->n", at[:, 0], np.cross(at[:, 1], at[:, 2]))
    assert signed.sum() / 6 == pytest.approx(long * 0.01 * 0.003, rel=0.01)
    # From the hip to the tip, and where it bulges: behind a leg that hangs down.
    assert at[..., 2].min() == pytest.approx(-0.041, abs=0.0016)
    deep = robot.chord / 2 * math.tan(half / 2)
    bulge = -at[..., 0] if curvature >= 0 else at[..., 0]
    assert bulge.max() == pytest.approx(deep + 0.0015, abs=1e-4)
    assert model.body_mass.sum() == pytest.approx(0.15)


def test_the_robot_of_li_walks_ahead_at_a_constant_rate():
    robot = LiRobot()
    sand = Sand(robot.model(), medium="poppy_seed_loose", instead_of="floor")
    data = mujoco.MjData(sand.model)
    data.qpos, data.qvel, data.ctrl = robot.start(1.0)
    for _ in range(2000):
        sand.step(data)
    assert data.qpos[3:] - robot.start(1.0)[0][3:] == pytest.approx(4 * math.pi, abs=0.01)
    assert 0.1 < data.qpos[0] / 2 < 0.2  # measured: 0.075 and 0.173 m/s at 0.47 and 1.2 Hz


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Worm(width=0.0), "the worm's width must be positive and finite, got 0.0"),
        (lambda: Worm(posture="curled"), "posture must be level or upright, got 'curled'"),
        (lambda: Worm(0), "Worm: count"),
        (lambda: LiRobot(1.5), "curvature must be from -1 to 1, got 1.5"),
    ],
)
def test_sizes_that_cannot_be_are_named(make, message):
    with pytest.raises(InputError, match=message):
        make()
