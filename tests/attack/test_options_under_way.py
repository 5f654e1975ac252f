"""Options that MuJoCo lets one change at any step: sand goes on, or says why it cannot."""

from itertools import product

import pytest

DOORS = ("step", "plugin")

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


LINES = (
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
STORED = [
    (before, number, f"model.opt.jacobian = mujoco.mjtJacobian.mjJAC_{after}")
    for before, after in (("sparse", "DENSE"), ("dense", "SPARSE"))
    for number in (12, 2)
]
UNSTEPPED = ("auto", 2, "model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4")


@pytest.mark.slow
def test_what_rests_rests_on_or_the_change_is_refused(survive):
    """Also when the Jacobian is stored otherwise."""
    changes = [*STORED, *(("auto", 2, line) for line in LINES), UNSTEPPED]
    cases = [(door, *change) for door in DOORS for change in changes]
    found = dict(zip(cases, survive(AT_REST, cases), strict=True))
    for door in DOORS:
        assert "integrator" in str(found.pop((door, *UNSTEPPED)))
    moved = {
        case: speed
        for case, speed in found.items()
        if not isinstance(speed, str) and not speed < 1e-6
    }
    assert not moved  # [m/s]


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
def test_a_time_step_that_is_none(survive):
    values = ("0", "-1e-3", "np.nan", "np.inf", "1e-30", "1e10")
    lines = [f"model.opt.timestep = {value}" for value in values]
    cases = [*product(DOORS, ("implicit", "explicit"), lines)]
    told = survive(NO_TIME, cases)
    silent = {case: text for case, text in zip(cases, told, strict=True) if "silent" in text}
    assert not silent
