"""One force a body: published drops, integration by SciPy, and where the deepest point is."""

import json
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from mjgranular import DepthVelocityLaw, InputError, Plane, Sand, media

DROP = json.loads(
    (Path(__file__).parents[1] / "data" / "katsuragi_durian.json").read_text(encoding="utf-8")
)
MASS, RADIUS, GRAVITY = DROP["mass"], DROP["diameter"] / 2, DROP["gravity"]
STIFFNESS, LENGTH = DROP["stiffness_over_mass"] * MASS, DROP["drag_length"]
SPHERE = DepthVelocityLaw(stiffness=STIFFNESS, quadratic=MASS / LENGTH)

# Each of the survey's models, and its resistance as it is printed.
MODELS = {
    "Bingham": (
        DepthVelocityLaw(constant=2.0, linear=1.5),
        lambda z, v: 2.0 + 1.5 * v,
    ),
    "Poncelet": (
        DepthVelocityLaw(constant=2.0, quadratic=0.7),
        lambda z, v: 2.0 + 0.7 * v**2,
    ),
    "Allen, Mayfield, Morrison": (
        DepthVelocityLaw(quadratic=0.7, linear=1.5, constant=2.0),
        lambda z, v: 0.7 * v**2 + 1.5 * v + 2.0,
    ),
    "Lohse": (DepthVelocityLaw(stiffness=60.0), lambda z, v: 60.0 * z),
    "Tsimring, Volfson": (
        DepthVelocityLaw(stiffness=60.0, quadratic=0.7),
        lambda z, v: 60.0 * z + 0.7 * v**2,
    ),
    "Katsuragi, Durian": (SPHERE, lambda z, v: STIFFNESS * z + MASS / LENGTH * v**2),
    "all of it": (
        DepthVelocityLaw(0.5, 800.0, 1.6, 1.5, 0.7),
        lambda z, v: 0.5 + 800.0 * z**1.6 + 1.5 * v + 0.7 * v**2,
    ),
}
each_model = pytest.mark.parametrize("name", MODELS)


def model(geoms, timestep=1e-4, inertial=""):
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><option timestep='{timestep}'/><worldbody><body name='body'><freejoint/>"
        f"{inertial}{geoms}</body></worldbody></mujoco>"
    )


BALL = f"<geom name='ball' type='sphere' size='{RADIUS}' mass='{MASS}'/>"


def dropped(law, speed, timestep=1e-4, resistance=None):
    """Touch-down to rest: time, depth; and depths and speeds on the way, at the same instants.

    With the law's `resistance` given, the start is that of MuJoCo's leapfrog: `qvel` belongs to
    half a time step before `qpos`, and the sphere touches. Without, the first half step is lost.
    """
    sand = Sand(model(BALL, timestep), law=law, scheme="explicit")
    data = mujoco.MjData(sand.model)
    data.qpos[2], data.qvel[2] = RADIUS, -speed
    if resistance is not None:
        data.qpos[2] -= 1e-9
        data.qvel[2] += timestep / 2 * (GRAVITY - resistance(0.0, speed) / MASS)
    depths, speeds = [], []
    while True:
        depth, before = RADIUS - data.qpos[2], -data.qvel[2]
        sand.step(data)
        after = -data.qvel[2]
        depths.append(depth)
        speeds.append((before + after) / 2)
        if after <= 0 and len(depths) > 1:
            break
        assert data.time < 1
    # The speed falls to zero within the last step, in a straight line.
    rest = data.time - timestep / 2 - timestep * (-after) / (before - after)
    return rest, max(depths), np.array(depths), np.array(speeds)


def solved(resistance, speed):
    """The same by SciPy: time and depth."""

    def motion(t, state):
        z, v = state
        return [v, GRAVITY - resistance(max(z, 0.0), max(v, 0.0)) / MASS]

    def rest(t, state):
        return state[1] if t > 1e-9 else 1.0

    rest.terminal, rest.direction = True, -1
    end = solve_ivp(motion, (0, 2), [0.0, speed], "Radau", events=rest, rtol=1e-10, atol=1e-12)
    assert end.status == 1
    return end.t_events[0][0], end.y_events[0][0][0]


