"""MuJoCo's constraints in the balance of momentum, as the implicit scheme foresees them.

They are soft: the force of a row is a function of the acceleration along it, which is, up to
damping that the integrator takes implicitly, the change of velocity over the step. Equalities,
friction losses, limits, and contacts with pyramidal and elliptic cones, as in the engine's
documentation.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import CONTACT_DTYPE, ROWS_DTYPE, solve_inertia
from mjgranular.kernel.memory import floats, ints, longs, records
from mjgranular.scheme import desk as d
from mjgranular.scheme.balance import clear, copy, norm
from mjgranular.scheme.forces import NEXT, SAME

_EQUALITY = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
_FRICTION = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON)  # and of a joint, one below
_ELLIPTIC = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC)
_contacts = records(CONTACT_DTYPE)
rows_of = records(ROWS_DTYPE)

# Not literals, for each of which numba would compile a function anew.
_ANEW, _MORE = np.bool_(True), np.bool_(False)


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
        count = ints(data + rows.count, 1)[0]
        size = ints(longs(data + rows.row_size, 1)[0], count)[i]
        start = ints(longs(data + rows.row_start, 1)[0], count)[i]
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
def leave(desk, room, velocity, h, grips):
    """Takes sand and constraints from the residual, which `weigh` has begun.

    Returns:
        (its norm, greatest bend of a friction loss).
    """
    nv = desk[d.NV]
    residual = floats(room.residual, nv)
    sand = floats(room.sand, nv)
    bound = floats(room.bound, nv)
    bend = bound_forces(desk, room, velocity, h, grips)
    for j in range(nv):
        residual[j] -= sand[j] + bound[j]
    return norm(residual, room, nv), bend


@compiled
def bound_forces(desk, room, velocity, h, grips):
    """Momentum of the constraints at a velocity, and its derivative, added to the matrix.

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
    contacts = _contacts(longs(data + rows.contact, 1)[0], ints(data + rows.contacts, 1)[0])
    holds = floats(room.holds, 2 * desk[d.HOLD_COUNT])
    held = 0
    i = np.int64(0)  # a literal would be compiled for on its own
    while i < count:
        if kind[i] == _ELLIPTIC:
            contact = contacts[owner[i]]
            add_cone(desk, room, rows, i, contact, mass, reference, h)
            i += contact.dim
            continue
        x = row_value(desk, room, rows, i, rate) - reference[i]
        force = -mass[i] * x
        stiff = mass[i]
        if kind[i] == _EQUALITY:
            pass
        elif kind[i] <= _FRICTION:
            force, stiff, turn = hold(holds, held, x, loss[i], mass[i], grips)
            held += 2
            bend = max(bend, turn)
        elif x >= 0.0:
            force, stiff = 0.0, 0.0
        if force != 0.0 or stiff != 0.0:
            row, firm = row_at(desk, room, rows, i)
            push(desk, room, row, firm, force, stiff, h)
        i += 1
    return bend


@compiled
def hold(kept, first, x, limit, mass, grips):
    """Friction with a limit, -limit x / max(|x|, limit / mass), and minus its derivative.

    From one side of rest to the other Newton's method could leap for ever, as it could with the
    sand's: the grip q = -x / max(|x|, limit / mass) is unknown beside x (`law.multiplier`;
    for this function M. Hintermueller, G. Stadler, SIAM J. Sci. Comput. 28 (2006)).

    Args:
        kept: x and q that were last looked at, of each friction loss; will be those of now.
        first: where those of this one are.
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
        old, q = kept[first], kept[first + 1]
        growth = math.copysign(x - old, old * (x - old)) if abs(old) > edge else 0.0
        q = min(max(-(x + growth * q) / max(abs(old), edge), -1.0), 1.0)
    elif grips == SAME:
        q = kept[first + 1]
    kept[first], kept[first + 1] = x, q
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
