"""Options of the model that are changed between two steps, through both doors."""

import mujoco
import numpy as np
import pytest

from mjgranular import InputError, Sand, add_sand

SAND = {"medium": "quikrete_medium"}
BOXES = "".join(
    f'<body pos="{0.3 * i} 0 0"><freejoint/><geom type="box" size=".1 .1 .1"/></body>'
    for i in range(3)
)
# Boxes on a floor just under the surface of the sand: constraints and sand hold them together.
WORLD = """
<mujoco>
  <option timestep="2e-3" {option}/>
  <worldbody>
    <geom type="plane" size="9 9 .1" pos="0 0 -.09"/>
    {bodies}
  </worldbody>
</mujoco>
"""
LONE = """
<mujoco>
  <option timestep="1e-3" integrator="{integrator}" {option}/>
  <worldbody>
    <body pos="0 0 -.06" quat="-1.3 -.62 1.45 -1.6">
      <joint name="free" type="free" damping="{damping}"/>
      <geom type="capsule" size=".18 .012" pos=".05 .12 .2" quat=".9 1.6 -.45 -.87" density="460"/>
      {more}
    </body>
  </worldbody>
</mujoco>
"""
DOORS = ("step", "plugin")


def boxes(option=""):
    return WORLD.format(option=option, bodies=BOXES)


class Run:
    """A simulation of a model in the sand, through one of the doors."""

    def __init__(self, xml, door, **sand):
        given = {**SAND, **sand}
        if door == "plugin":
            spec = mujoco.MjSpec.from_string(xml)
            add_sand(spec, **given)
            self.model = spec.compile()
            self._step = lambda: mujoco.mj_step(self.model, self.data)
        else:
            self.model = mujoco.MjModel.from_xml_string(xml)
            self.sand = Sand(self.model, **given)
            self._step = lambda: self.sand.step(self.data)
        self.data = mujoco.MjData(self.model)

    def step(self, count=1):
        for _ in range(count):
            self._step()


def work_of_step(sand, data):
    """One step; the work of the sand in it, by the velocities that it truly ends with [J]."""
    model = sand.model
    mujoco.mj_step1(model, data)
    sand.apply(data)
    momentum = np.zeros(model.nv)
    for body in np.unique(sand.elements["body"]):
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacBodyCom(model, data, linear, angular, body)
        wrench = data.xfrc_applied[body]
        momentum += linear.T @ wrench[:3] + angular.T @ wrench[3:]
    mujoco.mj_step2(model, data)
    return model.opt.timestep * momentum @ data.qvel


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("first", ["sparse", "dense"])
def test_another_jacobian_under_way(door, first):
    run = Run(boxes(f'jacobian="{first}"'), door)
    run.step(400)
    other = {"sparse": "DENSE", "dense": "SPARSE"}[first]
    run.model.opt.jacobian = mujoco.mjtJacobian.__members__[f"mjJAC_{other}"]
    place = run.data.qpos.copy()
    run.step(200)
    assert abs(run.data.qpos - place).max() < 1e-8


CHANGES = {
    "jacobian": 1,
    "integrator": 2,
    "solver": 0,
    "cone": 1,
    "iterations": 1,
    "noslip_iterations": 3,
    "timestep": 1e-3,
    "impratio": 10.0,
    "disableflags": int(mujoco.mjtDisableBit.mjDSBL_WARMSTART),
}


@pytest.mark.parametrize("name", CHANGES)
def test_both_doors_go_on_alike(name):
    runs = [Run(boxes(), door) for door in DOORS]
    for run in runs:
        run.data.qvel[:] = np.random.default_rng(0).normal(size=run.model.nv)
        run.step(10)
        setattr(run.model.opt, name, CHANGES[name])
        run.step(10)
    # PGS from a cold start stops where it is, and so does a solver with one iteration.
    close = 1e-4 if name in ("solver", "iterations", "noslip_iterations", "disableflags") else 1e-8
    assert abs(runs[0].data.qvel - runs[1].data.qvel).max() < close


@pytest.mark.parametrize("door", DOORS)
def test_runge_kutta_under_way_is_refused(door):
    run = Run(boxes(), door)
    run.step()
    run.model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    place = run.data.qpos.copy()
    with pytest.raises(
        (InputError, mujoco.FatalError), match=r"RK4.*Euler, implicit, .* or discrete"
    ):
        run.step()
    assert (run.data.qpos == place).all()
    run.model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    run.step()
    assert (run.data.qpos != place).any()


