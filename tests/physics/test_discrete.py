"""MuJoCo's integrator `discrete` under the implicit scheme: its effective metric is predicted."""

from functools import partial

import mujoco
import numpy as np
import pytest

from mjgranular import DepthVelocityLaw, Sand, add_sand

BLOB = DepthVelocityLaw(constant=0.3, stiffness=30.0, exponent=1.0, linear=0.1, quadratic=2.0)
STEPS = 40

# Two trees and a loose body; what is in the metric is drawn into the gaps. The tolerance is not 0:
# with it MuJoCo's own solve for the acceleration without constraints may end in NaN.
MODEL = """
<mujoco>
  <option integrator="discrete" timestep="{timestep}" tolerance="1e-14" iterations="200" {option}/>
  <worldbody>{floor}
    <body name="a" gravcomp="{share}">{root}
      <geom type="box" size=".08 .06 .04" pos=".02 0 .01"/><site name="a"/>
      <body name="b" pos=".1 0 0">
        <joint name="b" axis="0 1 .3" {joint}/>
        <geom type="capsule" fromto="0 0 0 .15 0 0" size=".02"/>
        <body name="c" pos=".15 0 0">
          <joint name="c" type="{kind}" axis="0 .2 1" {joint}/>
          <geom type="capsule" fromto="0 0 0 .1 .05 0" size=".02"/>
          <site name="c" pos=".05 .02 .02"/>
        </body>
      </body>
    </body>
    <body name="d" pos="0 .5 0">
      <joint name="d" type="slide" axis="0 0 1" {joint}/><joint name="e" axis="1 0 0" {joint}/>
      <geom type="ellipsoid" size=".05 .08 .04"/><site name="d"/>
    </body>
    <body name="loose" pos="0 -.5 .02"><freejoint/>
      <geom type="box" size=".08 .06 .04" pos=".02 .01 0"/>
    </body>
  </worldbody>
  <tendon>{tendons}</tendon>
  <actuator>{actuators}</actuator>
  <equality>{equalities}</equality>
</mujoco>
"""
ROOTS = (
    "<freejoint/>",
    '<joint type="free" stiffness="5 1" damping=".1 .05"/>',
    '<joint type="ball" damping=".02" stiffness=".5" armature=".001"/>',
)
JOINTS = (
    "",
    'damping=".02 .03 .01"',
    'damping=".05" stiffness="3"',
    'stiffness="2 -1 4" springref=".2" armature=".002"',
    'damping=".02" frictionloss=".02" range="-10 10" limited="true"',
)
TENDONS = (
    "",
    '<fixed name="t" stiffness="2" damping=".05"><joint joint="b" coef="1"/>'
    '<joint joint="e" coef="-.5"/></fixed>',
    '<spatial name="t" stiffness="8 3" damping=".3 .1" armature=".01" springlength=".1 .2">'
    '<site site="a"/><site site="c"/><site site="d"/></spatial>',
)
ACTUATORS = (
    '<position joint="b" kp="20" kv=".3"/><velocity joint="d" kv="2"/>',
    '<motor joint="b" damping=".3" armature=".01"/><position joint="e" kp="5" forcerange="-1 1"/>',
    '<general joint="b" dyntype="filter" dynprm=".02" gainprm="3" actearly="true" '
    'biastype="affine" biasprm="0 -3 -.1"/>',
    '<position joint="d" kp="50" dampratio="1"/><muscle joint="b" lengthrange="0 1"/>',
)
OPTIONS = (
    "",
    'density="1000" viscosity=".5"',
    'solver="CG" cone="elliptic"',
    'jacobian="sparse" cone="elliptic"',
)
FLOORS = ("", '<geom type="plane" size="2 2 .1" pos="0 0 -.06"/>')
EQUALITIES = (
    "",
    '<connect body1="d" body2="world" anchor="0 0 0"/>',
    '<joint joint1="b" joint2="e"/>',
)


def drawn(seed, **sand):
    """A model, with a draw from each of these, and with sand in it if some is asked for."""
    rng = np.random.default_rng(seed)
    tendon = str(rng.choice(TENDONS))
    pulled = tendon and rng.random() < 0.5
    xml = MODEL.format(
        timestep=rng.choice([5e-4, 2e-3, 5e-3]),
        option=rng.choice(OPTIONS),
        floor=rng.choice(FLOORS),
        share=rng.choice([0, 0.3]),
        root=rng.choice(ROOTS),
        joint=rng.choice(JOINTS),
        kind=rng.choice(["hinge", "slide"]),
        tendons=tendon,
        actuators=str(rng.choice(ACTUATORS))
        + ('<position tendon="t" kp="10" kv=".2"/>' if pulled else ""),
        equalities=rng.choice(EQUALITIES),
    )
    spec = mujoco.MjSpec.from_string(xml)
    if rng.random() < 0.3:
        spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_DIAGEXACT)
    if rng.random() < 0.3:
        off = rng.choice(["SPRING", "DAMPER", "GRAVITY", "WARMSTART"])
        spec.option.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{off}"))
    if sand:
        add_sand(spec, **sand)
    return spec.compile()


