"""The implicit scheme: what laws answer it, what it foresees of a step, its order, its state."""

import copy
import math
import pickle
import threading
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjgranular import (
    DepthVelocityLaw,
    DistributedLinkLaw,
    InputError,
    Plane,
    Rft3dLaw,
    Sand,
    UnstableError,
    media,
)
from mjgranular.law.kernel import Pose, grip, new_share
from mjgranular.models import Link
from mjgranular.scheme import Implicit

G = 9.81  # of the models here [m/s^2]
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
QUADRATIC = DepthVelocityLaw(constant=0.3, stiffness=30.0, exponent=1.0, linear=0.1, quadratic=2.0)
QUIKRETE = media["quikrete_medium"]
SANDS = {
    "link": {"law": "link"},
    "link_distributed": {"law": "link_distributed"},
    "rft2d": {"law": "rft2d", "medium": "poppy_seed_loose"},
    "rft3d": {"law": "rft3d", "medium": QUIKRETE},
    "rft3d_inertia": {
        "law": replace(Rft3dLaw.from_medium(QUIKRETE), inertia=1.1),
        "medium": QUIKRETE,
    },
    "depth_velocity": {"law": QUADRATIC},
}
OF_FACETS = ("rft2d", "rft3d", "rft3d_inertia")
RAMP = 0.06  # a flat facet leads over a ramp of 0.05; and a margin

BODY = """
<mujoco>
  <worldbody>
    <body><freejoint/>{geoms}</body>
  </worldbody>
</mujoco>
"""
RODS = '<geom type="capsule" size=".02 .1"/><geom type="capsule" size=".01 .05" pos=".1 0 0"/>'
SKINS = (
    '<geom type="box" size=".1 .06 .03"/><geom type="ellipsoid" size=".05 .1 .04" pos=".1 0 0"/>'
)


def sand_of(name, model, **options):
    return Sand(model, **{**SANDS[name], "scheme": "implicit", **options})


def account(sand, data):
    """What the scheme has counted."""
    return sand._bindings[data].desk.account[0]


def foreseen(sand, data):
    """The velocity at the end of the step that the solver last found."""
    _, numbers, *_ = sand._bindings[data].desk.holds
    return numbers[: sand.model.nv]  # the first of `desk.Room`


def state(sand, data):
    out = np.empty(mujoco.mj_stateSize(sand.model, STATE))
    mujoco.mj_getState(sand.model, data, out, STATE)
    return out


# What a law answers


class Drawn:
    """Elements in the sand, in drawn poses, and the kernels of their law."""

    def __init__(self, name, seed, geoms=None):
        rods = name.startswith("link")
        model = mujoco.MjModel.from_xml_string(
            BODY.format(geoms=geoms or (RODS if rods else SKINS))
        )
        sand, data = (
            sand_of(name, model, surface=Plane(slope=0.2, uphill=0.4)),
            mujoco.MjData(model),
        )
        self.kernel = sand.law.kernel(sand.surface)
        scene = sand._scene[0]
        self.law, self.rng = scene["law"], np.random.default_rng(seed)
        self.immersed, self.normals = [], []
        while len(self.immersed) < 60:
            data.qpos[:3] = self.rng.normal(scale=0.05, size=3)
            data.qpos[3:] = self.rng.normal(size=4)
            data.qvel[:] = self.rng.normal(size=6)
            mujoco.mj_normalizeQuat(model, data.qpos)
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            pose = Pose(
                tuple(data.xpos[1]),
                tuple(data.xmat[1]),
                tuple(data.xipos[1]),
                tuple(data.subtree_com[1]),
                tuple(data.cvel[1]),
            )
            for element in self.rng.permutation(sand.elements)[:4]:
                found = self.kernel.immerse(element, pose, self.law, scene["surface"], G)
                if found[0] > 0:
                    self.immersed.append(found)
                    normal = element["normal"] if name in OF_FACETS else np.zeros(3)
                    self.normals.append(data.xmat[1].reshape(3, 3) @ normal)

    def velocity(self):
        """[m/s]: any direction, 1 mm/s to 10 m/s."""
        v = self.rng.normal(size=3)
        return v / np.linalg.norm(v) * 10 ** self.rng.uniform(-3, 1)

    def resist(self, immersed, v):
        return np.array(self.kernel.resist(immersed, self.law, G, tuple(v), tuple(v)))

    def respond(self, immersed, v, eps, reach=None, shares=(-1.0, -1.0)):
        """Force, and minus its derivative."""
        reach = eps if reach is None else reach
        answer = self.kernel.respond(immersed, self.law, G, tuple(v), eps, reach, shares)
        return np.array(answer[:3]), np.array(answer[3:]).reshape(3, 3)