@pytest.mark.parametrize("stop", DROP["stops"]["values"], ids=lambda stop: f"{stop['speed']} m/s")
def test_sphere_stops_as_published(stop):
    tolerance = DROP["stops"]["tolerance"]
    time, depth, *_ = dropped(SPHERE, stop["speed"])
    expected = solved(MODELS["Katsuragi, Durian"][1], stop["speed"])
    assert (time, depth) == pytest.approx(expected, rel=tolerance["relative"])
    for found, name in ((time, "time"), (depth, "depth")):
        margin = tolerance["rounding"][name] + tolerance["relative"] * stop[name]
        assert found == pytest.approx(stop[name], abs=margin)
    # What is printed is the solution, rounded.
    assert expected == pytest.approx((stop["time"], stop["depth"]), abs=5.1e-5)


@pytest.mark.parametrize("speed", [stop["speed"] for stop in DROP["stops"]["values"]])
def test_sphere_slows_down_as_the_closed_form(speed):
    _, _, z, v = dropped(SPHERE, speed, resistance=MODELS["Katsuragi, Durian"][1])
    k, d1, m = STIFFNESS, LENGTH, MASS
    fade = np.exp(-2 * z / d1)
    closed = speed**2 * fade - k * d1 / m * z + (GRAVITY * d1 + k * d1**2 / (2 * m)) * (1 - fade)
    moving = z < z.max() * 0.999
    assert moving.sum() > 300
    assert v[moving] ** 2 == pytest.approx(closed[moving], abs=5e-4 * closed.max())


@pytest.mark.parametrize("speed", [0.5, 2.0])
@each_model
def test_drop_by_scipy(name, speed):
    law, resistance = MODELS[name]
    time, depth, *_ = dropped(law, speed, resistance=resistance)
    assert (time, depth) == pytest.approx(solved(resistance, speed), rel=5e-4)


@each_model
def test_drop_converges_at_second_order(name):
    law, resistance = MODELS[name]
    _, depth = solved(resistance, 2.0)
    errors = [
        abs(dropped(law, 2.0, timestep, resistance)[1] / depth - 1) for timestep in (4e-4, 1e-4)
    ]
    assert math.log(errors[0] / errors[1], 4) == pytest.approx(2, abs=0.3) or errors[1] < 1e-5


def test_constants_of_glass_beads_are_those_of_the_sphere():
    law = DepthVelocityLaw.from_medium(media["glass_beads"])
    assert law.stiffness == pytest.approx(SPHERE.stiffness)
    assert law.quadratic == pytest.approx(SPHERE.quadratic)
    assert (law.constant, law.linear, law.exponent) == (0, 0, 1)
    assert (
        Sand(model(BALL), medium="glass_beads", law="depth_velocity", scheme="explicit").law == law
    )


@each_model
@given(
    depth=st.floats(1e-6, 0.3),
    speed=st.floats(1e-6, 20),
    polar=st.floats(0, math.pi),
    turn=st.floats(-math.pi, math.pi),
)
def test_force_opposes_the_velocity(name, depth, speed, polar, turn):
    law, resistance = MODELS[name]
    sand = sphere_sand(law)
    direction = np.array(
        [math.sin(polar) * math.cos(turn), math.sin(polar) * math.sin(turn), math.cos(polar)]
    )
    data = mujoco.MjData(sand.model)
    data.qpos[2] = RADIUS - depth
    data.qvel[:3] = speed * direction
    (body,) = sand.report(data).bodies
    assert body.depth == pytest.approx(depth, abs=1e-15)
    expected = resistance(body.depth, speed)
    assert body.force == pytest.approx(-expected * direction, rel=1e-9, abs=1e-9 * expected)
    assert body.moment == pytest.approx(np.zeros(3), abs=1e-12)
    assert body.power == pytest.approx(-expected * speed, rel=1e-9)


