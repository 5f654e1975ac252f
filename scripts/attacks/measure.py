"""What is measured of a step: work, sensitivity, what is known not to be foreseen."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from attacks.draw import arguments

from mjgranular import GranularError, Sand

JOULES = 1e-12
SOLVER_ENDS = ", not if the engine's solver goes to its end"
# What sand inside `mj_step` remembers is copied by itself.
STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION) & ~int(mujoco.mjtState.mjSTATE_PLUGIN)
_NO_PASSIVE = int(mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER)
_SLEEP = int(getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", 0))


def state_of(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """All that a simulation goes on from."""
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    return state


def sand_force(sand: Sand, data: mujoco.MjData) -> np.ndarray:
    """Generalized forces of the sand in the last step [N, N m]."""
    total = np.zeros(sand.model.nv)
    for row in sand._bindings[data].bodies:
        wrench, body = row["wrench"], int(row["body"])
        point = data.xipos[body]
        mujoco.mj_applyFT(sand.model, data, wrench[:3], wrench[3:], point, body, total)
    return total


def work_of_new_sand(model: mujoco.MjModel, given: str, before: np.ndarray) -> float:
    """Of one step from a state [J]; infinite where it cannot be made."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, before, STATE)
    try:
        sand = Sand(model, **arguments(given))
        sand.step(data)
    except (GranularError, mujoco.FatalError):
        return np.inf
    return float(model.opt.timestep * sand_force(sand, data) @ data.qvel)


def quiet(data: mujoco.MjData) -> None:
    """Forgets MuJoCo's warnings: a reset begins to count anew, and would hide one more."""
    for kind in range(len(data.warning.number)):
        data.warning[kind].number = 0


def sand_force_inside(data: mujoco.MjData) -> np.ndarray:
    """What is in `qfrc_passive` beside MuJoCo's own parts of it."""
    own = data.qfrc_spring + data.qfrc_damper + data.qfrc_gravcomp + data.qfrc_fluid
    return data.qfrc_passive - own


def without_which(model: mujoco.MjModel, given: str, before: np.ndarray) -> str:
    """Tells whether the work is gone with a new Sand, or if the engine's solver goes to its end."""
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
    """Why the balance does not foresee this step, if docs/scheme.md says that it does not."""
    opt = model.opt
    if opt.noslip_iterations > 0:
        return "noslip"
    least = min(model.body_mass.min(), model.dof_damping.min(), model.dof_armature.min())
    return "negative mass, damping or armature" if least < 0.0 else ""


def sensitivity(
    model: mujoco.MjModel, data: mujoco.MjData, before: np.ndarray, rate: float
) -> float:
    """How far apart steps end whose forces differ by rounding.

    The engine's solver CG, or one that is stopped early, goes another way then.
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


def doors_may_differ(model: mujoco.MjModel) -> bool:
    """Tells whether the doors are known to differ here (docs/plugin.md)."""
    opt = model.opt
    if opt.disableflags & _NO_PASSIVE == _NO_PASSIVE:
        return True
    return bool(opt.enableflags & _SLEEP)


def all_finite(data: mujoco.MjData) -> bool:
    """Tells whether positions, velocities and accelerations are numbers."""
    return bool(
        np.isfinite(data.qpos).all()
        and np.isfinite(data.qvel).all()
        and np.isfinite(data.qacc).all()
        and np.isfinite(data.qacc_warmstart).all()
    )