@pytest.mark.parametrize("name", SANDS)
def test_in_motion_a_law_answers_both_schemes_alike(name):
    # Flat facets only: those of round bodies are pieces of a skin that turns.
    drawn = Drawn(name, 0, SKINS.split('<geom type="ellipsoid"')[0] if name in OF_FACETS else None)
    compared = 0
    for immersed, normal in zip(drawn.immersed, drawn.normals, strict=True):
        v = drawn.velocity()
        if name in OF_FACETS and abs(normal @ v) < RAMP * np.linalg.norm(v):
            continue
        compared += 1
        force, _ = drawn.respond(immersed, v, 1e-15)
        assert force == pytest.approx(drawn.resist(immersed, v), rel=1e-9, abs=1e-15)
    assert compared > 40


@pytest.mark.parametrize("name", SANDS)
def test_derivative_is_that_of_the_force(name):
    drawn = Drawn(name, 1)
    compared = 0
    for immersed in drawn.immersed:
        v = drawn.velocity()
        speed = np.linalg.norm(v)
        eps = speed * 10 ** drawn.rng.uniform(-2, 1)
        force, stiffness = drawn.respond(immersed, v, eps)
        step = 1e-5 * speed
        ahead, back = (
            np.array(
                [drawn.respond(immersed, v + side * step * axis, eps)[0] for axis in np.eye(3)]
            )
            for side in (1, -1)
        )
        size = abs(stiffness).max()
        # Stresses have edges: capped friction, facets that begin to lead.
        if abs(ahead + back - 2 * force).max() > 1e-3 * size * step:
            continue
        compared += 1
        found = -(ahead - back).T / (2 * step)
        # Measured: 1e-9 for rods and blobs. A facet's derivative by direction is a difference too.
        close = 1e-3 if name in OF_FACETS else 1e-7
        assert stiffness == pytest.approx(found, rel=0, abs=close * size + 1e-15)
    assert compared > 40


@pytest.mark.parametrize("name", ["rft2d", "rft3d", "depth_velocity"])
def test_softness_scales_static_resistance(name):
    # limit v / sqrt(v^2 + eps^2), whatever the direction
    drawn = Drawn(name, 2)
    if name == "depth_velocity":
        drawn.law = drawn.law.copy()
        drawn.law["linear"] = drawn.law["quadratic"] = 0.0
    for immersed in drawn.immersed:
        v = drawn.velocity()
        eps = np.linalg.norm(v) * 10 ** drawn.rng.uniform(-2, 2)
        full, _ = drawn.respond(immersed, v, 1e-15)
        soft, _ = drawn.respond(immersed, v, eps)
        assert soft == pytest.approx(full / math.hypot(1, eps / np.linalg.norm(v)), rel=1e-9)


@pytest.mark.parametrize("name", SANDS)
def test_a_soft_force_never_pushes_on(name):
    drawn = Drawn(name, 3)
    for immersed in drawn.immersed:
        for eps in (1e-12, 1e-2, 1e2):
            v = drawn.velocity()
            force, _ = drawn.respond(immersed, v, eps)
            assert force @ v <= 1e-12 * np.linalg.norm(force) * np.linalg.norm(v)


@pytest.mark.parametrize("name", SANDS)
def test_speeds_change_as_they_say(name):
    drawn = Drawn(name, 4)
    for immersed in drawn.immersed:
        v, c = drawn.velocity(), drawn.velocity()
        step = 1e-6 * np.linalg.norm(v) / np.linalg.norm(c)
        ahead, back = (
            np.array(drawn.kernel.speeds(immersed, tuple(v + side * step * c), tuple(c))[:2])
            for side in (1, -1)
        )
        change = drawn.kernel.speeds(immersed, tuple(v), tuple(c))[2:]
        scale = np.linalg.norm(c)
        assert (ahead - back) / (2 * step) == pytest.approx(change, rel=1e-4, abs=1e-6 * scale)


SPEEDS = st.floats(1e-14, 1e3)


