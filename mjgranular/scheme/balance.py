"""The balance of momentum over one step, in generalized coordinates: residual and derivative.

Written for numba, over the arrays of a `desk.Room`. Matrices are dense, row by row; degrees of
freedom are eliminated from the leaves of the kinematic tree to its root, where a matrix with the
sparsity of the inertia stays as sparse as it is.
"""

from __future__ import annotations

import math
from functools import partial

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import actuator_damping, smooth_derivative
from mjgranular.kernel.memory import floats, ints, scratch
from mjgranular.kernel.motion import read_motion
from mjgranular.scheme import desk as d

_JOINT = np.int32(mujoco.mjtObj.mjOBJ_JOINT)

poly_room = scratch(d.POLY)


@compiled
def clear(numbers):
    """Sets all to zero."""
    for k in range(len(numbers)):
        numbers[k] = 0.0


@compiled
def copy(target, source):
    """Copies as many numbers as the source has."""
    for k in range(len(source)):
        target[k] = source[k]


@compiled
def prepare_inertia(desk, room, h):
    """What resists a change of velocity over a step: inertia, and what the integrator adds to it.

    Euler adds h times the derivative of joints' damping; the implicit integrators add -h times the
    derivative of all smooth forces by velocity.
    """
    nv = desk[d.NV]
    inertia = floats(room.inertia, nv * nv)
    clear(inertia)
    m = desk[d.INERTIA]
    size, start = ints(desk[d.M_SIZE], nv), ints(desk[d.M_START], nv)
    total = start[nv - 1] + size[nv - 1]
    column, values = ints(desk[d.M_COLUMN], total), floats(m, total)
    for i in range(nv):
        for k in range(start[i], start[i] + size[i]):
            j = column[k]
            inertia[i * nv + j] = values[k]
            inertia[j * nv + i] = values[k]
    kind = desk[d.INTEGRATOR]
    if kind != d.PLAIN:
        add_extra(desk, room, h)
    weight = floats(room.weight, nv)
    for j in range(nv):
        weight[j] = 1.0 / inertia[j * nv + j]


@compiled
def add_extra(desk, room, h):
    """Adds what the integrator adds to the inertia."""
    nv = desk[d.NV]
    kind = desk[d.INTEGRATOR]
    inertia = floats(room.inertia, nv * nv)
    extra = floats(room.extra, nv * nv)
    clear(extra)
    if kind == d.DAMPED:
        take_damping(desk, extra, h)
    elif kind == d.IMPLICIT_FULL:
        smooth_derivative(desk[d.MODEL], desk[d.DATA], 1)
        take_derivative(desk, extra, h)
    else:
        # implicitfast leaves out the derivative of the bias, and reads the lower half of what is
        # left; but of lone free bodies it takes all.
        smooth_derivative(desk[d.MODEL], desk[d.DATA], 0)
        take_derivative(desk, extra, h)
        mirror(extra, nv)
        if desk[d.LONE_COUNT] > 0:
            smooth_derivative(desk[d.MODEL], desk[d.DATA], 1)
            take_lone_derivative(desk, extra, h)
    for k in range(nv * nv):
        inertia[k] += extra[k]


@compiled
def take_damping(desk, extra, h):
    """Sets h times the derivative of the damping of joints, that of their actuators included.

    Damping of a joint at the speed v is (b + p_1 |v| + p_2 v^2) v.
    """
    nv = desk[d.NV]
    velocity = floats(desk[d.QVEL], nv)
    damping, more = floats(desk[d.DAMPING], nv), floats(desk[d.DAMPING_POLY], d.POLY * nv)
    joints = ints(desk[d.DOF_JOINT], nv)
    poly = poly_room()
    for j in range(nv):
        for k in range(d.POLY):
            poly[k] = more[d.POLY * j + k]
        slope = damping[j]
        if d.joint_actuator(desk, joints[j]) != -1:
            slope += actuator_damping(desk[d.MODEL], _JOINT, joints[j], poly.ctypes.data)
        power = 1.0
        for k in range(d.POLY):
            power *= abs(velocity[j])
            slope += (k + 2) * poly[k] * power
        extra[j * nv + j] = h * slope


