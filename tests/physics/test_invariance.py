"""What the force may not depend on, and what it must never do."""

import importlib
import math
import sys
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjgranular import Plane, Sand

ROD = """
<mujoco>
  <option gravity="{gravity}"/>
  <worldbody>
    <body>
      <freejoint/>
      <inertial pos="0.01 0.02 -0.03" mass="0.1" diaginertia="1e-3 2e-3 2e-3"/>
      <geom name="rod" type="capsule" fromto="{start} {end}" size="0.006"/>
    </body>
  </worldbody>
</mujoco>
"""
START, END = "0 0.01 -0.12", "0.02 0 0.1"
LAWS = ["link", "link_distributed"]


def number(low, high):
    return st.floats(low, high, allow_subnormal=False)


def triple(size):
    return st.tuples(*[number(-size, size)] * 3)


QUATERNIONS = st.tuples(*[number(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1)
POSES = st.tuples(triple(0.1), QUATERNIONS)
MOTIONS = st.tuples(triple(5), triple(20))


def rod(start=START, end=END, gravity=(0, 0, -9.81)):
    # Rounded: MuJoCo 3.17 reads no 1e-46.
    text = " ".join(str(round(float(number), 15)) for number in gravity)
    return mujoco.MjModel.from_xml_string(ROD.format(start=start, end=end, gravity=text))


LEVEL = rod()
REVERSED = rod(END, START)
UPRIGHT = rod("0 0 -0.114", "0 0 0.1")
MIRRORED = rod("0 0 -0.114", "0 0 0.1")
MIRRORED.body_ipos[1, 0] *= -1
FLAT = rod("-0.1 0 0", "0.1 0 0")


def matrix(quaternion):
    quaternion = np.array(quaternion) / np.linalg.norm(quaternion)
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quaternion)
    return out.reshape(3, 3)


def quaternion(rotation):
    out = np.zeros(4)
    mujoco.mju_mat2Quat(out, np.ascontiguousarray(rotation).ravel())
    return out


@cache
def level_sand(model, law):
    """Sand on one of the models that are kept."""
    return Sand(model, law=law, scheme="explicit")


def sanded(sand, pose, motion):
    """Force and moment on the free body, and the report.

    `pose` is position and rotation matrix; `motion` linear and angular velocity, world frame.
    """
    (position, rotation), (linear, angular) = pose, motion
    data = mujoco.MjData(sand.model)
    data.qpos[:3], data.qpos[3:] = position, quaternion(rotation)
    data.qvel[:3], data.qvel[3:] = linear, rotation.T @ angular  # MuJoCo's is in the body frame
    report = sand.report(data)
    (body,) = report.bodies
    return body.force, body.moment, report


def drawn(pose, motion):
    (position, q), (linear, angular) = pose, motion
    return (np.array(position), matrix(q)), (np.array(linear), np.array(angular))


def assert_same(found, expected):
    force = float(np.linalg.norm(expected[0]))
    assert found[0] == pytest.approx(expected[0], abs=1e-9 * force + 1e-12)
    assert found[1] == pytest.approx(expected[1], abs=1e-9 * force + 1e-12)


def keep_off_signs(report):
    """Whether rounding can turn the static force over: the states at which it jumps."""
    return all(
        element.immersed_length == 0
        or min(abs(element.velocity[2]), np.linalg.norm(element.velocity[:2])) > 1e-6
        for element in report.elements
    )


@pytest.mark.parametrize("law", LAWS)
@given(pose=POSES, motion=MOTIONS)
def test_no_force_above_the_surface(law, pose, motion):
    (position, rotation), motion = drawn(pose, motion)
    position[2] = 0.13  # farther than its longest reach below the origin
    force, moment, report = sanded(level_sand(LEVEL, law), (position, rotation), motion)
    assert not force.any()
    assert not moment.any()
    assert report.bodies[0].depth < 0
    assert report.bodies[0].immersed_length == 0
    assert report.bodies[0].power == 0


@pytest.mark.parametrize("law", LAWS)
@given(pose=POSES, motion=MOTIONS, along=st.tuples(number(-2, 2), number(-2, 2)))
def test_sliding_the_scene_along_the_surface(law, pose, motion, along):
    pose, motion = drawn(pose, motion)
    expected = sanded(level_sand(LEVEL, law), pose, motion)
    if keep_off_signs(expected[2]):
        moved = (pose[0] + [*along, 0], pose[1])
        assert_same(sanded(level_sand(LEVEL, law), moved, motion), expected)


@pytest.mark.parametrize("law", LAWS)
@given(pose=POSES, motion=MOTIONS, angle=number(-math.pi, math.pi))
def test_turning_the_scene_about_the_normal(law, pose, motion, angle):
    pose, motion = drawn(pose, motion)
    expected = sanded(level_sand(LEVEL, law), pose, motion)
    if keep_off_signs(expected[2]):
        R = matrix([math.cos(angle / 2), 0, 0, math.sin(angle / 2)])
        turned = sanded(
            level_sand(LEVEL, law), (R @ pose[0], R @ pose[1]), (R @ motion[0], R @ motion[1])
        )
        assert_same(turned, (R @ expected[0], R @ expected[1]))


@pytest.mark.parametrize("law", LAWS)
@given(pose=POSES, motion=MOTIONS)
def test_mirroring_the_scene(law, pose, motion):
    # In the plane x = 0; the other body has its centre of mass on the other side of the rod.
    pose, motion = drawn(pose, motion)
    expected = sanded(level_sand(UPRIGHT, law), pose, motion)
    if keep_off_signs(expected[2]):
        M = np.diag([-1.0, 1.0, 1.0])
        place, moving = (M @ pose[0], M @ pose[1] @ M), (M @ motion[0], -M @ motion[1])
        found = sanded(level_sand(MIRRORED, law), place, moving)
        assert_same(found, (M @ expected[0], -M @ expected[1]))


@pytest.mark.parametrize("law", LAWS)
@given(
    pose=POSES,
    motion=MOTIONS,
    slope=number(-1.5, 1.5),
    uphill=number(-4, 4),
    height=number(-1, 1),
)
def test_tilting_the_whole_scene(law, pose, motion, slope, uphill, height):
    pose, motion = drawn(pose, motion)
    expected = sanded(level_sand(LEVEL, law), pose, motion)
    if keep_off_signs(expected[2]):
        # Steepest ascent towards `uphill`: about the level line across it.
        axis = np.array([math.sin(uphill), -math.cos(uphill), 0.0])
        R = matrix([math.cos(slope / 2), *(math.sin(slope / 2) * axis)])
        tilted = rod(gravity=R @ [0, 0, -9.81])
        surface = Plane(height, slope, uphill)
        place = (R @ pose[0] + [0, 0, height], R @ pose[1])
        sand = Sand(tilted, law=law, surface=surface, scheme="explicit")
        found = sanded(sand, place, (R @ motion[0], R @ motion[1]))
        assert_same(found, (R @ expected[0], R @ expected[1]))


@given(slope=number(-1.5, 1.5), uphill=number(-4, 4), height=number(-1, 1))
def test_plane_rises_uphill(slope, uphill, height):
    # z = height + tan(slope) * (distance uphill), its normal upright.
    n = Plane(height, slope, uphill).normal
    assert np.linalg.norm(n) == pytest.approx(1)
    assert n[2] > 0
    point = np.array([math.cos(uphill), math.sin(uphill), math.tan(slope)])
    assert n @ point == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("law", LAWS)
@given(pose=POSES, motion=MOTIONS)
def test_power_is_never_positive(law, pose, motion):
    _, _, report = sanded(level_sand(LEVEL, law), *drawn(pose, motion))
    for element in report.elements:
        assert element.power <= 0
    for body in report.bodies:
        assert body.power <= 0


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@given(pose=POSES, motion=MOTIONS)
def test_which_end_of_the_geom_comes_first(law, pose, motion):
    pose, motion = drawn(pose, motion)
    expected = sanded(level_sand(LEVEL, law), pose, motion)
    if keep_off_signs(expected[2]):
        assert_same(sanded(level_sand(REVERSED, law), pose, motion), expected)


@given(pose=POSES, motion=MOTIONS)
def test_deeper_end_counts_and_no_more_than_the_rod_is_immersed(pose, motion):
    pose, motion = drawn(pose, motion)
    pose[0][2] -= 0.3 * (motion[0][2] > 0)  # half of them buried
    _, _, report = sanded(level_sand(LEVEL, "link"), pose, motion)
    (element,) = report.elements
    ends = np.array([[0, 0.01, -0.12], [0.02, 0, 0.1]])
    axis = ends[1] - ends[0]
    length = np.linalg.norm(axis) + 2 * 0.006
    poles = np.array(
        [
            ends[0] - 0.006 * axis / np.linalg.norm(axis),
            ends[1] + 0.006 * axis / np.linalg.norm(axis),
        ]
    )
    depths = -(pose[0] + poles @ pose[1].T)[:, 2]
    assert element.depth == pytest.approx(depths.max(), abs=1e-12)
    assert 0 <= element.immersed_length <= length * (1 + 1e-12)
    if depths.min() >= 0:
        assert element.immersed_length == pytest.approx(length, rel=1e-12)
    elif depths.max() > 0:
        part = depths.max() / (depths.max() - depths.min())
        assert element.immersed_length == pytest.approx(part * length, rel=1e-9)


@pytest.mark.parametrize("law", LAWS)
@given(motion=MOTIONS, angle=number(0, 2 * math.pi))
def test_level_rod_is_finite(law, motion, angle):
    # q = 90 degrees, where y_T / cos q is not defined.
    turned = matrix([math.cos(angle / 2), 0, 0, math.sin(angle / 2)])
    pose, motion = (np.array([0, 0, -0.01]), turned), tuple(np.array(part) for part in motion)
    force, moment, report = sanded(level_sand(FLAT, law), pose, motion)
    assert np.isfinite([*force, *moment]).all()
    assert report.bodies[0].immersed_length == pytest.approx(0.212, rel=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_at_rest_there_is_no_force(law):
    # The static force is the sign of the velocity: none, where there is none.
    force, moment, _ = sanded(
        level_sand(LEVEL, law), (np.zeros(3), np.eye(3)), (np.zeros(3), np.zeros(3))
    )
    assert not force.any()
    assert not moment.any()


@pytest.mark.parametrize("law", LAWS)
def test_force_is_continuous_at_the_surface(law):
    motion = (np.array([0.3, 0.2, -2.0]), np.zeros(3))
    forces = []
    for depth in (1e-3, 1e-5, 1e-7, 1e-9):
        pose = (np.array([0, 0, 0.12 - depth]), np.eye(3))
        forces.append(np.linalg.norm(sanded(level_sand(UPRIGHT, law), pose, motion)[0]))
    assert forces == sorted(forces, reverse=True)
    assert forces[-1] < 1e-6


@pytest.mark.parametrize(("gravity", "factor"), [(0.0, 4.0), (9.81, 1.0)])
def test_static_resistance_is_weight(gravity, factor):
    # Both static forces are proportional to g and do not go with speed; drag goes with its square.
    sand = Sand(rod(gravity=(0, 0, -gravity)), law="link", scheme="explicit")
    pose = (np.array([0, 0, 0.05]), np.eye(3))
    slow, fast = (
        np.linalg.norm(sanded(sand, pose, (np.array([v, 0, -v]), np.zeros(3)))[0])
        for v in (1e-3, 2e-3)
    )
    assert fast / slow == pytest.approx(factor, rel=1e-5)


def test_upright_rod_resists_alike_in_all_directions():
    pose = (np.array([0, 0, 0.02]), np.eye(3))
    sizes = []
    for angle in np.linspace(0, 2 * math.pi, 17):
        v = np.array([math.cos(angle), math.sin(angle), 0.0])
        force = sanded(level_sand(UPRIGHT, "link"), pose, (v, np.zeros(3)))[0]
        sideways = force[:2] @ [-v[1], v[0]] / np.linalg.norm(force)
        assert sideways == pytest.approx(0, abs=1e-12)
        sizes.append(-force @ v)
    assert sizes == pytest.approx([sizes[0]] * len(sizes))
    assert sizes[0] > 0


# The same thing, described in another way (`scripts/attacks/twins.py`)

FOOT = '<geom name="foot" type="box" size="0.05 0.04 0.01" density="3000"/>'
CROSS = """<geom name="one" type="box" size="0.05 0.003 0.03"/>
<geom name="two" type="box" size="0.003 0.05 0.03"/>"""
LEG = """<geom name="shank" type="capsule" pos="0.01 0 0.04" quat="0.99 0 0.12 0"
size="0.01 0.04"/>
<geom name="toe" type="ellipsoid" size="0.03 0.02 0.01"/>
<body name="heel" pos="-0.03 0 0"><joint axis="0 1 0"/>
<geom name="pad" type="cylinder" size="0.02 0.005"/></body>"""
TWINS = {"foot": FOOT, "cross": CROSS, "leg": LEG}


@pytest.fixture(scope="module")
def twins():
    sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))
    yield importlib.import_module("attacks.twins")
    sys.path.pop(0)