@given(speed=SPEEDS, limit=st.floats(1e-9, 1e4), eps=st.floats(1e-12, 1.0))
def test_grip_is_a_limit_and_its_derivative(speed, limit, eps):
    gain, along, across = grip(speed, limit, eps, eps, -1.0)
    size = math.hypot(speed, eps)
    assert gain * speed == pytest.approx(limit * speed / size, rel=1e-12)
    assert gain * speed <= limit * (1 + 1e-15)
    assert across == gain
    assert along == pytest.approx(limit * eps**2 / size**3, rel=1e-9)


@given(speed=SPEEDS, eps=st.floats(1e-12, 1.0))
def test_the_right_share_gives_the_true_derivative(speed, eps):
    share = speed / math.hypot(speed, eps)
    _, true, _ = grip(speed, 1.0, eps, eps, -1.0)
    _, along, _ = grip(speed, 1.0, eps, eps, share)
    # 1 - share^2: what is left of the digits of 1
    assert along == pytest.approx(true, rel=1e-6, abs=1e-15 / math.hypot(speed, eps))


@given(speed=st.floats(0, 1.0), reach=st.floats(1e-6, 1.0), eps=st.floats(1e-12, 1e-7))
def test_what_held_is_looked_at_with_the_force_it_had(speed, reach, eps):
    if speed >= reach:
        return
    gain, along, _ = grip(speed, 2.0, eps, reach, -1.0)
    held = (
        speed * eps / reach
    )  # the speed at which the finer softness gives the coarser one's force
    had = 2.0 * speed / math.hypot(speed, reach)
    assert 2.0 * held / math.hypot(held, eps) == pytest.approx(had, rel=1e-9)
    assert gain * speed == pytest.approx(had + along * (speed - held), rel=1e-9, abs=1e-300)


@given(
    speed=SPEEDS,
    change=st.floats(-1e3, 1e3),
    eps=st.floats(1e-12, 1.0),
    share=st.floats(-1.0, 1.0),
)
def test_a_share_is_one(speed, change, eps, share):
    assert 0.0 <= new_share(speed, change, eps, share) <= 1.0


# What it foresees: `qvel` after the step is what the solver has found


TREE = """
<mujoco>
  <option timestep="0.005" integrator="{integrator}" tolerance="0" iterations="200" {option}/>
  <worldbody>{world}
    <body name="a" gravcomp="0.1">{root}
      <geom name="a" type="box" size=".08 .06 .04"/><site name="a"/>
      <body name="b" pos=".1 0 0">
        <joint name="b" axis="0 1 .3" {joint}/>
        <geom name="b" type="capsule" fromto="0 0 0 .15 0 0" size=".02"/>
        <body name="c" pos=".15 0 0">
          <joint name="c" axis="0 .2 1" {joint}/>
          <geom name="c" type="capsule" fromto="0 0 0 .1 .05 0" size=".02"/>
          <site name="c" pos=".05 .02 .02"/>
        </body>
      </body>
    </body>
  </worldbody>{more}
</mujoco>
"""
FREE, BALL = "<freejoint/>", '<joint type="ball" damping=".02" armature=".001"/>'
DAMPED = 'damping="0.02" armature="0.001" stiffness="0.3"'
FLOOR = '<geom type="plane" size="1 1 .1" pos="0 0 -.03" condim="{condim}"/>'
TENDON = '<joint joint="b" coef="1"/><joint joint="c" coef="-1"/>'


def actuated(text):
    return {"joint": DAMPED, "more": f"<actuator>{text}</actuator>"}


