"""Measure a step: work of the sand, sensitivity to rounding, documented exceptions."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from attacks.draw import arguments

from mjgranular import GranularError, Sand

JOULES = 1e-12
SOLVER_ENDS = ", not if the engine's solver goes to its end"
# The memory of sand inside `mj_step` is copied separately.
STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION) & ~int(mujoco.mjtState.mjSTATE_PLUGIN)
_NO_PASSIVE = int(mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER)
_SLEEP = int(getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", 0))


def state_of(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the complete state of a simulation."""
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    return state


def sand_force(sand: Sand, data: mujoco.MjData) -> np.ndarray:
    """Return the generalized forces of the sand in the last step [N, N m]."""
    total = np.zeros(sand.model.nv)
    for row in sand._bindings[data].bodies:
        wrench, body = row["wrench"], int(row["body"])
        point = data.xipos[body]
        mujoco.mj_applyFT(sand.model, data, wrench[:3], wrench[3:], point, body, total)
    return total


def work_of_new_sand(model: mujoco.MjModel, given: str, before: np.ndarray) -> float:
    """Return the work of one step from a state [J]; infinite where it fails."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, before, STATE)
    try:
        sand = Sand(model, **arguments(given))
        sand.step(data)
    except (GranularError, mujoco.FatalError):
        return np.inf
    return float(model.opt.timestep * sand_force(sand, data) @ data.qvel)


def clear_warnings(data: mujoco.MjData) -> None:
    """Clear MuJoCo's warnings: a reset would set the counts to 0 and hide one."""
    for kind in range(len(data.warning.number)):
        data.warning[kind].number = 0


def sand_force_inside(data: mujoco.MjData) -> np.ndarray:
    """Return what `qfrc_passive` holds besides MuJoCo's own parts."""
    own = data.qfrc_spring + data.qfrc_damper + data.qfrc_gravcomp + data.qfrc_fluid
    return data.qfrc_passive - own


def without_which(model: mujoco.MjModel, given: str, before: np.ndarray) -> str:
    """Return what removes the work: a new Sand, or a solver that converges."""
    if model.opt.integrator not in (0, 2, 3):
        return ""
    model = copy.copy(model)
    if work_of_new_sand(model, given, before) <= JOULES:
        return ", not of a new Sand"
    opt = model.opt
    opt.solver, opt.iterations, opt.ls_iterations = 2, 500, 100
    opt.tolerance = opt.ls_tolerance = 0.0
    opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_WARMSTART)
    if work_of_new_sand(model, given, before) <= JOULES:
        return SOLVER_ENDS
    return ""


def documented(model: mujoco.MjModel) -> str:
    """Return why docs/scheme.md excludes this step from the balance; empty if it does not."""
    opt = model.opt
    if opt.noslip_iterations > 0:
        return "noslip"
    least = min(model.body_mass.min(), model.dof_damping.min(), model.dof_armature.min())
    return "negative mass, damping or armature" if least < 0.0 else ""


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


def all_finite(data: mujoco.MjData) -> bool:
    """Return True if positions, velocities and accelerations are finite."""
    fields = (data.qpos, data.qvel, data.qacc, data.qacc_warmstart)
    return all(np.isfinite(each).all() for each in fields)
