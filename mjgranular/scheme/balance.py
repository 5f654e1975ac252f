"""The balance of momentum over one step, in generalized coordinates: residual and its Jacobian.

    R(v')  = A (v' - v) - h (q + q_c(v') + J^T f(v'))
    R'(v') = A + h sum_b J_b^T K_b J_b + (sum_i D_i J_i^T J_i) K

A = M + C is the inertia plus the integrator's implicit terms, q are MuJoCo's smooth forces, q_c its
constraint forces (for D_i, J_i, K see `scheme.constraints`), f the sand's forces on its elements.
For each body b the sand gives a wrench and minus its derivative by the body's spatial velocity, the
6 x 6 matrix K_b; J_b has the columns of `cdof` of the joints that move it. Both are summed toward
the root like inertias.
"""

import math
from functools import partial

import mujoco
import numpy as np

from mjgranular.kernel import engine
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.intrinsics import call_forces
from mjgranular.kernel.memory import BESIDE, LAW, WORKSPACE, scratch, table_at
from mjgranular.kernel.motion import Motion, read_motion, write_motion
from mjgranular.kernel.vector import cross, dot, norm, read_vector, transposed, vector
from mjgranular.scheme.constraints import add_constraints
from mjgranular.scheme.dense import add_scaled, clear, copy, inner
from mjgranular.scheme.forces import FOLLOW, FRESH, LAST, NEXT, RESPOND
from mjgranular.scheme.workspace import DISCRETE, EULER, IMPLICIT, POLY

_JOINT = np.int32(mujoco.mjtObj.mjOBJ_JOINT)

poly_numbers = scratch(POLY)


@compiled
def prepare_inertia(w):
    """Set A = M + C.

    With Euler C is h times the derivative of joint damping; with the implicit integrators -h times
    the derivative of all smooth forces by velocity; with `discrete` everything that turns M into
    the effective metric.
    """
    nv, inertia = w.nv, w.inertia
    for i in range(nv):
        clear(inertia[i])
        clear(w.damping[i])
    for i in range(nv):
        for k in range(w.M_rowadr[i], w.M_rowadr[i] + w.M_rownnz[i]):
            j = w.M_colind[k]
            inertia[i, j] = inertia[j, i] = w.M[k]
    if w.integrator == EULER:
        if w.damped != 0:
            read_joint_damping(w)
    elif w.integrator == IMPLICIT:
        engine.smooth_derivative(w.model, w.data, 1)
        read_derivative(w, w.dofs)
    elif w.integrator == DISCRETE:
        add_metric(w)
    else:
        # implicitfast omits the derivative of the bias and reads the lower half of the rest; for
        # lone free bodies it uses all of both.
        engine.smooth_derivative(w.model, w.data, 0)
        read_derivative(w, w.dofs)
        for i in range(nv):
            for j in range(i):
                w.damping[j, i] = w.damping[i, j]
        read_derivative(w, w.lone_dofs)
        for k in range(0, w.nlone, 6):
            add_free_bias(w, w.damping, w.lone_dofs[k])
    for i in range(nv):
        add_scaled(inertia[i], 1.0, w.damping[i])
        w.weight[i] = 1.0 / inertia[i, i]


@compiled
def read_joint_damping(w):
    """Set C to h times the derivative of the damping of joints and their actuators.

    Damping of a joint at the speed v is (b + p_1 |v| + p_2 v^2) v.
    """
    poly = poly_numbers()
    for j in range(w.nv):
        copy(poly, w.dof_dampingpoly[j])
        slope = w.dof_damping[j]
        joint = w.dof_jntid[j]
        if w.jnt_actuatorid[joint] != -1:
            slope += engine.actuator_damping(w.model, _JOINT, joint, poly.ctypes.data)
        power = 1.0
        for k in range(POLY):
            power *= abs(w.qvel[j])
            slope += (k + 2) * poly[k] * power
        w.damping[j, j] = w.h * slope


@compiled
def read_derivative(w, dofs):
    """Set rows of C to -h times the derivative of the smooth forces that MuJoCo computed."""
    for i in dofs:
        for k in range(w.D_rowadr[i], w.D_rowadr[i] + w.D_rownnz[i]):
            w.damping[i, w.D_colind[k]] = -w.h * w.qDeriv[k]


@compiled
def find_motions(w, velocity):
    """Set the spatial velocities of the bodies about the centers of their trees."""
    motion, cdof = w.motion, w.cdof
    clear(motion[0])
    for b in range(1, w.nbody):
        copy(motion[b], motion[w.body_parentid[b]])
        first = w.body_dofadr[b]
        for j in range(first, first + w.body_dofnum[b]):
            add_scaled(motion[b], velocity[j], cdof[j])