def spec_of(name, quat="0.9 0.3 0.2 0.1"):
    return mujoco.MjSpec.from_string(
        f"""<mujoco><worldbody><body name="body" pos="0.1 0.2 -0.02" quat="{quat}"><freejoint/>
        {TWINS[name]}</body></worldbody></mujoco>"""
    )


def enlarge(scale):
    """Scale lengths; densities stay, so masses go with the cube."""

    def change(spec):
        for thing in [*spec.bodies[1:], *spec.geoms, *spec.joints]:
            thing.pos[:] *= scale
        for geom in spec.geoms:
            geom.size[:] *= scale
        for body in spec.bodies[1:]:
            body.ipos[:] *= scale
            body.mass *= scale**3
            body.inertia[:] *= scale**5

    return change


@pytest.mark.slow
@pytest.mark.parametrize("name", TWINS)
def test_motion_is_that_of_the_thing_and_not_of_its_description(twins, name):
    given = {"surface": Plane(0.01, 0.1, 0.5), "resolution": 5}
    froude = twins.Question(
        "Froude number", enlarge(2.0), {"surface": Plane(0.02, 0.1, 0.5)}, scale=2.0
    )
    for question in [*twins.questions(given, np.random.default_rng(3)), froude]:
        off = twins.apart(spec_of(name), given, question, 1, twins.Question("itself"))
        assert off <= question.tolerance, question.name


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 4])
def test_a_foot_in_pieces_is_the_same_foot(twins, count):
    question = twins.Question("cut", twins.cut(count))
    for quat in ("1 0 0 0", "0.9 0.3 0.2 0.1"):
        off = twins.apart(spec_of("foot", quat), {}, question, 1, twins.Question("itself"))
        assert off <= 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", TWINS)