@pytest.mark.parametrize(
    ("option", "told"),
    [
        ('integrator="RK4"', r"implicit(fast|, implicit| or)"),
        (
            'integrator="discrete" solver="PGS"',
            r"discrete .* Newton and CG .* or scheme='explicit'",
        ),
    ],
)
@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("scheme", ["auto", "implicit"])
def test_what_the_chosen_scheme_cannot_step_is_refused_at_once(door, scheme, option, told):
    with pytest.raises((InputError, ValueError), match=told):
        Run(boxes(option), door, scheme=scheme)


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("solver", int(mujoco.mjtSolver.mjSOL_PGS)),
        ("enableflags", int(mujoco.mjtEnableBit.mjENBL_IPC)),
    ],
)
def test_what_discrete_is_not_predicted_with_is_refused_under_way(door, name, value):
    run = Run(boxes('integrator="discrete" solver="CG"'), door)
    run.step()
    good, place = getattr(run.model.opt, name), run.data.qpos.copy()
    setattr(run.model.opt, name, value)
    with pytest.raises((InputError, mujoco.FatalError), match="integrator discrete"):
        run.step()
    assert (run.data.qpos == place).all()
    setattr(run.model.opt, name, good)
    run.step()
    assert (run.data.qpos != place).any()


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("solver", [-3, 3, 99])
def test_a_solver_that_is_none(door, solver):
    """The engine raises an error for it, which would end the process where we ask for forces."""
    run = Run(boxes('solver="PGS"'), door)
    run.step()
    run.model.opt.solver = solver
    with pytest.raises((InputError, mujoco.FatalError), match=r"opt\.solver.*PGS, CG or Newton"):
        run.step()


@pytest.mark.parametrize("timestep", [0.0, -1e-3, np.nan, np.inf])
@pytest.mark.parametrize("scheme", ["explicit", "implicit"])
@pytest.mark.parametrize("door", DOORS)
def test_a_time_step_that_is_none(door, scheme, timestep):
    run = Run(boxes(), door, scheme=scheme, law="rft3d")
    run.step()
    run.model.opt.timestep = timestep
    with pytest.raises((InputError, mujoco.FatalError), match=r"opt\.timestep.*positive number"):
        run.step()


@pytest.mark.parametrize("door", DOORS)
def test_the_explicit_scheme_was_chosen_for_fine_steps(door):
    run = Run(boxes('timestep="1e-5"').replace('timestep="2e-3"', ""), door, law="rft3d")
    run.step()
    run.model.opt.timestep = 2e-5
    run.step()
    run.model.opt.timestep = 2e-3
    with pytest.raises((InputError, mujoco.FatalError), match=r"up to 2e-05 s.*implicit"):
        run.step()


def test_disabled_passive_forces_are_refused_by_the_plugin():
    both = int(mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER)
    run = Run(boxes(), "plugin")
    run.step()
    for one in (mujoco.mjtDisableBit.mjDSBL_SPRING, mujoco.mjtDisableBit.mjDSBL_DAMPER):
        run.model.opt.disableflags = int(one)
        run.step()
        assert abs(run.data.qfrc_passive).max() > 0
    run.model.opt.disableflags = both
    with pytest.raises(mujoco.FatalError, match="springs and dampers both disabled"):
        run.step()
    spec = mujoco.MjSpec.from_string(boxes())
    spec.option.disableflags = both
    add_sand(spec, **SAND)
    with pytest.raises(ValueError, match="springs and dampers both disabled"):
        spec.compile()
    sand = Run(boxes(), "step")  # from outside there is nothing amiss
    sand.model.opt.disableflags = both
    sand.step()


@pytest.mark.parametrize("scheme", ["explicit", "implicit"])
def test_disabled_gravity_is_no_gravity(scheme):
    forces = []
    for option in ('gravity="0 0 0"', ""):
        model = mujoco.MjModel.from_xml_string(boxes(option))
        if not option:
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_GRAVITY
        data = mujoco.MjData(model)
        data.qvel[2::6] = -1.0
        sand = Sand(model, law="rft3d", scheme=scheme, **SAND)
        forces.append([body.force for body in sand.report(data).bodies])
    np.testing.assert_array_equal(*forces)