SMOOTH = {
    "undamped": {},
    "damped": {"joint": DAMPED},
    "ball": {"joint": DAMPED, "root": BALL},
    "motors": actuated('<motor joint="b"/><motor joint="c" gear="2"/>'),
    "servos": actuated('<position joint="b" kp="5" kv=".1"/><position joint="c" kp="5" kv=".2"/>'),
    "velocity servo": actuated('<velocity joint="b" kv=".5"/>'),
    "filtered": actuated(
        '<general joint="b" dyntype="filterexact" dynprm="0.02" gainprm="3" biastype="affine" '
        'biasprm="0 -3 -.1"/>'
    ),
    "acting early": actuated(
        '<general joint="b" dyntype="filter" dynprm=".02" gainprm="3" actearly="true"/>'
    ),
    "force range": actuated('<position joint="b" kp="50" kv="1" forcerange="-1 1"/>'),
    "delayed": actuated('<position joint="b" kp="5" delay="0.012" nsample="4"/>'),
    "muscle": actuated('<muscle joint="b" lengthrange="0 1"/>'),
    "tendon": {
        "joint": DAMPED,
        "more": f'<tendon><fixed damping=".05" stiffness="1">{TENDON}</fixed></tendon>',
    },
    "string": {
        "joint": DAMPED,
        "more": '<tendon><spatial damping=".5" stiffness="1" armature=".01"><site site="a"/>'
        '<site site="c"/></spatial></tendon>',
    },
    "fluid": {"joint": DAMPED, "option": 'density="1000" viscosity="0.5"'},
    "polynomial damping": {"joint": 'damping="0.02 0.03 0.01"'},
    "damping by actuators": actuated('<motor joint="b" damping="0.3" armature="0.01"/>'),
}
BOUND = {
    "frictionloss": {"joint": 'frictionloss="0.05"'},
    "limits": {"joint": 'range="-5 5" limited="true"'},
    "limits, damped": {"joint": DAMPED + ' range="-1 1" limited="true"'},
    "tendon limit": {
        "more": f'<tendon><fixed range="-.05 .05" limited="true">{TENDON}</fixed></tendon>'
    },
    "connect": {
        "joint": DAMPED,
        "more": '<equality><connect body1="c" body2="a" anchor="0 0 0"/></equality>',
    },
    "weld": {"joint": DAMPED, "more": '<equality><weld body1="c" body2="a"/></equality>'},
    "coupled": {"more": '<equality><joint joint1="b" joint2="c"/></equality>'},
}
CONTACTS = {
    f"{cone}, condim {condim}": {
        "joint": DAMPED,
        "world": FLOOR.format(condim=condim),
        "option": f'cone="{cone}"',
    }
    for cone in ("pyramidal", "elliptic")
    for condim in (3, 6)
}
INTEGRATORS = ("Euler", "implicit", "implicitfast")
EULER_DAMPING = {"polynomial damping", "damping by actuators"}


def tree(integrator="Euler", root=FREE, joint="", world="", more="", option=""):
    xml = TREE.format(
        integrator=integrator, root=root, joint=joint, world=world, more=more, option=option
    )
    return mujoco.MjModel.from_xml_string(xml)


def surprise(model, steps=40, **options):
    """Greatest difference between `qvel` and what was foreseen, in parts of the speeds at hand."""
    sand = Sand(model, law=QUADRATIC, scheme="implicit", **options)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    data.qvel[:] = rng.normal(size=model.nv)
    worst = 0.0
    for _ in range(steps):
        data.ctrl[:] = rng.normal(size=model.nu)
        data.qfrc_applied[:] = rng.normal(scale=0.1, size=model.nv)
        data.xfrc_applied[1:] = rng.normal(scale=0.1, size=(model.nbody - 1, 6))
        before = data.qvel.copy()
        sand.step(data)
        speed = max(abs(data.qvel).max(), abs(data.qvel - before).max())
        worst = max(worst, abs(data.qvel - foreseen(sand, data)).max() / speed)
    assert account(sand, data)["steps"] > steps / 2
    assert account(sand, data)["unfinished"] == 0
    return worst


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("case", SMOOTH)
def test_the_step_is_foreseen(case, integrator, request):
    if integrator == "Euler" and case in EULER_DAMPING:
        reason = "Euler's implicit damping is that of dof_damping alone in the scheme"
        request.applymarker(pytest.mark.xfail(reason=reason))
    # Measured: at most 2e-10.
    assert surprise(tree(integrator, **SMOOTH[case])) < 1e-9


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("case", BOUND)
def test_the_step_is_foreseen_with_constraints(case, integrator):
    model = tree(integrator, **BOUND[case])
    # MuJoCo's solver stops on its own account; measured: at most 1e-9.
    assert surprise(model) < 1e-8


@pytest.mark.parametrize("case", CONTACTS)
def test_the_step_is_foreseen_on_a_floor(case, request):
    if case == "pyramidal, condim 6":
        reason = "one step in forty: Newton's method circles among the many rows of the cones"
        request.applymarker(pytest.mark.xfail(reason=reason))
    assert surprise(tree(**CONTACTS[case])) < 1e-8