@compiled
def take_derivative(desk, extra, h):
    """Sets -h times the derivative of the smooth forces, where it is not zero."""
    nv = desk[d.NV]
    size, start = ints(desk[d.D_SIZE], nv), ints(desk[d.D_START], nv)
    total = start[nv - 1] + size[nv - 1]
    column, values = ints(desk[d.D_COLUMN], total), floats(desk[d.DERIVATIVE], total)
    for i in range(nv):
        for k in range(start[i], start[i] + size[i]):
            extra[i * nv + column[k]] = -h * values[k]


@compiled
def mirror(matrix, n):
    """Sets the upper half to the lower one."""
    for i in range(n):
        for j in range(i):
            matrix[j * n + i] = matrix[i * n + j]


@compiled
def take_lone_derivative(desk, extra, h):
    """Sets the rows of lone free bodies, whose trees have no other degrees of freedom."""
    nv = desk[d.NV]
    size, start = ints(desk[d.D_SIZE], nv), ints(desk[d.D_START], nv)
    total = start[nv - 1] + size[nv - 1]
    column, values = ints(desk[d.D_COLUMN], total), floats(desk[d.DERIVATIVE], total)
    lone = ints(desk[d.LONE], desk[d.LONE_COUNT])
    for number in range(len(lone)):
        for i in range(lone[number], lone[number] + 6):
            for k in range(start[i], start[i] + size[i]):
                extra[i * nv + column[k]] = -h * values[k]


@compiled
def norm(residual, room, nv):
    """Size of a momentum: the square root of about twice its energy."""
    weight = floats(room.weight, nv)
    total = 0.0
    for j in range(nv):
        total += residual[j] * residual[j] * weight[j]
    return math.sqrt(total)


@compiled
def solve(matrix, right, answer, n):
    """Solves `matrix answer = right`; False if a pivot is nothing. Destroys both.

    Whole rows, though most of a tree's matrix is zero: they are vectorized, lists of what is not
    zero are not, and took twice the time from 6 to 23 degrees of freedom.
    """
    for k in range(n - 1, -1, -1):
        row = matrix[k * n : k * n + n]
        pivot = row[k]
        if not abs(pivot) > 0.0:
            return False
        scale = 1.0 / pivot
        for i in range(k):
            factor = matrix[i * n + k]
            if factor != 0.0:
                factor *= scale
                other = matrix[i * n : i * n + n]
                for j in range(k):
                    other[j] -= factor * row[j]
                right[i] -= factor * right[k]
    for k in range(n):
        row = matrix[k * n : k * n + n]
        total = right[k]
        for j in range(k):
            total -= row[j] * answer[j]
        answer[k] = total / row[k]
    return True


@compiled
def body_motions(desk, room, velocity):
    """Spatial velocities of the bodies about the centres of their trees."""
    nv, nbody = desk[d.NV], desk[d.NBODY]
    motion = floats(room.motion, 6 * nbody)
    cdof = floats(desk[d.CDOF], 6 * nv)
    parents = ints(desk[d.BODY_PARENT], nbody)
    first, number = ints(desk[d.BODY_DOF], nbody), ints(desk[d.BODY_DOFS], nbody)
    for k in range(6):
        motion[k] = 0.0
    for b in range(1, nbody):
        p = 6 * parents[b]
        w0, w1, w2 = motion[p], motion[p + 1], motion[p + 2]
        w3, w4, w5 = motion[p + 3], motion[p + 4], motion[p + 5]
        for dof in range(first[b], first[b] + number[b]):
            u, c = velocity[dof], 6 * dof
            w0 += u * cdof[c]
            w1 += u * cdof[c + 1]
            w2 += u * cdof[c + 2]
            w3 += u * cdof[c + 3]
            w4 += u * cdof[c + 4]
            w5 += u * cdof[c + 5]
        b *= 6
        motion[b], motion[b + 1], motion[b + 2] = w0, w1, w2
        motion[b + 3], motion[b + 4], motion[b + 5] = w3, w4, w5


@partial(compiled, inline=True)
def motion_of(motion, body):
    """The spatial velocity of one body, of those that `body_motions` has found."""
    return read_motion(motion, 6 * body)


