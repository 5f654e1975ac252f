"""MuJoCo's constraints in the balance of momentum, as the implicit scheme predicts them.

They are soft: the force of a row J_i is a function of the acceleration along it, within bounds.
docs/scheme.md has their part q_c and its Jacobian. Equalities, friction losses, limits, and
contacts with pyramidal and elliptic cones follow the engine's documentation.
"""

import math

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import solve_inertia
from mjgranular.kernel.memory import scratch
from mjgranular.scheme.dense import add_outer, add_scaled, clear, copy, inner
from mjgranular.scheme.forces import NEXT, SAME

_EQUALITY = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
_FRICTION = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON)  # and of a joint, one below
_ELLIPTIC = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC)
numbers_of_contact = scratch(6)


@compiled
def prepare_constraints(w):
    """Find the rows of K that constraints touch."""
    touched, undamped, damping = w.touched, w.undamped, w.damping
    unit, product = w.trial, w.product
    for j in range(w.nv):
        touched[j] = 0
    for i in range(w.nefc):
        row = row_at(w, i)
        for j in range(len(row)):
            touched[j] |= row[j] != 0.0
    clear(unit)
    for j in range(w.nv):
        if touched[j] == 0:
            continue
        unit[j] = 1.0
        copy(undamped[j], unit)
        if w.damped != 0:
            solve_inertia(w.model, w.data, product.ctypes.data, unit.ctypes.data, 1)
            for k in range(len(unit)):
                if product[k] != 0.0:
                    add_scaled(undamped[j], product[k], damping[k])
        unit[j] = 0.0


@compiled
def row_at(w, i):
    """Return J_i. Sparse rows are written to `w.row`, which is valid until the next call."""
    if not w.sparse:
        return w.efc_J[i * w.nv : (i + 1) * w.nv]
    row, start = w.row, w.efc_J_rowadr[i]
    clear(row)
    for k in range(start, start + w.efc_J_rownnz[i]):
        row[w.efc_J_colind[k]] = w.efc_J[k]
    return row


@compiled
def add_constraints(w, update):
    """Set h q_c at the velocity `w.velocity`, and add its derivative to the Jacobian.

    Return the greatest mismatch of a friction loss. `update` is `FRESH`, `NEXT` or `SAME`.
    """
    clear(w.constraint)
    mismatch = 0.0
    if w.nefc == 0:
        return mismatch
    for j in range(w.nv):
        clear(w.springs[j])
        w.rate[j] = (w.velocity[j] - w.start[j]) / w.h
    rate, undamped = w.rate, w.undamped
    for j in range(w.nv):
        w.acceleration[j] = inner(undamped[j], rate) if w.touched[j] != 0 else 0.0
    losses = 0
    i = np.int64(0)  # numba would compile a separate function for a literal
    while i < w.nefc:
        kind = w.efc_type[i]
        if kind == _ELLIPTIC:
            contact = w.contact[w.efc_id[i]]
            add_cone(w, i, contact)
            i += contact.dim
            continue
        x, mass = inner(row_at(w, i), w.acceleration) - w.efc_aref[i], w.efc_D[i]
        force, spring = -mass * x, mass
        if kind != _EQUALITY and kind <= _FRICTION:
            last, limit = w.friction[losses], w.efc_frictionloss[i]
            force, spring, own = friction_loss(last, x, limit, mass, update)
            mismatch = max(mismatch, own)
            losses += 1
        elif kind != _EQUALITY and x >= 0.0:
            force, spring = 0.0, 0.0
        add_row(w, row_at(w, i), force, spring)
        i += 1
    for i in range(w.nv):
        if w.touched[i] != 0:
            springs, jacobian = w.springs[i], w.jacobian[i]
            for k in range(len(springs)):
                if springs[k] != 0.0:
                    add_scaled(jacobian, springs[k], undamped[k])
    return mismatch


@compiled
def add_row(w, row, force, spring):
    """Add a force along a row, and minus its derivative by the acceleration there."""
    if force != 0.0:
        add_scaled(w.constraint, w.h * force, row)
    if spring != 0.0:
        add_outer(w.springs, spring, row, row)


@compiled
def friction_loss(last, x, limit, mass, update):
    """Return friction with a limit, f = -L x / max(|x|, L / D), and minus its derivative.

    Newton's method could cycle between both sides of rest, as with the sand's friction. So the
    multiplier p = -x / max(|x|, L / D) is an unknown in addition to x (`law.kernel`; for this
    function M. Hintermueller, G. Stadler, SIAM J. Sci. Comput. 28 (2006)).

    `last` has x, the acceleration along the row minus its reference, and p of the last evaluation,
    and is overwritten. `limit` is L, `mass` D of the row while it holds; `update` is `FRESH`,
    `NEXT` or `SAME`. Return third the square of the difference between p and the multiplier of x.
    """
    edge = limit / mass
    size = max(abs(x), edge)
    own = -x / size
    p = own
    if update == NEXT:
        old, p = last[0], last[1]
        growth = math.copysign(x - old, old * (x - old)) if abs(old) > edge else 0.0
        p = min(max(-(x + growth * p) / max(abs(old), edge), -1.0), 1.0)
    elif update == SAME:
        p = last[1]
    last[0], last[1] = x, p
    along = math.copysign(p, p * x) if abs(x) > edge else 0.0
    return limit * own, limit * (1.0 + along) / size, (p - own) ** 2


@compiled
def add_cone(w, first, contact):
    """Add a contact with an elliptic cone, rows `first` to `first + dim`.

    In coordinates scaled by friction, U = (mu x_0, friction_k x_k), N is the first of them and T
    the size of the others: above the cone (N >= mu T) there is no force; below its polar (mu N + T
    <= 0) all rows are springs; between, one spring D_m acts along the distance d = N - mu T from
    the cone,

        f = -D_m d grad d,    -f' = D_m (grad d grad d^T - d mu T''),
        T'' = (diag(friction_k^2) - grad T grad T^T) / T.
    """
    dim, mu = contact.dim, contact.mu
    x, away, along = numbers_of_contact(), numbers_of_contact(), numbers_of_contact()
    t = 0.0
    for k in range(dim):
        x[k] = inner(row_at(w, first + k), w.acceleration) - w.efc_aref[first + k]
        if k > 0:
            t += (x[k] * contact.friction[k - 1]) ** 2
    n, t = mu * x[0], math.sqrt(t)
    if n >= mu * t:
        return
    if mu * n + t <= 0.0:
        for k in range(dim):
            mass = w.efc_D[first + k]
            add_row(w, row_at(w, first + k), -mass * x[k], mass)
        return
    spring = w.efc_D[first] / (mu * mu * (1.0 + mu * mu))
    distance = n - mu * t
    bend = -spring * distance * mu / t
    away[0], along[0] = mu, 0.0  # grad d, grad T
    for k in range(1, dim):
        friction = contact.friction[k - 1] ** 2
        along[k] = friction * x[k] / t
        away[k] = -mu * along[k]
        add_row(w, row_at(w, first + k), 0.0, bend * friction)
    add_row(w, sum_of_rows(w, first, dim, away), -spring * distance, spring)
    add_row(w, sum_of_rows(w, first, dim, along), 0.0, -bend)


@compiled
def sum_of_rows(w, first, dim, factors):
    """Sum `dim` rows times their factors, in `w.trial`."""
    total = w.trial
    clear(total)
    for k in range(dim):
        add_scaled(total, factors[k], row_at(w, first + k))
    return total