def test_constraints_as_dense_and_as_sparse_rows_are_the_same():
    found = []
    for jacobian in ("dense", "sparse"):
        model = tree(joint=DAMPED + ' range="-1 1" limited="true"', option=f'jacobian="{jacobian}"')
        sand, data = Sand(model, law=QUADRATIC, scheme="implicit"), mujoco.MjData(model)
        data.qvel[:] = 1.0
        for _ in range(50):
            sand.step(data)
        found.append(data.qpos.copy())
    assert found[0] == pytest.approx(found[1], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_two_lone_free_bodies_are_foreseen(integrator):
    # MuJoCo's implicitfast takes their gyroscopic moment implicitly too.
    box = '<body pos="{} 0 0"><freejoint/><geom type="box" size=".08 .06 .04"/></body>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="0.01" integrator="{integrator}"/>'
        f"<worldbody>{box.format(0)}{box.format(1)}</worldbody></mujoco>"
    )
    assert surprise(model) < 1e-9


def test_eulers_damping_may_be_off():
    model = tree(joint=DAMPED)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    assert surprise(model) < 1e-9


# Order of convergence


CASES = [(10, 45), (5, 45), (1, 45), (2, 60), (2, 45), (2, 30)]
STEPS = (4e-5, 2e-5, 1e-5)


def stop(timestep, speed, angle_deg, **sand):
    """Time and depth at which T is deepest, by a parabola through three positions."""
    link, q = Link(), math.radians(angle_deg)
    model = link.model(timestep)
    data = mujoco.MjData(model)
    sand = Sand(model, scheme="implicit", bodies="link", **sand)
    data.qpos[:] = link.touching(q)
    data.qvel[:] = link.moving(q, speed, 0.0, 0.0)
    depths = [0.0]
    while len(depths) < 3 or depths[-1] > depths[-2]:
        sand.step(data)
        depths.append(link.tip(data.qpos, data.qvel)[1])
    before, top, after = depths[-3:]
    part = (before - after) / (2 * (before - 2 * top + after))
    return np.array([(len(depths) - 2 + part) * timestep, top - (before - after) * part / 4])


@pytest.mark.parametrize(("speed", "angle"), CASES)
def test_the_papers_drops(paper, speed, angle):
    time, depth = stop(1e-5, speed, angle, law="link")
    printed = next(
        case for case in paper["cases"] if case["speed"] == speed and case["angle"] == angle
    )
    # Measured: at most 0.10 % in time, 0.11 % in depth.
    assert time == pytest.approx(printed["time"], rel=5e-3)
    assert depth == pytest.approx(printed["depth"], rel=5e-3)


@pytest.mark.parametrize(("speed", "angle"), [(10, 45), (2, 30)])
def test_first_order_in_the_lumped_law(reference, speed, angle):
    solved = reference.solve(reference.Drop(speed=speed, angle=math.radians(angle)))
    errors = [abs(stop(h, speed, angle, law="link") - [solved.time, solved.depth]) for h in STEPS]
    assert (np.log2(errors[0] / errors[-1]) / 2 > 0.9).all()
    assert (errors[-1] / [solved.time, solved.depth] < 2e-3).all()


@pytest.mark.parametrize(("speed", "angle"), [(5, 45), (2, 60)])
def test_first_order_in_the_distributed_law(speed, angle):
    # Against its own limit, extrapolated from two finer steps.
    fine, finer = (stop(h, speed, angle, law="link_distributed") for h in (2e-6, 1e-6))
    limit = 2 * finer - fine
    errors = [abs(stop(h, speed, angle, law="link_distributed") - limit) for h in STEPS]
    assert (np.log2(errors[0] / errors[-1]) / 2 > 0.9).all()


def test_both_schemes_have_one_limit():
    # Just after the stop, when the link still turns; both at 1 us.
    link, found = Link(), []
    for scheme in ("explicit", "implicit"):
        model = link.model(1e-6)
        data = mujoco.MjData(model)
        sand = Sand(model, law="link_distributed", bodies="link", scheme=scheme)
        data.qpos[:] = link.touching(math.pi / 4)
        data.qvel[:] = link.moving(math.pi / 4, 10.0, 0.0, 0.0)
        for _ in range(8000):
            sand.step(data)
        found.append(data.qpos.copy())
    assert found[0] == pytest.approx(found[1], abs=1e-4)  # measured: 3e-5 rad


