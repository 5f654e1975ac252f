"""Measure a step: state, work of the sand, sensitivity to rounding, known exceptions."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from attacks.cases import arguments

from mjgranular import GranularError, Sand

JOULES = 1e-12
# The memory of sand inside `mj_step` is copied separately.
STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION) & ~int(mujoco.mjtState.mjSTATE_PLUGIN)
_NO_PASSIVE = int(mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER)
_SLEEP = int(getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", 0))
_NEWTON = int(mujoco.mjtSolver.mjSOL_NEWTON)
_WARMSTART = int(mujoco.mjtDisableBit.mjDSBL_WARMSTART)


def state_of(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the complete state of a simulation."""
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    return state


def is_finite(data: mujoco.MjData) -> bool:
    """Return True if positions, velocities and accelerations are finite."""
    fields = (data.qpos, data.qvel, data.qacc, data.qacc_warmstart)
    return all(np.isfinite(each).all() for each in fields)


def clear_warnings(data: mujoco.MjData) -> None:
    """Clear MuJoCo's warnings: a reset would set the counts to 0 and hide one."""
    for kind in range(len(data.warning.number)):
        data.warning[kind].number = 0


def kinetic_energy(model: mujoco.MjModel, data: mujoco.MjData, speed: np.ndarray) -> float:
    """Return the kinetic energy at a velocity, at least 0 [J]."""
    product = np.zeros(model.nv)
    mujoco.mj_mulM(model, data, product, np.ascontiguousarray(speed))
    return max(0.0, 0.5 * float(speed @ product))


def sand_force(sand: Sand, data: mujoco.MjData) -> np.ndarray:
    """Return the generalized forces of the sand in the last step [N, N m]."""
    total = np.zeros(sand.model.nv)
    for row in sand._bindings[data].bodies:
        wrench, body = row["wrench"], int(row["body"])
        point = data.xipos[body]
        mujoco.mj_applyFT(sand.model, data, wrench[:3], wrench[3:], point, body, total)
    return total


def sand_force_inside(data: mujoco.MjData) -> np.ndarray:
    """Return what `qfrc_passive` holds besides MuJoCo's own parts."""
    return data.qfrc_passive - (
        data.qfrc_spring + data.qfrc_damper + data.qfrc_gravcomp + data.qfrc_fluid
    )


def counters(sand: Sand, data: mujoco.MjData) -> tuple[int, ...]:
    """Return the scheme's counts of unfinished and damped steps."""
    binding = sand._bindings.get(data)
    if binding is None or binding.workspace.statistics is None:
        return ()
    account = binding.workspace.statistics[0]
    skipped = ("steps", "evaluations", "most")
    integers = [name for name in account.dtype.names if account.dtype[name] == np.int64]
    return tuple(int(account[name]) for name in integers if name not in skipped)


def vanishes_if_solved(model: mujoco.MjModel, sand: str, before: np.ndarray) -> bool:
    """Return True if the sand does no work once MuJoCo's solver runs to its end."""
    if model.opt.integrator not in (0, 2, 3):
        return False
    model = copy.copy(model)
    opt = model.opt
    opt.solver, opt.iterations, opt.ls_iterations = _NEWTON, 500, 100
    opt.tolerance = opt.ls_tolerance = 0.0
    opt.disableflags &= ~_WARMSTART
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, before, STATE)
    try:
        made = Sand(model, **arguments(sand))
        made.step(data)
    except (GranularError, mujoco.FatalError):
        return False
    return float(opt.timestep * sand_force(made, data) @ data.qvel) <= JOULES


def is_excluded(model: mujoco.MjModel) -> bool:
    """Return True if docs/scheme.md excludes this model from the energy balance."""
    least = min(model.body_mass.min(), model.dof_damping.min(), model.dof_armature.min())
    return model.opt.noslip_iterations > 0 or least < 0.0


def sensitivity(
    model: mujoco.MjModel, data: mujoco.MjData, before: np.ndarray, rate: float
) -> float:
    """Return the distance between ends of steps whose forces differ by rounding.

    MuJoCo's CG solver, or one that stops early, then takes another path.
    """
    ends = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        mujoco.mj_setState(model, data, before, STATE)
        off = 1e-15 * rate * rng.normal(size=model.nv) * model.dof_M0
        data.qfrc_applied += off if seed else 0.0
        mujoco.mj_step(model, data)
        ends.append(data.qvel.copy())
    return max(float(np.abs(end - ends[0]).max()) for end in ends)


def interfaces_may_differ(model: mujoco.MjModel) -> bool:
    """Return True if the interfaces are known to differ here (docs/plugin.md)."""
    opt = model.opt
    return opt.disableflags & _NO_PASSIVE == _NO_PASSIVE or bool(opt.enableflags & _SLEEP)
