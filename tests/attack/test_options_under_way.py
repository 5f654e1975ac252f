"""Options that MuJoCo lets one change at any step: sand goes on, or says why it cannot."""

from itertools import product

import pytest

DOORS = pytest.mark.parametrize("door", ["step", "plugin"])

# Boxes that stand on a floor, in sand: rows of constraints, and nothing that moves.
AT_REST = """
import mujoco
import numpy as np
from mjgranular import GranularError, Sand
from mjgranular.engine import add_sand


def run(door, jacobian, number, line):
    boxes = "".join(
        f'<body pos="{0.3 * i} 0 0"><freejoint/><geom type="box" size=".1 .1 .1"/></body>'
        for i in range(number)
    )
    spec = mujoco.MjSpec.from_string(
        f'<mujoco><option timestep="2e-3" jacobian="{jacobian}"/><worldbody>'
        f'<geom type="plane" size="9 9 .1" pos="0 0 -.09"/>{boxes}</worldbody></mujoco>'
    )
    if door == "plugin":
        add_sand(spec, medium="quikrete_medium", scheme="implicit")
    model = spec.compile()
    data = mujoco.MjData(model)
    sand = Sand(model, medium="quikrete_medium", scheme="implicit") if door == "step" else None

    def steps(count):
        fastest = 0.0
        for _ in range(count):
            sand.step(data) if sand else mujoco.mj_step(model, data)
            fastest = max(fastest, np.abs(data.qvel).max())
        return float(fastest)

    steps(400)
    assert steps(10) < 1e-6
    exec(line)
    try:
        return steps(100)
    except (GranularError, mujoco.FatalError) as error:
        return str(error)
    finally:
        assert not data.warning.number.any()
"""


def assert_still(told, lines):
    moved = {
        line: speed
        for line, speed in zip(lines, told, strict=True)
        if not isinstance(speed, str) and not speed < 1e-6
    }
    assert not moved  # [m/s]


@pytest.mark.slow
@DOORS
@pytest.mark.parametrize(("before", "after"), [("sparse", "DENSE"), ("dense", "SPARSE")])
def test_the_jacobian_may_be_stored_otherwise_at_any_step(survive, door, before, after):
    line = f"model.opt.jacobian = mujoco.mjtJacobian.mjJAC_{after}"
    cases = [(door, before, number, line) for number in (12, 2)]
    assert_still(survive(AT_REST, cases), (12, 2))


@pytest.mark.slow
@DOORS
def test_what_rests_goes_on_resting(survive, door):
    lines = (
        "model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST",
        "model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT",
        "model.opt.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE",
        "model.opt.solver = mujoco.mjtSolver.mjSOL_CG",
        "model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC",
        "model.dof_damping[:] = 0.1",
        "model.opt.timestep = 5e-3",
        "model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP",
        "model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART",
        "model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND",
    )
    assert_still(survive(AT_REST, [(door, "auto", 2, line) for line in lines]), lines)


@pytest.mark.slow
@DOORS
def test_an_integrator_that_cannot_be_stepped_is_refused_under_way(survive, door):
    line = "model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4"
    (told,) = survive(AT_REST, [(door, "auto", 2, line)])
    assert "integrator" in str(told)


NO_TIME = """
import mujoco
import numpy as np
from mjgranular import GranularError, Sand
from mjgranular.engine import add_sand


def run(door, scheme, line):
    spec = mujoco.MjSpec.from_string(
        '<mujoco><option timestep="1e-4"/><worldbody><body pos="0 0 -.05"><freejoint/>'
        '<geom type="capsule" size=".02 .1"/></body></worldbody></mujoco>'
    )
    if door == "plugin":
        add_sand(spec, law="link", scheme=scheme)
    model = spec.compile()
    data = mujoco.MjData(model)
    sand = Sand(model, law="link", scheme=scheme) if door == "step" else None
    data.qvel[:] = 1.0
    step = sand.step if sand else lambda data: mujoco.mj_step(model, data)
    step(data)
    exec(line)
    try:
        for _ in range(3):
            step(data)
    except (GranularError, mujoco.FatalError):
        return "announced"
    if data.warning.number.any():
        return "announced"
    if np.isfinite(data.qpos).all() and np.abs(data.qvel).max() < 10.0:
        return "fine"
    return f"silent: {np.abs(data.qvel).max()} m/s"
"""


@pytest.mark.slow
@DOORS
def test_a_time_step_that_is_none(survive, door):
    values = ("0", "-1e-3", "np.nan", "np.inf", "1e-30", "1e10")
    lines = [f"model.opt.timestep = {value}" for value in values]
    cases = [(door, *case) for case in product(("implicit", "explicit"), lines)]
    told = survive(NO_TIME, cases)
    silent = {case: text for case, text in zip(cases, told, strict=True) if "silent" in text}
    assert not silent