# What the engine will do


def predicted(sand, data):
    return sand._bindings[data].workspace.arrays["velocity"]


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast", "discrete"])
@pytest.mark.parametrize(
    ("damping", "option", "more"),
    [
        (0, "", ""),
        (0.02, 'density="1000" viscosity="0.3"', ""),
        (
            0,
            "",
            '<body pos=".1 0 0"><geom type="capsule" size=".03 .02"/></body>',
        ),  # not alone: it carries a mass
        (
            0,
            "",
            '<body pos=".1 0 0"><joint axis="0 1 0"/><geom type="capsule" size=".03 .02"/></body>',
        ),
    ],
)
@pytest.mark.parametrize("factor", [1, 3])  # the second without `mj_setConst`
def test_a_body_with_its_mass_off_its_origin(integrator, damping, option, more, factor):
    xml = LONE.format(integrator=integrator, damping=damping, option=option, more=more)
    model = mujoco.MjModel.from_xml_string(xml)
    model.body_mass[1] *= factor
    model.body_inertia[1] *= factor
    worst = work = 0.0
    for seed in range(4):
        sand = Sand(model, law="link_distributed", scheme="implicit")
        data = mujoco.MjData(model)
        data.qvel[:] = 10 * np.random.default_rng(seed).normal(size=model.nv)
        for _ in range(30):
            size = abs(data.qvel).max()
            work = max(work, work_of_step(sand, data))
            worst = max(worst, abs(predicted(sand, data) - data.qvel).max() / size)
    assert work <= 1e-12
    assert worst < 1e-6


def test_damping_that_is_set_under_way():
    xml = LONE.format(integrator="Euler", damping=0, option="", more="")
    model = mujoco.MjModel.from_xml_string(xml)
    sand, data = Sand(model, law="link_distributed", scheme="implicit"), mujoco.MjData(model)
    data.qvel[:] = 10 * np.random.default_rng(0).normal(size=model.nv)
    sand.step(data)
    model.dof_damping[:] = 5.0
    for _ in range(30):
        size = abs(data.qvel).max()
        sand.step(data)
        assert abs(predicted(sand, data) - data.qvel).max() < 1e-6 * size


@pytest.mark.parametrize("solver", ["PGS", "CG", "Newton"])
@pytest.mark.parametrize("warmstart", ["enable", "disable"])
def test_a_starved_solver_gives_no_energy(solver, warmstart):
    xml = boxes(f'solver="{solver}" iterations="1"').replace(
        "/>\n  <worldbody>", f'><flag warmstart="{warmstart}"/></option>\n  <worldbody>'
    )
    model = mujoco.MjModel.from_xml_string(xml)
    for seed in range(6):
        # Sand that is moved along may give what it has.
        sand = Sand(model, scheme="implicit", law="rft3d", **SAND)
        data = mujoco.MjData(model)
        data.qvel[:] = np.random.default_rng(seed).normal(size=model.nv)
        assert max(work_of_step(sand, data) for _ in range(60)) <= 1e-12


def test_muscles_whose_range_of_length_the_compiler_finds() -> None:
    muscles = """<mujoco>{}<worldbody>
      <body name="foot" pos="0 0 .1"><freejoint/><geom type="box" size=".1 .05 .02"/>
        <body><joint name="knee" axis="0 1 0" range="-60 60"/>
          <geom type="capsule" fromto="0 0 .05 0 0 .2" size=".01"/></body></body>
      </worldbody>
      <actuator><muscle joint="knee"/><muscle joint="knee" gear="-2"/></actuator>{}</mujoco>"""
    plain = mujoco.MjModel.from_xml_string(muscles.format("", ""))
    sand = '<plugin plugin="mjgranular.sand"><instance name="sand"/></plugin>'
    model = mujoco.MjModel.from_xml_string(
        muscles.format(
            f'<extension>{sand}<plugin plugin="mjgranular.sensor"/></extension>',
            '<sensor><plugin plugin="mjgranular.sensor"><config key="measure" value="depth"/>'
            "</plugin></sensor>",
        )
    )
    np.testing.assert_array_equal(model.actuator_lengthrange, plain.actuator_lengthrange)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.sensordata[0] == pytest.approx(-0.08)