@compiled
def find_last_motions(w):
    """Set the spatial velocities that the bodies had at the start of the last step.

    Joint velocities v are those of now, which moved the last step; the columns c_j of `cdof` were
    others. To third order in h

        V(-h) = sum_j v_j (c_j - h c_j' + h^2 c_j'' / 2),   c' = V x c,   c'' = V' x c + V x c',

    where V and V' = sum_j v_j c_j' are those of the body that the joint moves in.
    """
    # The last two are scratch: every evaluation of forces sets them.
    motions, velocities, rates = w.motion, w.wrench, w.carried
    clear(motions[0])
    clear(velocities[0])
    clear(rates[0])
    for b in range(1, w.nbody):
        parent, first = w.body_parentid[b], w.body_dofadr[b]
        motion, velocity = read_motion(motions[parent], 0), read_motion(velocities[parent], 0)
        rate = read_motion(rates[parent], 0)
        base, base_rate, turned = velocity, rate, -1
        for j in range(first, first + w.body_dofnum[b]):
            axis, by_time, v = read_motion(w.cdof[j], 0), read_motion(w.cdof_dot[j], 0), w.qvel[j]
            if w.dof_jntid[j] != turned:  # axes of one ball turn together
                base, base_rate = velocity, rate
            turned = w.dof_jntid[j] if norm(axis.angular) > 0.0 else -1
            bend = sum_of(crossed(base_rate, axis), crossed(base, by_time), 1.0)
            velocity, rate = sum_of(velocity, axis, v), sum_of(rate, by_time, v)
            motion = sum_of(motion, axis, v)
            motion = sum_of(motion, by_time, -w.h * v)
            motion = sum_of(motion, bend, 0.5 * w.h * w.h * v)
        write_motion(motions[b], 0, motion)
        write_motion(velocities[b], 0, velocity)
        write_motion(rates[b], 0, rate)


@partial(compiled, inline=True)
def sum_of(a, b, factor):
    """Return a + factor b, of spatial velocities."""
    return Motion(a.angular + factor * b.angular, a.linear + factor * b.linear)


@partial(compiled, inline=True)
def crossed(v, axis):
    """Return v x axis, the rate of change of an axis that moves with the spatial velocity v."""
    linear = cross(v.angular, axis.linear) + cross(v.linear, axis.angular)
    return Motion(cross(v.angular, axis.angular), linear)


@compiled
def size_of(w, momentum):
    """Return the size of a momentum: the square root of about twice its energy."""
    total = 0.0
    for j in range(w.nv):
        total += momentum[j] * momentum[j] * w.weight[j]
    return math.sqrt(total)


@compiled
def balance(w, update):
    """Set the residual at the velocity `w.velocity`, and its Jacobian without the sand's part.

    Return the size of the residual, and the greatest mismatch of a friction loss. `update` is
    `FRESH`, `NEXT` or `SAME`.
    """
    change, residual, inertia = w.trial, w.residual, w.inertia
    for j in range(w.nv):
        change[j] = w.velocity[j] - w.start[j]
    for i in range(w.nv):
        copy(w.jacobian[i], inertia[i])
        residual[i] = inner(inertia[i], change)
    mismatch = add_constraints(w, update)
    for j in range(w.nv):
        residual[j] -= w.smooth[j] + w.constraint[j] + w.sand[j]
    return size_of(w, residual), mismatch


@compiled
def sum_wrenches(w):
    """Set h J^T f: a wrench on a body acts on all joints that move it.

    Wrenches about the center of one tree can be summed.
    """
    carried, immersed = w.carried, w.immersed
    for b in range(w.nbody):
        copy(carried[b], w.wrench[b])
    for b in range(w.nbody - 1, 0, -1):
        if immersed[b] != 0:
            add_scaled(carried[w.body_parentid[b]], 1.0, carried[b])
    for j in range(w.nv):
        b = w.dof_bodyid[j]
        w.sand[j] = w.h * inner(w.cdof[j], carried[b]) if immersed[b] != 0 else 0.0


@compiled
def add_stiffness(w):
    """Add h sum_b J_b^T K_b J_b to the Jacobian, with the recursion for composite inertias."""
    stiffness, immersed, jacobian, cdof = w.stiffness, w.immersed, w.jacobian, w.cdof
    for b in range(w.nbody - 1, 0, -1):
        if immersed[b] != 0:
            add_scaled(stiffness[w.body_parentid[b]], 1.0, stiffness[b])
    for j in range(w.nv):
        body = w.dof_bodyid[j]
        if immersed[body] == 0:
            continue
        k = stiffness[body]
        a, b, c, d = block_of(k, 0), block_of(k, 3), block_of(k, 18), block_of(k, 21)
        turning, moving = w.h * read_vector(cdof[j], 0), w.h * read_vector(cdof[j], 3)
        # h K_b cdof_j and h K_b^T cdof_j: K_b may be asymmetric.
        moment, force = a @ turning + b @ moving, c @ turning + d @ moving
        across_moment = transposed(a) @ turning + transposed(c) @ moving
        across_force = transposed(b) @ turning + transposed(d) @ moving
        i = j
        while i >= 0:
            turning, moving = read_vector(cdof[i], 0), read_vector(cdof[i], 3)
            jacobian[i, j] += dot(turning, moment) + dot(moving, force)
            if i != j:
                jacobian[j, i] += dot(turning, across_moment) + dot(moving, across_force)
            i = w.dof_parentid[i]


