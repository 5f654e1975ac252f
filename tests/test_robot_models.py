"""Models of worms and hexapods: masses, poses, the sense of their joints."""

import math

import mujoco
import numpy as np
import pytest

from mjgranular import InputError
from mjgranular.models import Hexapod, Worm
from mjgranular.models.hexapod import LEGS


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
    assert worm.mass == pytest.approx(mass)
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
    assert data.xpos[1, 0] > data.xpos[2, 0] > data.xpos[5, 0]
    assert data.xpos[1:, 1] == pytest.approx(np.zeros(5), abs=1e-12)
    height = -worm.depth if posture == "level" else 0.025
    assert data.xpos[1:, 2] == pytest.approx(np.full(5, height), abs=1e-12)
    assert not model.actuator_forcelimited.any()


def test_a_positive_bend_of_an_upright_worm_lifts_its_middle():
    worm = Worm(2, length=0.5, width=0.05, posture="upright")
    qpos = worm.straight()
    qpos[2] -= 0.2  # the head down
    qpos[3] += 0.4
    _, data = posed(worm.spec(0.01), qpos)
    middle, head, tail = (data.xpos[1] + data.xpos[2]) / 2, data.xpos[1], data.site("T1").xpos
    joint = data.xanchor[3]
    assert joint[2] > max(middle[2], head[2] - 1e-9, tail[2])


def test_a_hexapod_stands_and_its_legs_go_where_they_say():
    robot = Hexapod()
    model, data = posed(robot.spec(0.01), robot.start())
    assert model.body_mass.sum() == pytest.approx(robot.mass, rel=1e-12)
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


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Worm(width=0.0), "the worm's width must be positive, not 0.0"),
        (lambda: Worm(posture="curled"), "posture must be one of level, upright, not 'curled'"),
        (lambda: Worm(0), "a worm has one link or more, not 0"),
        (lambda: Worm(armature=-1.0), "armature must be finite"),
        (lambda: Hexapod(lower=-0.1), "the hexapod's lower must be positive, not -0.1"),
    ],
)
def test_sizes_that_cannot_be_are_named(make, message):
    with pytest.raises(InputError, match=message):
        make()