# The state is MuJoCo's own


SERVOED = {
    "joint": DAMPED + ' range="-20 20" limited="true" frictionloss="0.01"',
    "more": '<actuator><position joint="b" kp="5"/><general joint="c" dyntype="filter" '
    'dynprm=".02" gainprm="3"/></actuator>',
}


@pytest.fixture
def servoed():
    return tree(**SERVOED)


def begin(model):
    data = mujoco.MjData(model)
    data.qpos[2] = 0.02
    data.qvel[:] = np.linspace(-1, 1, model.nv)
    data.ctrl[:] = [0.3, -0.5]
    data.xfrc_applied[1] = [0.3, 0, 0, 0, 0.02, 0]
    return data


def run(sand, data, steps):
    for _ in range(steps):
        sand.step(data)
    return state(sand, data)


def test_a_copied_simulation_repeats(servoed):
    sand, data = Sand(servoed, law=QUADRATIC, scheme="implicit"), begin(servoed)
    run(sand, data, 57)
    other, third = mujoco.MjData(servoed), copy.copy(data)
    mujoco.mj_copyData(other, servoed, data)
    expected = run(sand, data, 43)
    assert np.array_equal(run(sand, other, 43), expected)
    assert np.array_equal(run(copy.copy(sand), third, 43), expected)


def test_a_restored_simulation_repeats(servoed):
    sand, data = Sand(servoed, law=QUADRATIC, scheme="implicit"), begin(servoed)
    run(sand, data, 57)
    kept = state(sand, data)
    expected = run(sand, data, 43)
    run(sand, data, 10)
    mujoco.mj_setState(servoed, data, kept, STATE)
    assert np.array_equal(run(sand, data, 43), expected)
    other = mujoco.MjData(servoed)
    mujoco.mj_setState(servoed, other, kept, STATE)
    assert np.array_equal(run(sand, other, 43), expected)


def test_a_reset_simulation_repeats(servoed):
    sand, data = Sand(servoed, law=QUADRATIC, scheme="implicit"), begin(servoed)
    start = state(sand, data)
    expected = run(sand, data, 100)
    mujoco.mj_resetData(servoed, data)
    mujoco.mj_setState(servoed, data, start, STATE)
    assert np.array_equal(run(sand, data, 100), expected)


def test_a_pickled_simulation_repeats(servoed):
    sand, data = Sand(servoed, law=QUADRATIC, scheme="implicit"), begin(servoed)
    run(sand, data, 57)
    there = pickle.loads(pickle.dumps(sand))
    other = mujoco.MjData(there.model)
    mujoco.mj_setState(there.model, other, state(sand, data), STATE)
    assert np.array_equal(run(there, other, 43), run(sand, data, 43))


def test_simulations_in_threads_are_the_same(servoed):
    sand = Sand(servoed, law=QUADRATIC, scheme="implicit")
    expected = run(sand, begin(servoed), 200)
    many = [begin(servoed) for _ in range(4)]
    threads = [threading.Thread(target=run, args=(sand, data, 200)) for data in many]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(state(sand, data), expected) for data in many)


def test_users_forces_stay(servoed):
    sand, data = Sand(servoed, law=QUADRATIC, scheme="implicit"), begin(servoed)
    own = data.xfrc_applied.copy()
    run(sand, data, 20)
    assert np.array_equal(data.xfrc_applied, own)


def test_report_is_what_the_next_step_does(servoed):
    sand, data = Sand(servoed, law=QUADRATIC, scheme="implicit"), begin(servoed)
    run(sand, data, 30)
    before = state(sand, data)
    report = sand.report(data)
    assert np.array_equal(state(sand, data), before)
    mujoco.mj_step1(servoed, data)
    own = data.xfrc_applied.copy()
    sand.apply(data)
    for body in report.bodies:
        row = servoed.body(body.body).id
        share = data.xfrc_applied[row] - own[row]
        assert share == pytest.approx(
            np.concatenate([body.force, body.moment]), rel=1e-9, abs=1e-12
        )


# Bad input


BLOB = '<body name="blob"><freejoint/><geom name="blob" size=".05"/></body>'


def world(*parts, option=""):
    xml = f"<mujoco><option {option}/><worldbody>{''.join(parts)}</worldbody></mujoco>"
    return mujoco.MjModel.from_xml_string(xml)