KEPT = {}


def sphere_sand(law):
    if law not in KEPT:
        KEPT[law] = Sand(model(BALL), law=law, scheme="explicit")
    return KEPT[law]


@each_model
def test_no_force_above_the_sand_or_at_rest(name):
    sand = sphere_sand(MODELS[name][0])
    data = mujoco.MjData(sand.model)
    data.qpos[2], data.qvel[2] = RADIUS + 1e-9, -1
    assert not sand.report(data).bodies[0].force.any()
    data.qpos[2], data.qvel[2] = 0, 0
    assert not sand.report(data).bodies[0].force.any()


# The deepest point

GEOMS = {
    "sphere": "type='sphere' size='.04'",
    "capsule": "type='capsule' size='.02 .05'",
    "cylinder": "type='cylinder' size='.03 .04'",
    "disc": "type='cylinder' size='.05 .004'",
    "ellipsoid": "type='ellipsoid' size='.06 .04 .02'",
    "box": "type='box' size='.06 .04 .02'",
}


def skin(name, fine=200):
    """Points on the geom's surface, in its frame."""
    kind, size = GEOMS[name].split("' size='")
    size = np.array(size.strip("'").split(), float)
    turn, level = np.meshgrid(np.linspace(0, 2 * math.pi, 2 * fine + 1), np.linspace(-1, 1, fine))
    turn, level = turn.ravel(), level.ravel()
    rim = np.sqrt(1 - level**2)
    ball = np.column_stack([rim * np.cos(turn), rim * np.sin(turn), level])
    circle = np.column_stack([np.cos(turn), np.sin(turn), np.sign(level)])
    if "box" in kind:
        return size * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    if "cylinder" in kind:
        return circle * [size[0], size[0], size[1]]
    if "capsule" in kind:
        return size[0] * ball + np.outer(np.sign(level), [0, 0, size[1]])
    return ball * size


def matrix(quaternion):
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, np.asarray(quaternion, float))
    return out.reshape(3, 3)


def drawn_rotation(rng):
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


@pytest.mark.parametrize("plane", [Plane(), Plane(0.1, 0.4, 1.0)], ids=["level", "sloping"])
@pytest.mark.parametrize("name", GEOMS)
def test_depth_is_that_of_the_deepest_point(name, plane):
    rng = np.random.default_rng(0)
    inner, offset = drawn_rotation(rng), np.array([0.1, -0.2, 0.05])
    place = f"pos='0.1 -0.2 0.05' quat='{' '.join(map(repr, inner.tolist()))}'"
    sand = Sand(
        model(f"<geom {GEOMS[name]} {place}/>"), law=SPHERE, surface=plane, scheme="explicit"
    )
    points = skin(name) @ matrix(inner).T + offset
    for _ in range(10):
        outer, position = drawn_rotation(rng), rng.uniform(-0.3, 0.3, 3)
        data = mujoco.MjData(sand.model)
        data.qpos[:3], data.qpos[3:] = position, outer
        (element,) = sand.report(data).elements
        heights = (position + points @ matrix(outer).T) @ plane.normal
        deepest = plane.height * math.cos(plane.slope) - heights.min()
        assert element.depth == pytest.approx(deepest, abs=2e-5)  # of 400 points around
        assert element.depth >= deepest - 1e-12


def diamond(box=False):
    spec = mujoco.MjSpec()
    mesh = spec.add_mesh(name="mesh")
    tips = [[0.06, 0, 0], [-0.06, 0, 0], [0, 0.04, 0], [0, -0.04, 0], [0, 0, 0.03], [0, 0, -0.03]]
    faces = [[a, b, c] for a in (0, 1) for b in (2, 3) for c in (4, 5)]
    # Outward: an odd number of ones turns a face over.
    faces = [f if (f[0] + (f[1] - 2) + (f[2] - 4)) % 2 == 0 else f[::-1] for f in faces]
    mesh.uservert, mesh.userface = np.ravel(tips), np.ravel(faces)
    body = spec.worldbody.add_body(name="body")
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
    return spec.compile(), np.array(tips)


