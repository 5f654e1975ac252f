"""The kernel against the paper's formulas, state by state."""

import math

import mujoco
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mjgranular import (
    DistributedLinkLaw,
    Explicit,
    InputError,
    LinkLaw,
    Medium,
    Plane,
    Quantity,
    Sand,
)
from mjgranular.models import Link

G = 9.81


def number(low, high):
    return st.floats(low, high, allow_subnormal=False)


COEFFICIENTS = st.fixed_dictionaries(
    {
        "eta_d": number(0, 20),
        "eta_h": number(0, 20),
        "eta_v": number(0, 50),
        "exponent": number(0.5, 2),
    }
)
STATES = st.tuples(
    number(-1, 1),  # x_C
    number(1e-3, 0.35),  # depth of the lower end
    number(-math.pi, math.pi),  # q
    number(-5, 5),  # v_Cx
    number(-5, 5),  # v_Cy
    number(-30, 30),  # omega
)


def medium(density, coefficients):
    return Medium(
        name="drawn",
        title="for a test",
        density=Quantity(density, "kg/m^3", "chosen, not measured"),
        default_law="link",
        constants={
            "link": {
                key: Quantity(value, "", "chosen, not measured")
                for key, value in coefficients.items()
            }
        },
    )


@pytest.fixture(scope="module")
def planar():
    model = Link().model(1e-4)
    return model, mujoco.MjData(model)


def place(data, state):
    """Puts the link into a state of the reference: y down, q from the vertical."""
    x, y, q, vx, vy, omega = state
    data.qpos[:] = x, -y, q
    data.qvel[:] = vx, -vy, omega


def at_depth(reference_state, drop):
    x, depth, q, *rates = reference_state
    return np.array([x, depth - drop.length / 2 * abs(math.cos(q)), q, *rates])


@given(state=STATES, coefficients=COEFFICIENTS, density=number(500, 3000), g=number(0.5, 20))
def test_lumped_law_is_the_papers(reference, planar, state, coefficients, density, g):
    model, data = planar
    drop = reference.Drop(sand_density=density, gravity=g, **coefficients)
    state = at_depth(state, drop)
    expected = reference.sand_force(state, drop)
    # Where the direction of the static force is a matter of rounding there is nothing to compare.
    assume(min(abs(expected.v_Ex), abs(expected.v_Ey)) > 1e-6)
    model.opt.gravity[2] = -g
    place(data, state)
    body = Sand(model, medium=medium(density, coefficients), scheme="explicit").report(data)["link"]
    # The smallest numbers have fewer digits.
    force = math.hypot(expected.F_x, expected.F_y) + 1e-290
    planar_force = [body.force[0], -body.force[2]]
    assert planar_force == pytest.approx([expected.F_x, expected.F_y], abs=1e-12 * force)
    assert body.force[1] == pytest.approx(0, abs=1e-12 * force)
    assert -body.moment[1] == pytest.approx(expected.moment, rel=1e-12, abs=1e-12 * force)
    assert body.depth == pytest.approx(expected.depth, rel=1e-12, abs=1e-15)
    assert body.immersed_length == pytest.approx(expected.immersed, rel=1e-12, abs=1e-15)
    assert [body.point[0], -body.point[2]] == pytest.approx(
        [expected.x_E, expected.y_E], rel=1e-12, abs=1e-15
    )
    power = expected.F_x * expected.v_Ex + expected.F_y * expected.v_Ey
    assert body.power == pytest.approx(power, rel=1e-11)
    speed = math.hypot(expected.v_Ex, expected.v_Ey)
    assert body.froude == pytest.approx(speed / math.sqrt(g * drop.diameter), rel=1e-12)


@settings(max_examples=40)
@given(state=STATES)
def test_distributed_law_is_its_integral(reference, planar, state):
    model, data = planar
    model.opt.gravity[2] = -G
    drop = reference.Drop()
    state = at_depth(state, drop)
    # Against quadrature on the immersed part; no velocity component may change its sign on it.
    lumped = reference.sand_force(state, drop)
    reach = 0.2 * abs(state[5])
    assume(lumped.depth > 5e-3)
    assume(min(abs(lumped.v_Ex), abs(lumped.v_Ey)) > reach + 1e-3)
    s, c = math.sin(state[2]), math.cos(state[2])
    assume(abs(s * state[4] - c * state[3]) > reach + 1e-3)
    expected = reference.distributed_force(state, drop)
    place(data, state)
    law = DistributedLinkLaw(6.5, 8, 22, 1.1, pieces=400)
    body = Sand(model, law=law, scheme="explicit").report(data)["link"]
    force = math.hypot(expected.F_x, expected.F_y)
    planar_force = [body.force[0], -body.force[2]]
    assert planar_force == pytest.approx([expected.F_x, expected.F_y], rel=0, abs=1e-4 * force)
    assert -body.moment[1] == pytest.approx(expected.moment, rel=0, abs=1e-5 * force)
    assert body.immersed_length == pytest.approx(expected.immersed, rel=1e-9)


