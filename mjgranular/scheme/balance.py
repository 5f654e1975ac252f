"""The balance of momentum over one step, in generalized coordinates: residual and derivative.

Written for numba, over the arrays of a `desk.Room`. Matrices are dense, row by row; degrees of
freedom are eliminated from the leaves of the kinematic tree to its root, where a matrix with the
sparsity of the inertia stays as sparse as it is.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import CONTACT_DTYPE, ROWS_DTYPE, smooth_derivative, solve_inertia
from mjgranular.kernel.memory import floats, ints, longs, records
from mjgranular.scheme import desk as d
from mjgranular.scheme.blocks import NEXT, SAME

_EQUALITY = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
_FRICTION = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON)  # and of a joint, one below
_ELLIPTIC = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC)
_contacts = records(CONTACT_DTYPE)
rows_of = records(ROWS_DTYPE)


# Not literals, for each of which numba would compile a function anew.
_ALL, _LOWER = np.bool_(True), np.bool_(False)
_ANEW, _MORE = np.bool_(True), np.bool_(False)


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

    Euler adds the damping of joints, h B; the implicit integrators add -h times the derivative of
    all smooth forces by velocity.
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
        damping = floats(desk[d.DAMPING], nv)
        for i in range(nv):
            extra[i * nv + i] = h * damping[i]
    else:
        full = kind == d.IMPLICIT_FULL
        if full or desk[d.LONE_COUNT] > 0:
            smooth_derivative(desk[d.MODEL], desk[d.DATA], 1)
            take_derivative(desk, extra, h, _ALL)
        if not full:
            # implicitfast leaves out the bias, but for lone free bodies.
            if desk[d.LONE_COUNT] > 0:
                keep_lone(desk, extra)
            smooth_derivative(desk[d.MODEL], desk[d.DATA], 0)
            take_derivative(desk, extra, h, _LOWER)
    for k in range(nv * nv):
        inertia[k] += extra[k]


@compiled
def take_derivative(desk, extra, h, whole):
    """Sets -h times the derivative of the smooth forces, where `extra` holds nothing yet."""
    nv = desk[d.NV]
    size, start = ints(desk[d.D_SIZE], nv), ints(desk[d.D_START], nv)
    total = start[nv - 1] + size[nv - 1]
    column, values = ints(desk[d.D_COLUMN], total), floats(desk[d.DERIVATIVE], total)
    for i in range(nv):
        for k in range(start[i], start[i] + size[i]):
            j = column[k]
            if whole:
                extra[i * nv + j] = -h * values[k]
            elif j <= i and extra[i * nv + j] == 0.0:  # implicitfast reads the lower half
                extra[i * nv + j] = -h * values[k]
                extra[j * nv + i] = -h * values[k]


@compiled
def keep_lone(desk, extra):
    """Clears all but the blocks of lone free bodies."""
    nv = desk[d.NV]
    lone = ints(desk[d.LONE], desk[d.LONE_COUNT])
    for i in range(nv):
        for j in range(nv):
            within = False
            for k in range(len(lone)):
                within = within or (lone[k] <= i < lone[k] + 6 and lone[k] <= j < lone[k] + 6)
            if not within:
                extra[i * nv + j] = 0.0


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


@compiled
def prepare_rows(desk, room):
    """Reads the constraints' rows, and what they make of a change of velocity over the step.

    The integrator's own damping C comes after MuJoCo's constraints, M a = (M + C) (v' - v) / h, so
    that the acceleration along a row is row (1 + M^-1 C) (v' - v) / h.
    """
    nv = desk[d.NV]
    rows = rows_of(desk[d.ROWS], 1)[0]
    count = min(ints(desk[d.DATA] + rows.count, 1)[0], d.ROWS_KEPT)
    for i in range(count):
        read_row(desk, rows, i, room.rows + 8 * i * nv)
        firm_up(desk, room, room.rows + 8 * i * nv, room.firms + 8 * i * nv)


@compiled
def read_row(desk, rows, i, address):
    """Writes the row of a constraint to an address."""
    nv = desk[d.NV]
    row = floats(address, nv)
    data = desk[d.DATA]
    jacobian = longs(data + rows.jacobian, 1)[0]
    if desk[d.SPARSE]:
        clear(row)
        size = ints(longs(data + rows.row_size, 1)[0], i + 1)[i]
        start = ints(longs(data + rows.row_start, 1)[0], i + 1)[i]
        column = ints(longs(data + rows.column, 1)[0] + 4 * start, size)
        values = floats(jacobian + 8 * start, size)
        for k in range(size):
            row[column[k]] = values[k]
    else:
        copy(row, floats(jacobian + 8 * i * nv, nv))


@compiled
def firm_up(desk, room, address, firm_address):
    """Writes row (1 + M^-1 C) to an address."""
    nv = desk[d.NV]
    row, firm = floats(address, nv), floats(firm_address, nv)
    copy(firm, row)
    if desk[d.INTEGRATOR] == d.PLAIN:
        return
    product = floats(room.product, nv)
    extra = floats(room.extra, nv * nv)
    solve_inertia(desk[d.MODEL], desk[d.DATA], product.ctypes.data, address, 1)
    for i in range(nv):
        u = product[i]
        if u != 0.0:
            for j in range(nv):
                firm[j] += u * extra[i * nv + j]


@compiled
def row_at(desk, room, rows, i):
    """Addresses of the row of a constraint, and of what it makes of a change of velocity."""
    if i < d.ROWS_KEPT:
        nv = desk[d.NV]
        return room.rows + 8 * i * nv, room.firms + 8 * i * nv
    read_row(desk, rows, i, room.acceleration)
    firm_up(desk, room, room.acceleration, room.answer)
    return room.acceleration, room.answer


@compiled
def row_value(desk, room, rows, i, rate):
    """The acceleration along a constraint's row, of changes of velocity over the step."""
    nv = desk[d.NV]
    firm = floats(row_at(desk, room, rows, i)[1], nv)
    total = 0.0
    for k in range(nv):
        total += firm[k] * rate[k]
    return total


@compiled
def bound_forces(desk, room, velocity, h, grips):
    """Momentum of MuJoCo's constraints at a velocity, and its derivative, added to the matrix.

    MuJoCo's constraints are soft: a row's force is a function of the acceleration along it, which
    is, up to damping that the integrator takes implicitly, the change of velocity over the step.
    Equalities, friction losses, limits, and contacts with pyramidal and elliptic cones, as in the
    engine's documentation.

    Returns:
        The greatest bend of a friction loss (`hold`).
    """
    nv = desk[d.NV]
    bound = floats(room.bound, nv)
    start = floats(room.start, nv)
    rate = floats(room.rate, nv)
    data = desk[d.DATA]
    rows = rows_of(desk[d.ROWS], 1)[0]
    count = ints(data + rows.count, 1)[0]
    for j in range(nv):
        bound[j] = 0.0
    bend = 0.0
    if count == 0:
        return bend
    for j in range(nv):
        rate[j] = (velocity[j] - start[j]) / h
    kind = ints(longs(data + rows.kind, 1)[0], count)
    loss = floats(longs(data + rows.loss, 1)[0], count)
    mass = floats(longs(data + rows.mass, 1)[0], count)
    reference = floats(longs(data + rows.reference, 1)[0], count)
    owner = ints(longs(data + rows.owner, 1)[0], count)
    address = room.holds
    i = np.int64(0)  # a literal would be compiled for on its own
    while i < count:
        if kind[i] == _ELLIPTIC:
            contact = _contacts(longs(data + rows.contact, 1)[0], owner[i] + 1)[owner[i]]
            add_cone(desk, room, rows, i, contact, mass, reference, h)
            i += contact.dim
            continue
        x = row_value(desk, room, rows, i, rate) - reference[i]
        force = -mass[i] * x
        stiff = mass[i]
        if kind[i] == _EQUALITY:
            pass
        elif kind[i] <= _FRICTION:
            force, stiff, turn = hold(floats(address, 2), x, loss[i], mass[i], grips)
            address += 16
            bend = max(bend, turn)
        elif x >= 0.0:
            force, stiff = 0.0, 0.0
        if force != 0.0 or stiff != 0.0:
            row, firm = row_at(desk, room, rows, i)
            push(desk, room, row, firm, force, stiff, h)
        i += 1
    return bend


@compiled
def hold(kept, x, limit, mass, grips):
    """Friction with a limit, -limit x / max(|x|, limit / mass), and minus its derivative.

    From one side of rest to the other Newton's method could leap for ever, as it could with the
    sand's: the grip q = -x / max(|x|, limit / mass) is unknown beside x (`law.kernel.next_grip`;
    for this function M. Hintermueller, G. Stadler, SIAM J. Sci. Comput. 28 (2006)).

    Args:
        kept: x and q that were last looked at; will be those of now.
        x: acceleration along the row, less its reference.
        limit: of the force.
        mass: that of the row while it holds.
        grips: `FRESH`, `NEXT`, `SAME`.

    Returns:
        (force, stiffness, square of the difference of q and the one of x itself).
    """
    edge = limit / mass
    size = max(abs(x), edge)
    own = -x / size
    q = own
    if grips == NEXT:
        old, q = kept[0], kept[1]
        growth = math.copysign(x - old, old * (x - old)) if abs(old) > edge else 0.0
        q = min(max(-(x + growth * q) / max(abs(old), edge), -1.0), 1.0)
    elif grips == SAME:
        q = kept[1]
    kept[0], kept[1] = x, q
    along = math.copysign(q, q * x) if abs(x) > edge else 0.0
    return limit * own, limit * (1.0 + along) / size, (q - own) ** 2


@compiled
def mix_row(desk, room, rows, i, factor, fresh):
    """Adds a multiple of a constraint's row to `row` and `firm`, or begins them."""
    nv = desk[d.NV]
    row, firm = floats(room.row, nv), floats(room.firm, nv)
    if fresh:
        clear(row)
        clear(firm)
    address, firm_address = row_at(desk, room, rows, i)
    source, firm_source = floats(address, nv), floats(firm_address, nv)
    for k in range(nv):
        row[k] += factor * source[k]
        firm[k] += factor * firm_source[k]


@compiled
def push(desk, room, address, firm_address, force, stiff, h):
    """Adds a force along a row to the constraints' momentum, and its stiffness to the matrix."""
    nv = desk[d.NV]
    bound = floats(room.bound, nv)
    row, firm = floats(address, nv), floats(firm_address, nv)
    matrix = floats(room.matrix, nv * nv)
    for j in range(nv):
        bound[j] += h * force * row[j]
    if stiff == 0.0:
        return
    for i in range(nv):
        u = stiff * row[i]
        if u != 0.0:
            for j in range(nv):
                matrix[i * nv + j] += u * firm[j]


@compiled
def add_cone(desk, room, rows, i, contact, mass, reference, h):
    """A contact with an elliptic cone, rows i to i + dim.

    In coordinates scaled by friction, U = (mu x_0, friction_k x_k), N the first of them and T the
    size of the others: above the cone (N >= mu T) nothing; below its polar (mu N + T <= 0) all
    rows are springs; between, one spring D_m along the distance N - mu T from the cone.
    """
    nv = desk[d.NV]
    rate = floats(room.rate, nv)
    dim = contact.dim
    mu = contact.mu
    x0 = row_value(desk, room, rows, i, rate) - reference[i]
    n = x0 * mu
    t = 0.0
    for k in range(1, dim):
        x = row_value(desk, room, rows, i + k, rate) - reference[i + k]
        t += (x * contact.friction[k - 1]) ** 2
    t = math.sqrt(t)
    if n >= mu * t or (t <= 0.0 and n >= 0.0):
        return
    if mu * n + t <= 0.0 or (t <= 0.0 and n < 0.0):
        for k in range(dim):
            x = row_value(desk, room, rows, i + k, rate) - reference[i + k]
            row, firm = row_at(desk, room, rows, i + k)
            push(desk, room, row, firm, -mass[i + k] * x, mass[i + k], h)
        return
    stiff = mass[i] / (mu * mu * (1.0 + mu * mu))
    away = n - mu * t
    # Along the gradient of the distance: mu for the normal row, -mu U_k / T friction_k for others.
    mix_row(desk, room, rows, i, mu, _ANEW)
    for k in range(1, dim):
        x = row_value(desk, room, rows, i + k, rate) - reference[i + k]
        friction = contact.friction[k - 1]
        mix_row(desk, room, rows, i + k, -mu * (x * friction / t) * friction, _MORE)
    push(desk, room, room.row, room.firm, -stiff * away, stiff, h)
    # The gradient turns with U: curvature of T, taken with no regard to its direction.
    bend = -stiff * away * mu / t
    for k in range(1, dim):
        friction = contact.friction[k - 1]
        mix_row(desk, room, rows, i + k, friction, _ANEW)
        push(desk, room, room.row, room.firm, 0.0, bend, h)
    for k in range(1, dim):
        x = row_value(desk, room, rows, i + k, rate) - reference[i + k]
        friction = contact.friction[k - 1]
        mix_row(desk, room, rows, i + k, (x * friction / t) * friction, k == 1)
    push(desk, room, room.row, room.firm, 0.0, -bend, h)
