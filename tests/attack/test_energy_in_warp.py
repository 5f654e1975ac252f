"""Sand in MuJoCo Warp takes energy from random models, and never gives any.

Models have the integrator `discrete`. Each is stepped in several worlds with different initial
velocities. After each step the work of the sand is computed in double precision with the velocity
at the end of the step, by MuJoCo's kinematics:

- energy: of the forces that `WarpSand` reports;
- energy by inverse dynamics: of the forces that act on the bodies, if no constraint and no actuator
  is active. The relative precision of a velocity is 6e-8, so that the kinetic energy changes by
  such a part in any step, even without sand.

MuJoCo Warp recompiles for each number of degrees of freedom, and for each set of shapes that can
touch: only models with a few different numbers are drawn, and by default one of them has contacts.
"""

from __future__ import annotations

import warnings
from collections import Counter

import mujoco
import numpy as np
import pytest
from attacks import models
from attacks.cases import ModelCase, Result, arguments
from attacks.measure import kinetic_energy
from seeds import SEED, cases

mjw = pytest.importorskip("mujoco_warp")
wp = pytest.importorskip("warp")

from mjgranular.warp import WarpSand, coupled  # noqa: E402

FEW = cases(4) <= 4
SIZES = (12,) if FEW else (9, 12, 18)
SPEEDS = np.array([0.0, 0.1, 1.0, 5.0])[:, None]  # of the worlds
STEPS = 30
BAR = 1e-6  # in parts of the kinetic energy
JOULES = 1e-9  # least kinetic energy of a step that counts


def draw(number: int) -> ModelCase:
    """Draw a model that MuJoCo Warp supports, with a number of degrees of freedom in `SIZES`."""
    programs = [p for p in models.PROGRAMS if p[2] == "implicit" and "memory" not in p[1]]
    program = programs[number % len(programs)]
    rng = np.random.default_rng([SEED - 1, number])
    while True:
        case = models.draw(rng, program, number)
        spec = mujoco.MjSpec.from_string(case.xml)
        option = spec.option
        option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        option.noslip_iterations = option.enableflags = 0
        option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        if FEW and number:
            option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        if option.solver == mujoco.mjtSolver.mjSOL_PGS:
            option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        model = coupled(spec).compile()
        if model.nv not in SIZES:
            continue
        try:
            mjw.put_model(model)
        except (NotImplementedError, ValueError):  # not supported in MuJoCo Warp
            continue
        case.xml = spec.to_xml()
        return case


def run(case: ModelCase) -> Result:
    """Step a model, and check the work of the sand in each step."""
    wp.config.log_level = wp.LOG_ERROR
    result = Result()
    rng = np.random.default_rng(case.number)
    model = coupled(mujoco.MjSpec.from_string(case.xml)).compile()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sand = WarpSand(model, **arguments(case.sand))
    m, data = mjw.put_model(model), mujoco.MjData(model)
    d = mjw.put_data(model, data, nworld=len(SPEEDS), nconmax=100, njmax=400)
    sand.attach(m, d)
    m.opt.warn_overflow = 0
    d.qvel.assign((SPEEDS * rng.normal(size=(len(SPEEDS), model.nv))).astype(np.float32))
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_INVDISCRETE
    for _ in range(STEPS):
        before = [field.numpy().astype(float) for field in (d.qpos, d.qvel)]
        mjw.step(m, d)
        after = d.qvel.numpy().astype(float)
        wrenches = np.concatenate([sand.force.numpy(), sand.moment.numpy()], 2).astype(float)
        for world in range(len(SPEEDS)):
            data.qpos, data.qvel, end = before[0][world], before[1][world], after[world]
            finite = all(np.isfinite(each).all() for each in (data.qpos, data.qvel, end))
            if finite and wrenches[world].any():
                weigh(
                    model, data, end, dict(zip(sand.bodies, wrenches[world], strict=True)), result
                )
    return result


def weigh(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    end: np.ndarray,
    wrenches: dict[str, np.ndarray],
    result: Result,
) -> None:
    """Check the work in one step of one world.

    Args:
        model: the model.
        data: positions and velocities before the step.
        end: velocities after it.
        wrenches: force and moment of the sand on each body, by name.
        result: receives what is found.
    """
    h = model.opt.timestep
    data.qacc = (end - data.qvel) / h
    mujoco.mj_inverse(model, data)
    kinetic = max(kinetic_energy(model, data, speed) for speed in (data.qvel, end))
    if kinetic < JOULES:
        return
    force = np.zeros(model.nv)
    for name, wrench in wrenches.items():
        body = model.body(name).id
        mujoco.mj_applyFT(model, data, wrench[:3], wrench[3:], data.xipos[body], body, force)
    works = {"energy": h * float(force @ end)}
    if not data.nefc and not model.nu:
        works["energy by inverse dynamics"] = h * float(data.qfrc_inverse @ end)
    for check, work in works.items():
        result.counts[check] += 1
        if work > BAR * kinetic:
            result.fail(check, f"{work:.3g} J in a step, of {kinetic:.3g} J")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Inertia matrix")
def test_sand_adds_no_energy() -> None:
    results = {number: run(draw(number)) for number in range(cases(4))}
    counts = sum((result.counts for result in results.values()), Counter())
    assert counts["energy"] > 50 * len(results)
    assert counts["energy by inverse dynamics"] > 4 * len(results)
    assert not {number: found.failures for number, found in results.items() if found.failures}