def mesh_depth(quaternion):
    compiled, tips = diamond()
    data = mujoco.MjData(compiled)
    data.qpos[3:] = quaternion
    (element,) = Sand(compiled, law=SPHERE, scheme="explicit").report(data).elements
    return element.depth, -(tips @ matrix(quaternion).T)[:, 2].min()


@pytest.mark.parametrize("turn", [0, 90, 180])
def test_depth_of_a_mesh_along_its_axes(turn):
    angle = math.radians(turn) / 2
    depth, expected = mesh_depth([math.cos(angle), math.sin(angle), 0, 0])
    assert depth == pytest.approx(expected, abs=1e-7)


@pytest.mark.xfail(reason="a mesh counts as the box around it", strict=True)
def test_depth_of_a_mesh_is_that_of_its_deepest_vertex():
    depth, expected = mesh_depth(drawn_rotation(np.random.default_rng(1)))
    assert depth == pytest.approx(expected, abs=1e-7)


# Where the force acts


def test_force_acts_at_the_middle_of_each_geom():
    geoms = (
        "<geom type='sphere' size='.03' pos='.1 0 -.02'/>"
        "<geom type='box' size='.02 .02 .02' pos='-.05 .02 0'/>"
        "<geom type='sphere' size='.01' pos='0 0 .5'/>"  # stays dry
    )
    inertial = "<inertial pos='.01 -.02 .03' mass='1' diaginertia='1 1 1'/>"
    sand = Sand(model(geoms, inertial=inertial), law=SPHERE, scheme="explicit")
    rng = np.random.default_rng(3)
    data = mujoco.MjData(sand.model)
    quaternion, velocity, spin = drawn_rotation(rng), rng.normal(size=3), 5 * rng.normal(size=3)
    quaternion = np.array([1.0, 0.05, -0.03, 0.4])
    quaternion /= np.linalg.norm(quaternion)
    R = matrix(quaternion)
    data.qpos[3:], data.qvel[:3], data.qvel[3:] = quaternion, velocity, R.T @ spin
    report = sand.report(data)
    force, moment = np.zeros(3), np.zeros(3)
    middle = R @ [0.01, -0.02, 0.03]
    for place, element in zip(
        ([0.1, 0, -0.02], [-0.05, 0.02, 0], [0, 0, 0.5]), report.elements, strict=True
    ):
        centre = R @ place
        assert element.point == pytest.approx(centre, abs=1e-12)
        if element.depth <= 0:
            assert place[2] == 0.5
            continue
        v = velocity + np.cross(spin, centre)
        size = STIFFNESS * element.depth + MASS / LENGTH * (v @ v)
        f = -size * v / np.linalg.norm(v)
        assert element.force == pytest.approx(f, rel=1e-9)
        force, moment = force + f, moment + np.cross(centre - middle, f)
    (body,) = report.bodies
    assert body.force == pytest.approx(force, rel=1e-9)
    assert body.moment == pytest.approx(moment, rel=1e-9)


def test_sphere_may_turn_freely():
    # The centre does not move: nothing is resisted.
    sand = Sand(model(BALL), law=SPHERE, scheme="explicit")
    data = mujoco.MjData(sand.model)
    data.qvel[3:] = 1, 2, 3
    assert not sand.report(data).bodies[0].force.any()


@pytest.mark.parametrize("key", ["constant", "stiffness", "exponent", "linear", "quadratic"])
@pytest.mark.parametrize("bad", [-1e-9, math.nan, math.inf])
def test_coefficients_must_not_be_negative(key, bad):
    with pytest.raises(InputError, match=f"DepthVelocityLaw: {key} must be finite and not neg"):
        DepthVelocityLaw(**{key: bad})