@settings(max_examples=40)
@given(
    depth=number(0.01, 0.19),
    q=number(-1.2, 1.2),
    velocity=st.tuples(number(-5, 5), number(-5, 5)),
)
def test_both_laws_agree_in_pure_translation(planar, depth, q, velocity):
    model, data = planar
    model.opt.gravity[2] = -G
    assume(depth < 0.2 * math.cos(q) and min(map(abs, velocity)) > 1e-3)
    place(data, (0, depth - 0.1 * math.cos(q), q, *velocity, 0))
    lumped = Sand(model, law=LinkLaw(6.5, 8, 22, 1.1), scheme="explicit").report(data)["link"].force
    error = []
    for pieces in (50, 400):
        law = DistributedLinkLaw(6.5, 8, 22, 1.1, pieces=pieces)
        error.append(
            np.linalg.norm(
                Sand(model, law=law, scheme="explicit").report(data)["link"].force - lumped
            )
        )
    coarse, fine = np.array(error) / np.linalg.norm(lumped)
    assert fine < 1e-4
    assert fine < coarse / 20 + 1e-12


def chain_state(model, rng):
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0 + rng.normal(scale=0.5, size=model.nq)
    data.qpos[:3] = rng.uniform([-1, -1, -0.15], [1, 1, 0.1])
    mujoco.mj_normalizeQuat(model, data.qpos)
    data.qvel[:] = rng.normal(scale=3, size=model.nv)
    mujoco.mj_forward(model, data)
    return data


def body_velocity(model, data, body, point):
    """Of a point of a body, by MuJoCo's own functions."""
    motion = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, motion, 0)
    return motion[3:] + np.cross(motion[:3], point - data.xipos[body])


def rod(model, data, geom):
    """Midpoint, axis, length and diameter of a geom, world frame."""
    radius, half = model.geom_size[geom][:2]
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE:
        half += radius
    return data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)[:, 2], 2 * half, 2 * radius


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_lumped_law_in_three_dimensions(chain_model, slope):
    # The law's reading in 3D, written once more with vectors.
    model, rng = chain_model, np.random.default_rng(1)
    eta_d, eta_h, eta_v, exponent, density = 6.5, 8.0, 22.0, 1.1, 2500.0
    sand = Sand(model, surface=Plane(0.02, slope, 0.7), scheme="explicit")
    n = sand.surface.normal
    touched = buried = 0
    for _ in range(200):
        data = chain_state(model, rng)
        for element in sand.report(data).elements:
            geom = element.geom_id
            center, axis, length, d = rod(model, data, geom)
            ends = [center + axis * length / 2, center - axis * length / 2]
            depths = [float((np.array([0, 0, 0.02]) - end) @ n) for end in ends]
            deep = int(depths[1] > depths[0])
            depth = depths[deep]
            assert element.depth == pytest.approx(depth, rel=1e-9, abs=1e-12)
            if depth <= 0:
                assert not element.force.any()
                assert element.immersed_length == 0
                continue
            touched += 1
            towards = ends[deep] - center
            cos_q = abs(float(axis @ n))
            immersed = min(length, depth / cos_q)
            buried += immersed == length
            E = ends[deep] - towards / (length / 2) * immersed / 2
            v = body_velocity(model, data, model.geom_bodyid[geom], E)
            v_n = float(v @ n)
            tangential = v - v_n * n
            A_r = d * immersed * np.linalg.norm(np.cross(axis, v)) / np.linalg.norm(v)
            force = (
                -eta_d * density * A_r * np.linalg.norm(v) * v
                - eta_h * G * density * depth**2 * d * tangential / np.linalg.norm(tangential)
                - np.sign(v_n)
                * eta_v
                * (depth / d) ** exponent
                * G
                * density
                * (math.pi * d**2 / 4)
                * immersed
                * n
            )
            assert element.immersed_length == pytest.approx(immersed, rel=1e-9)
            assert element.point == pytest.approx(E, rel=1e-12, abs=1e-12)
            assert element.velocity == pytest.approx(v, rel=1e-11, abs=1e-11)
            assert element.force == pytest.approx(force, abs=1e-9 * float(np.linalg.norm(force)))
    assert touched > 200
    assert buried > 50


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_pieces_are_as_deep_as_they_lie(chain_model, slope):
    # Dry pieces are only skimmed, wet ones are looked at: both depths are those of geometry.
    model, rng, pieces = chain_model, np.random.default_rng(6), 7
    sand = Sand(
        model,
        law="link_distributed",
        resolution=pieces,
        surface=Plane(0.02, slope, 0.7),
        scheme="explicit",
    )
    n = sand.surface.normal
    wet = dry = 0
    for _ in range(30):
        data = chain_state(model, rng)
        elements = sand.report(data).elements
        for first in range(0, len(elements), pieces):
            center, axis, length, _ = rod(model, data, elements[first].geom_id)
            ends = center + axis * length * (np.arange(pieces + 1)[:, None] / pieces - 0.5)
            depths = (np.array([0, 0, 0.02]) - ends) @ n
            expected = np.maximum(depths[1:], depths[:-1])
            found = np.array([element.depth for element in elements[first : first + pieces]])
            assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)
            wet, dry = wet + np.sum(found > 0), dry + np.sum(found < 0)
    assert min(wet, dry) > 100