def test_runge_kutta_is_refused():
    with pytest.raises(InputError, match="RK4 cannot be stepped"):
        Sand(world(BLOB, option='integrator="RK4"'), law=QUADRATIC, scheme="implicit")


def test_an_integrator_it_does_not_know_is_refused():
    with pytest.raises(InputError, match="Euler, implicit and implicitfast"):
        Sand(world(BLOB, option='integrator="discrete"'), law=QUADRATIC, scheme="implicit")


def test_evaluations_must_be_one_or_more():
    with pytest.raises(InputError, match="at least 1, not 0"):
        Implicit(evaluations=0)


@pytest.mark.slow  # compiles a program of its own
def test_an_evaluation_or_two_do_no_harm():
    # Softer rest, counted; but no energy from nowhere.
    model = world(BLOB)
    sand = Sand(model, law=QUADRATIC, scheme=Implicit(evaluations=1))
    data = mujoco.MjData(model)
    data.qvel[:3] = 1.0
    for _ in range(500):
        sand.step(data)
    assert abs(data.qvel).max() < 1.0
    assert np.isfinite(data.qpos).all()


@pytest.mark.parametrize("name", SANDS)
def test_huge_speeds_stop_or_say_so(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file
    rods = name.startswith("link")
    for speed in (1e3, 1e6):
        model = mujoco.MjModel.from_xml_string(BODY.format(geoms=RODS if rods else SKINS))
        sand, data = sand_of(name, model), mujoco.MjData(model)
        data.qvel[:3] = speed
        before = data.qpos.copy()
        try:
            sand.step(data)
        except UnstableError:  # in one sentence, and the last good state is back
            assert np.array_equal(data.qpos, before)
            assert (data.qvel[:3] == speed).all()
        else:
            assert data.qvel[:3] @ data.qvel[:3] <= 3 * speed**2 * (1 + 1e-12)


def test_nan_in_a_control_is_mujocos_to_refuse(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = tree(**SERVOED)
    sand, data = Sand(model, law=QUADRATIC, scheme="implicit"), begin(model)
    run(sand, data, 10)
    data.ctrl[0] = math.nan
    run(sand, data, 10)  # MuJoCo sets bad controls to zero, with a warning
    assert data.warning[int(mujoco.mjtWarning.mjWARN_BADCTRL)].number > 0
    other = begin(model)
    run(sand, other, 10)
    other.ctrl[:] = 0.0
    run(sand, other, 10)
    assert np.array_equal(data.qpos, other.qpos)


@pytest.mark.parametrize("field", ["qfrc_applied", "xfrc_applied"])
def test_nan_in_a_force_is_named(field):
    model = world(BLOB)
    sand, data = Sand(model, law=QUADRATIC, scheme="implicit"), mujoco.MjData(model)
    for _ in range(3):
        sand.step(data)
    kept = data.qpos.copy(), data.qvel.copy()
    getattr(data, field)[...] = math.nan
    with pytest.raises(UnstableError, match="not finite at t = "):
        sand.step(data)
    assert np.array_equal(data.qpos, kept[0])
    assert np.array_equal(data.qvel, kept[1])
    getattr(data, field)[...] = 0.0
    sand.step(data)  # and on it goes
    assert np.isfinite(data.qvel).all()


def test_thousands_of_elements_on_one_body():
    model = mujoco.MjModel.from_xml_string(
        BODY.format(geoms='<geom type="capsule" size=".02 .1"/>')
    )
    ends = []
    for pieces in (20, 5000):
        sand, data = sand_of("link_distributed", model, resolution=pieces), mujoco.MjData(model)
        data.qpos[2] = -0.03
        data.qvel[:] = [0.3, 0, -1, 0, 2, 0]
        for _ in range(100):
            sand.step(data)
        assert account(sand, data)["unfinished"] == 0
        ends.append(data.qpos.copy())
    assert ends[0] == pytest.approx(ends[1], abs=1e-3)


def test_bodies_fixed_to_the_world_and_mocap_bodies():
    fixed = '<body name="fixed" pos="0 0 -.2"><geom size=".05"/></body>'
    mocap = '<body name="mocap" mocap="true" pos="1 0 0"><geom size=".05"/></body>'
    alone, among = world(BLOB), world(fixed, mocap, BLOB)
    for name in ("fixed", "mocap"):
        with pytest.raises(InputError, match="is fixed to the world"):
            Sand(among, law=QUADRATIC, scheme="implicit", bodies=[name])
    ends = []
    for model in (alone, among):
        sand, data = Sand(model, law=QUADRATIC, scheme="implicit"), mujoco.MjData(model)
        for _ in range(20):
            sand.step(data)
        ends.append(data.qpos.copy())
    assert np.array_equal(*ends)


def test_a_blob_hung_from_a_mocap_body_follows_it():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody>"
        '<body name="hand" mocap="true"><geom size=".01" contype="0" conaffinity="0"/></body>'
        f"{BLOB}</worldbody>"
        '<equality><weld body1="hand" body2="blob"/></equality></mujoco>'
    )
    sand, data = Sand(model, law=QUADRATIC, scheme="implicit"), mujoco.MjData(model)
    for i in range(500):
        data.mocap_pos[0] = [0.0002 * i, 0, -0.0001 * i]
        sand.step(data)
    assert data.qpos[:3] == pytest.approx(data.mocap_pos[0], abs=0.02)
    assert account(sand, data)["unfinished"] == 0


def test_above_the_sand_nothing_is_done():
    model = world(BLOB)
    sand, data, bare = (
        Sand(model, law=QUADRATIC, scheme="implicit"),
        mujoco.MjData(model),
        mujoco.MjData(model),
    )
    data.qpos[2] = bare.qpos[2] = 100.0
    for _ in range(20):
        sand.step(data)
        mujoco.mj_step(model, bare)
    assert np.array_equal(data.qpos, bare.qpos)
    assert account(sand, data)["steps"] == 0


def test_a_body_without_mass():
    # One that hangs rigidly on another is all that MuJoCo allows.
    child = '<body pos=".1 0 0"><geom size=".03" mass="0"/></body>'
    model = world(BLOB.replace("</body>", child + "</body>"))
    sand, data = Sand(model, law=QUADRATIC, scheme="implicit"), mujoco.MjData(model)
    for _ in range(500):
        sand.step(data)
    assert len(sand.elements) == 2
    assert abs(data.qvel).max() < 1e-9


def test_a_heap_of_contacts():
    balls = "".join(
        f'<body pos="{0.09 * (i % 4)} {0.09 * (i // 4 % 4)} {0.09 * (i // 16)}"><freejoint/>'
        '<geom size=".05"/></body>'
        for i in range(32)
    )
    model = world('<geom type="plane" size="2 2 .1" pos="0 0 -.1"/>', balls)
    sand, data = Sand(model, law=QUADRATIC, scheme="implicit"), mujoco.MjData(model)
    most = 0
    for _ in range(40):
        sand.step(data)
        most = max(most, data.nefc)
    assert most > 200
    assert np.isfinite(data.qpos).all()
    assert not data.warning.number.any()


@settings(max_examples=20)
@given(exponent=st.floats(-9, 0))
def test_any_step(exponent):
    model = world(BLOB, option=f'timestep="{10**exponent}"')
    sand, data = Sand(model, law=QUADRATIC, scheme="implicit"), mujoco.MjData(model)
    for _ in range(20):
        sand.step(data)
    assert np.isfinite(data.qpos).all()
    assert account(sand, data)["unfinished"] == 0


def test_weak_law_of_a_users_own_form():
    # No limit at all: drag alone, taken linearly implicitly, decays and never overshoots.
    model = world(BLOB, option='timestep="0.1" gravity="0 0 0"')
    sand = Sand(model, law=DepthVelocityLaw(linear=1e6), scheme="implicit")
    data = mujoco.MjData(model)
    data.qvel[0] = 1.0
    sand.step(data)
    mass = model.body_mass[1]
    assert data.qvel[0] == pytest.approx(1 / (1 + 0.1 * 1e6 / mass), rel=1e-9)


def test_a_law_without_resistance_does_nothing():
    model = Link().model(1e-3)
    sand = Sand(model, law=DistributedLinkLaw(0.0, 0.0, 0.0, 1.0), scheme="implicit", bodies="link")
    data, bare = mujoco.MjData(model), mujoco.MjData(model)
    for _ in range(100):
        sand.step(data)
        mujoco.mj_step(model, bare)
    assert data.qpos == pytest.approx(bare.qpos, rel=1e-12)