@partial(compiled, inline=True)
def block_of(k, first):
    """Return a 3 x 3 block of a 6 x 6 matrix, from its element `first` on."""
    return vector(read_vector(k, first), read_vector(k, first + 6), read_vector(k, first + 12))


# The effective metric of MuJoCo's integrator `discrete`, as A. It solves for constraints and
# velocity at once,
#
#     A (v' - v) / h = q + c + q_c,    A = M + h D + h^2 K,    c = -h K v,
#
# with damping D and stiffness K of joints, tendons, actuators, fluid and flexes, none of them
# negative; a is (v' - v) / h itself. Metric, shift c and the rows of the constraints, whose
# softness depends on the metric, are computed after the actuators' forces, between two functions of
# MuJoCo's interface. Inverse dynamics is its only other function that computes exactly these.

_AFTER_VELOCITY = int(mujoco.mjtStage.mjSTAGE_VEL)
_DUAL, _IPC = int(mujoco.mjtSolver.mjSOL_PGS), int(mujoco.mjtEnableBit.mjENBL_IPC)

numbers_of_block = scratch(36)


@compiled
def is_unsupported(integrator, solver, enableflags):
    """Return True if the options change this integrator's step from the one above.

    The dual solver needs quantities that the engine computes for no other solver, and the flag
    `ipc` has its own steps.
    """
    return integrator == DISCRETE and (solver == _DUAL or enableflags & _IPC != 0)


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


# Residual and Jacobian with the sand's forces at a velocity. Three programs are each compiled once:
# one for each law and kind of surface finds the elements in the sand (`sampling`), one for each law
# has their forces (`forces`), and all the rest of the scheme calls these by address.


@compiled
def call_laws(table, w, task, eps, update, loose):
    """Set the wrenches of all sands that act together by a task of their laws, and the derivatives.

    `FOLLOW` keeps the derivatives. Return the greatest result.
    """
    for b in range(w.nbody):
        clear(w.wrench[b])
        if task != FOLLOW:
            clear(w.stiffness[b])
    most, address = 0.0, table.ctypes.data
    while address != 0:
        sand = table_at(address)
        result = call_forces(sand[LAW], address, table[WORKSPACE], task, eps, update, loose)
        most = max(most, result)
        address = sand[BESIDE]
    return most


@compiled
def evaluate(table, w, task, eps, update, loose):
    """Set residual and Jacobian at `w.velocity`, and the forces on elements in their tiles.

    The task is `RESPOND`, or `DAMP` for secants of forces in the Jacobian instead of derivatives;
    `eps` is the softness [m/s]. `update` is the origin of multipliers: `NEXT`, those after a Newton
    step to this velocity; `FRESH` and `SAME` as for a `Search`, whose `loose` is given too. Return
    the size of the residual, and the greatest mismatch.
    """
    find_motions(w, w.velocity)
    mismatch = call_laws(table, w, task, eps, update, loose)
    sum_wrenches(w)
    error, of_losses = balance(w, update)
    add_stiffness(w)
    return error, max(mismatch, of_losses)


@partial(compiled, merge=True)
def evaluate_last(table, w, eps):
    """Set residual and Jacobian at `w.velocity`, with forces linearized at the motions in `w`.

    With `find_last_motions` these are the last step's, and the multipliers too. Return the size of
    the residual, the greatest mismatch and the greatest turn (`law.kernel`).
    """
    mismatch = call_laws(table, w, RESPOND, eps, FRESH, eps)
    find_motions(w, w.velocity)
    turn = call_laws(table, w, FOLLOW, eps, LAST, 0.0)
    sum_wrenches(w)
    error, of_losses = balance(w, FRESH)
    add_stiffness(w)
    return error, max(mismatch, of_losses), turn


@compiled
def follow_all(table, w, eps):
    """Set the residual at `w.velocity` with forces extrapolated by the Jacobian.

    These replace the forces that `evaluate` computed at the velocity before. Return the size of the
    residual, and the greatest turn (`law.kernel`).
    """
    find_motions(w, w.velocity)
    turn = call_laws(table, w, FOLLOW, eps, NEXT, 0.0)
    sum_wrenches(w)
    return balance(w, NEXT)[0], turn