def push(model, data, rng):
    """Controls and forces of all kinds for one step."""
    data.ctrl[:] = rng.normal(size=model.nu)
    data.qfrc_applied[:] = rng.normal(scale=0.05, size=model.nv)
    data.xfrc_applied[1:] = rng.normal(scale=0.05, size=(model.nbody - 1, 6))


@pytest.mark.parametrize("seed", range(24))
def test_drawn_steps_are_predicted_and_take_energy(seed):
    model, rng = drawn(seed), np.random.default_rng(seed)
    sand, data = Sand(model, law=BLOB, scheme="implicit"), mujoco.MjData(model)
    data.qvel[:] = rng.normal(scale=0.5, size=model.nv)
    wet = 0
    for _ in range(STEPS):
        push(model, data, rng)
        before = data.qvel.copy()
        sand.step(data)
        workspace = sand._bindings[data].workspace
        arrays, account = workspace.arrays, workspace.statistics[0]
        if account["steps"] == wet:
            continue
        wet = account["steps"]
        # In parts of the speeds at hand, beyond what the solver says it has left.
        size = max(abs(data.qvel).max(), abs(data.qvel - before).max())
        unlike = abs(data.qvel - arrays["velocity"]).max() / size
        # Measured over 200 models: nothing beyond that.
        assert unlike <= 1e-9 + 1000 * account["residual"]
        assert arrays["sand"] @ data.qvel <= 1e-12
    assert wet > STEPS / 2


@pytest.mark.parametrize("seed", range(24))
def test_both_doors_give_the_same_steps(seed):
    model, with_sand = drawn(seed), drawn(seed, law=BLOB, scheme="implicit")
    sand, mine, theirs = (
        Sand(model, law=BLOB, scheme="implicit"),
        mujoco.MjData(model),
        mujoco.MjData(with_sand),
    )
    rng = np.random.default_rng(seed)
    mine.qvel[:] = rng.normal(scale=0.5, size=model.nv)
    for _ in range(STEPS):
        push(model, mine, rng)
        mujoco.mj_copyState(model, mine, theirs, mujoco.mjtState.mjSTATE_INTEGRATION)
        sand.step(mine)
        mujoco.mj_step(with_sand, theirs)
        size = abs(mine.qvel).max()
        np.testing.assert_allclose(theirs.qvel, mine.qvel, rtol=0, atol=1e-12 * size)


FLEX = """
<mujoco>
  <option integrator="discrete" timestep="0.002" tolerance="1e-14" iterations="200"/>
  <worldbody>
    <body name="ball" pos="0 0 .03"><freejoint/><geom size=".05"/></body>
    <flexcomp name="flex" type="grid" count="{count}" spacing=".05 .05 .05" pos="0 0 {height}"
        radius=".01" mass=".2" dim="{dim}">
      <elasticity young="2e4" poisson=".3" damping=".01" {more}/>
    </flexcomp>
  </worldbody>
</mujoco>
"""


@pytest.mark.filterwarnings("ignore::mjgranular.errors.UnfeltWarning")
@pytest.mark.parametrize(
    ("count", "height", "dim", "more"),
    [("4 4 1", 0.1, 2, 'thickness="1e-2" elastic2d="both"'), ("3 3 3", 0.14, 3, "")],
)
def test_what_meets_a_flex_is_predicted(count, height, dim, more):
    model = mujoco.MjModel.from_xml_string(
        FLEX.format(count=count, height=height, dim=dim, more=more)
    )
    sand, data = Sand(model, law=BLOB, scheme="implicit"), mujoco.MjData(model)
    contacts = 0
    for _ in range(60):
        before = data.qvel.copy()
        sand.step(data)
        contacts = max(contacts, data.ncon)
        workspace = sand._bindings[data].workspace
        size = max(abs(data.qvel).max(), abs(data.qvel - before).max())
        unlike = abs(data.qvel - workspace.arrays["velocity"]).max() / size
        assert unlike <= 1e-7 + 1000 * workspace.statistics[0]["residual"]
    assert contacts > 0


@pytest.mark.parametrize("door", ["step", "plugin"])
def test_a_controller_is_called_once_in_a_step(door):
    # Metric and constraint rows are asked for without a step of MuJoCo's.
    model = drawn(4, law=BLOB, scheme="implicit") if door == "plugin" else drawn(4)
    step = partial(mujoco.mj_step, model)
    if door == "step":
        step = Sand(model, law=BLOB, scheme="implicit").step
    data, calls = mujoco.MjData(model), []
    mujoco.set_mjcb_control(lambda model, data: calls.append(data.time))
    try:
        for _ in range(5):
            step(data)
    finally:
        mujoco.set_mjcb_control(None)
    assert len(calls) == 5


def test_a_loop_that_changes_to_it_between_the_halves_of_a_step_goes_on():
    # There is no metric in that step: MuJoCo makes it in the first half.
    model = drawn(4)
    sand, data = Sand(model, law=BLOB, scheme="implicit"), mujoco.MjData(model)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    mujoco.mj_step1(model, data)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    sand.apply(data)
    mujoco.mj_step2(model, data)
    for _ in range(20):
        sand.step(data)
    assert np.isfinite(data.qpos).all()