def test_elements_that_do_not_come_body_by_body_are_refused(chain_model):
    class Backwards(LinkLaw):
        def elements(self, model, geoms, resolution=None):
            return super().elements(model, geoms, resolution)[::-1]

    data = mujoco.MjData(chain_model)
    law = Backwards(eta_d=1, eta_h=1, eta_v=1, exponent=1)
    with pytest.raises(InputError, match="body by body"):
        Sand(chain_model, law=law, scheme="explicit").step(data)


def test_moment_is_about_the_centre_of_mass(chain_model):
    model, rng = chain_model, np.random.default_rng(2)
    sand = Sand(model, law="link", scheme="explicit")
    for _ in range(50):
        data = chain_state(model, rng)
        report = sand.report(data)
        for body in report.bodies:
            center = data.xipos[model.body(body.body).id]
            number = model.body(body.body).id
            mine = report.elements[report.elements.body_id == number]
            force = np.sum([element.force for element in mine], axis=0)
            moment = np.sum([np.cross(e.point - center, e.force) for e in mine], axis=0)
            scale = 1e-12 * (1 + float(np.linalg.norm(force)))
            assert body.force == pytest.approx(force, abs=scale)
            assert body.moment == pytest.approx(moment, abs=scale)
            assert body.depth == max(element.depth for element in mine)
            assert body.immersed_length == sum(element.immersed_length for element in mine)
            assert body.power == pytest.approx(sum(element.power for element in mine), rel=1e-12)


def test_power_is_that_of_the_generalized_force(chain_model):
    # Force at E on the body, through MuJoCo's Jacobian: the work is the same in joint space.
    model, rng = chain_model, np.random.default_rng(3)
    sand = Sand(model, law="link_distributed", scheme="explicit")
    for _ in range(50):
        data = chain_state(model, rng)
        report = sand.report(data)
        generalized = np.zeros(model.nv)
        through_points = np.zeros(model.nv)
        for body in report.bodies:
            i = model.body(body.body).id
            mujoco.mj_applyFT(model, data, body.force, body.moment, data.xipos[i], i, generalized)
        jacobian = np.zeros((3, model.nv))
        for element in report.elements:
            i = element.body_id
            mujoco.mj_jac(model, data, jacobian, None, element.point, i)
            through_points += jacobian.T @ element.force
            if element.immersed_length:
                assert jacobian @ data.qvel == pytest.approx(element.velocity, abs=1e-10)
        scale = 1e-11 * (1 + np.abs(through_points).max())
        assert generalized == pytest.approx(through_points, abs=scale)
        power = sum(body.power for body in report.bodies)
        assert generalized @ data.qvel == pytest.approx(power, rel=1e-9, abs=1e-9)


def test_what_step_applies_is_what_report_says(chain_model):
    # Without leading, the wrench in xfrc_applied is that of the report at the same state.
    model, rng = chain_model, np.random.default_rng(4)
    sand = Sand(model, law="link", scheme=Explicit(half_step=False))
    for _ in range(20):
        data = chain_state(model, rng)
        report = sand.report(data)
        mujoco.mj_step1(model, data)
        sand.apply(data)
        expected = np.zeros((model.nbody, 6))
        for body in report.bodies:
            expected[model.body(body.body).id] = [*body.force, *body.moment]
        assert np.array_equal(data.xfrc_applied, expected)


def test_velocity_is_led_by_half_a_step_of_the_last_acceleration(chain_model):
    # The drag, linear in the led velocity, with static resistance out of the way.
    model, rng = chain_model, np.random.default_rng(5)
    law = LinkLaw(eta_d=6.5, eta_h=0, eta_v=0, exponent=1)
    led, now = (
        Sand(model, law=law, scheme="explicit"),
        Sand(model, law=law, scheme=Explicit(half_step=False)),
    )
    for _ in range(20):
        data = chain_state(model, rng)
        mujoco.mj_step1(model, data)
        acceleration = rng.normal(scale=1e4, size=model.nv)
        data.qacc_warmstart[:] = acceleration
        led.apply(data)
        applied = data.xfrc_applied.copy()

        ahead = mujoco.MjData(model)
        ahead.qpos[:] = data.qpos
        ahead.qvel[:] = data.qvel + model.opt.timestep / 2 * acceleration
        mujoco.mj_step1(model, ahead)
        now.apply(ahead)
        assert applied == pytest.approx(ahead.xfrc_applied, rel=1e-9, abs=1e-9)