def test_half_the_time_step(twins, name):
    one, half, quarter = (twins.Question("", refine=k) for k in (1, 2, 4))
    coarse = twins.apart(spec_of(name), {}, half, 1, one)
    assert twins.apart(spec_of(name), {}, quarter, 1, half) <= max(0.7 * coarse, 1e-3)


@pytest.mark.parametrize("turn", [0.1, 1.0, 2.5])
def test_a_step_of_the_implicit_scheme_does_not_know_the_axes_of_the_world(turn):
    # Of a face that moves nearly along itself no side leads: the sign of a zero chose one.
    def after(turn):
        model = mujoco.MjModel.from_xml_string(
            '<mujoco><option timestep="1e-3"/><worldbody>'
            f'<body pos="0 0 -0.05" quat="{math.cos(turn / 2)} 0 0 {math.sin(turn / 2)}">'
            '<freejoint/><geom type="box" size="0.05 0.03 0.02" euler="20 30 10" mass="1"/>'
            "</body></worldbody></mujoco>"
        )
        data, around = mujoco.MjData(model), np.eye(3)
        around[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
        data.qvel[:] = np.random.default_rng(2).normal(size=6) * [1, 1, 1, 5, 5, 5]
        data.qvel[:3] = around @ data.qvel[:3]
        sand = Sand(model, medium="quikrete_medium", law="rft3d")
        sand.step(data)
        return np.array([*around.T @ data.qvel[:3], *data.qvel[3:]])

    assert after(turn) == pytest.approx(after(0.0), rel=0, abs=1e-7)
