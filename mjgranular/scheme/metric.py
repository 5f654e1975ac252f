"""The effective metric of MuJoCo's integrator `discrete`, as the balance's matrix A.

This integrator solves for constraints and velocity at once,

    A (v' - v) / h = q + c + q_c,    A = M + h D + h^2 K,    c = -h K v,

with damping D and stiffness K of joints, tendons, actuators, fluid and flexes, none of them
negative; a is (v' - v) / h itself. Metric, shift c and the rows of the constraints, whose softness
depends on the metric, are computed after the actuators' forces, between two functions of MuJoCo's
interface. Inverse dynamics is its only other function that computes exactly these.
"""

import mujoco

from mjgranular.kernel import engine
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import scratch
from mjgranular.scheme.dense import add_scaled, clear

_AFTER_VELOCITY = int(mujoco.mjtStage.mjSTAGE_VEL)
_INTEGRATOR = int(mujoco.mjtIntegrator.mjINT_DISCRETE)
_DUAL, _IPC = int(mujoco.mjtSolver.mjSOL_PGS), int(mujoco.mjtEnableBit.mjENBL_IPC)

numbers_of_block = scratch(36)


@compiled
def is_unsupported(integrator, solver, enableflags):
    """Return True if the options change this integrator's step from the one above.

    The dual solver needs quantities that the engine computes for no other solver, and the flag
    `ipc` has its own steps.
    """
    return integrator == _INTEGRATOR and (solver == _DUAL or enableflags & _IPC != 0)


@compiled
def make_metric(w):
    """Have the engine compute the metric of this step; read the shift c.

    The engine's solvers need the metric factored, which inverse dynamics omits; it is done here.
    """
    model, data, shift = w.model, w.data, w.shift
    if w.within != 0:  # it follows passive forces in the step
        engine.metric_shift(model, data)
    engine.inverse_dynamics(model, data, _AFTER_VELOCITY, 1)
    if w.factored == 0 and w.efm_diag.ctypes.data != 0:
        factors, inverse = w.qH.ctypes.data, w.qHDiagInv.ctypes.data
        counts, rows, columns = w.M_rownnz.ctypes, w.M_rowadr.ctypes, w.M_colind.ctypes
        engine.factor_inertia(factors, inverse, w.nv, counts.data, rows.data, columns.data, 0)
    clear(shift)
    if w.efm_c.ctypes.data != 0:
        add_scaled(shift, 1.0, w.efm_c)
    if w.efm_ca.ctypes.data != 0:
        add_scaled(shift, 1.0, w.efm_ca)


@compiled
def add_metric(w):
    """Add the metric's terms to A, which is M.

    Free bodies that carry no joint and that nothing else touches have an implicit gyroscopic
    moment, without symmetry.
    """
    unit, inertia = w.trial, w.inertia
    clear(unit)
    for j in range(w.nv):
        unit[j] = 1.0
        row = inertia[j]
        engine.add_metric_product(w.model, w.data, row.ctypes.data, unit.ctypes.data, 1)
        unit[j] = 0.0
    for k in range(0, w.nlone, 6):
        if engine.turns_freely(w.model, w.data, w.dof_jntid[w.lone_dofs[k]]) != 0:
            add_free_bias(w, inertia, w.lone_dofs[k])


@compiled
def add_free_bias(w, matrix, first):
    """Add h times the derivative of a free body's bias forces; `first` is its first row."""
    block = numbers_of_block()
    engine.free_bias_derivative(w.model, w.data, w.dof_jntid[first], block.ctypes.data)
    for i in range(6):
        for j in range(6):
            matrix[first + i, first + j] += w.h * block[6 * i + j]