@compiled
def weigh(desk, room, velocity, h):
    """Begins residual and derivative: inertia times the change of velocity, less smooth forces."""
    nv = desk[d.NV]
    start = floats(room.start, nv)
    smooth = floats(room.smooth, nv)
    residual = floats(room.residual, nv)
    change = floats(room.answer, nv)
    inertia = floats(room.inertia, nv * nv)
    matrix = floats(room.matrix, nv * nv)
    for j in range(nv):
        change[j] = velocity[j] - start[j]
    for i in range(nv):
        total = -smooth[i]
        for j in range(nv):
            m = inertia[i * nv + j]
            matrix[i * nv + j] = m
            total += m * change[j]
        residual[i] = total


@compiled
def sum_wrenches(desk, room, h):
    """The sand's wrenches as momentum.

    What acts on a body acts on all joints below it, and wrenches about the centre of one tree can
    be summed.
    """
    nv, nbody = desk[d.NV], desk[d.NBODY]
    sand = floats(room.sand, nv)
    own = floats(room.own, 6 * nbody)
    total = floats(room.total, 6 * nbody)
    wet = floats(room.wet, nbody)
    cdof = floats(desk[d.CDOF], 6 * nv)
    parents = ints(desk[d.BODY_PARENT], nbody)
    dof_body = ints(desk[d.DOF_BODY], nv)
    for k in range(6 * nbody):
        total[k] = own[k]
    for b in range(nbody - 1, 0, -1):
        p = parents[b]
        if wet[b] != 0.0 and p > 0:
            for k in range(6):
                total[6 * p + k] += total[6 * b + k]
    for j in range(nv):
        b = dof_body[j]
        sand[j] = 0.0
        if wet[b] == 0.0:
            continue
        c = cdof[6 * j : 6 * j + 6]
        w = total[6 * b : 6 * b + 6]
        sand[j] = h * (
            c[0] * w[0] + c[1] * w[1] + c[2] * w[2] + c[3] * w[3] + c[4] * w[4] + c[5] * w[5]
        )


@compiled
def add_bodies(desk, room, h):
    """The sand's wrenches as momentum, and their derivative, added to the matrix.

    The derivative as composite inertias are, body by body from the leaves to the root.
    """
    sum_wrenches(desk, room, h)
    nv, nbody = desk[d.NV], desk[d.NBODY]
    matrix = floats(room.matrix, nv * nv)
    stiffness = floats(room.stiffness, 36 * nbody)
    wet = floats(room.wet, nbody)
    cdof = floats(desk[d.CDOF], 6 * nv)
    parents = ints(desk[d.BODY_PARENT], nbody)
    dof_body, dof_parent = ints(desk[d.DOF_BODY], nv), ints(desk[d.DOF_PARENT], nv)
    for b in range(nbody - 1, 0, -1):
        p = parents[b]
        if wet[b] != 0.0 and p > 0:
            for k in range(36):
                stiffness[36 * p + k] += stiffness[36 * b + k]
    for j in range(nv):
        b = dof_body[j]
        if wet[b] == 0.0:
            continue
        s = stiffness[36 * b : 36 * b + 36]
        c = cdof[6 * j : 6 * j + 6]
        # Down (columns) and across (rows): the stiffness need not be symmetric.
        y0, y1, y2, y3, y4, y5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        z0, z1, z2, z3, z4, z5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(6):
            u = h * c[k]
            if u == 0.0:  # half of them and more: slides, and all that moves in a plane
                continue
            y0 += u * s[k]
            y1 += u * s[6 + k]
            y2 += u * s[12 + k]
            y3 += u * s[18 + k]
            y4 += u * s[24 + k]
            y5 += u * s[30 + k]
            z0 += u * s[6 * k]
            z1 += u * s[6 * k + 1]
            z2 += u * s[6 * k + 2]
            z3 += u * s[6 * k + 3]
            z4 += u * s[6 * k + 4]
            z5 += u * s[6 * k + 5]
        i = j
        while i >= 0:
            e = cdof[6 * i : 6 * i + 6]
            matrix[i * nv + j] += (
                e[0] * y0 + e[1] * y1 + e[2] * y2 + e[3] * y3 + e[4] * y4 + e[5] * y5
            )
            if i != j:
                matrix[j * nv + i] += (
                    e[0] * z0 + e[1] * z1 + e[2] * z2 + e[3] * z3 + e[4] * z4 + e[5] * z5
                )
            i = dof_parent[i]
