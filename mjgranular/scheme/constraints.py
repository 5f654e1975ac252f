"""MuJoCo's constraints in the balance of momentum, as the implicit scheme foresees them.

They are soft: the force of a row J_i is a function of the acceleration along it, within bounds,

    q_c = sum_i J_i^T f_i,    f_i = -D_i x_i,    x_i = J_i a - a_i^ref,

where a is the acceleration in front of the integrator's own damping C = A - M,

    M a = A (v' - v) / h,    J_i a = J_i (1 + M^-1 C) (v' - v) / h.

Equalities, friction losses, limits, and contacts with pyramidal and elliptic cones, as in the
engine's documentation.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import solve_inertia
from mjgranular.kernel.memory import scratch
from mjgranular.scheme.blocks import NEXT, SAME
from mjgranular.scheme.dense import add_outer, add_scaled, clear, copy, inner
from mjgranular.scheme.workspace import EULER, ROWS_KEPT

_EQUALITY = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
_FRICTION = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON)  # and of a joint, one below
_ELLIPTIC = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC)
# In `w.rows`: for a row that is not kept, and for a sum of rows.
_SPARE, _SUM = np.int64(ROWS_KEPT), np.int64(ROWS_KEPT + 1)
numbers_of_contact = scratch(6)


@compiled
def prepare_rows(w):
    """Reads the constraints' rows, those that are kept."""
    for i in range(min(w.nefc, ROWS_KEPT)):
        read_row(w, i, i)


@compiled
def read_row(w, i, k):
    """Writes J_i and J_i (1 + M^-1 C) to `w.rows[k]` and `w.damped_rows[k]`."""
    nv = w.nv
    row, damped = w.rows[k], w.damped_rows[k]
    if w.sparse:
        clear(row)
        start = w.efc_J_rowadr[i]
        for place in range(start, start + w.efc_J_rownnz[i]):
            row[w.efc_J_colind[place]] = w.efc_J[place]
    else:
        copy(row, w.efc_J[i * nv : i * nv + nv])
    copy(damped, row)
    if w.integrator != EULER:
        product = w.product
        solve_inertia(w.model, w.data, product.ctypes.data, row.ctypes.data, 1)
        for j in range(nv):
            if product[j] != 0.0:
                add_scaled(damped, product[j], w.damping[j])


@compiled
def kept_row(w, i):
    """The index in `w.rows` and `w.damped_rows` where row i of the constraints is."""
    if i < ROWS_KEPT:
        return i
    read_row(w, i, _SPARE)
    return _SPARE


@compiled
def along_row(w, i):
    """The acceleration along a row, less its reference: x_i."""
    return inner(w.damped_rows[kept_row(w, i)], w.rate) - w.efc_aref[i]


@compiled
def add_row(w, k, force, stiffness, h):
    """Adds the force along a kept row to h q_c, and its stiffness, minus its derivative, to R'."""
    if force != 0.0:
        add_scaled(w.constraint, h * force, w.rows[k])
    if stiffness != 0.0:
        add_outer(w.jacobian, stiffness, w.rows[k], w.damped_rows[k])


@compiled
def add_constraints(w, h, update):
    """Sets h q_c at the velocity `w.velocity`, and adds its derivative to R'.

    Args:
        w: the workspace.
        h: time step [s].
        update: of friction multipliers: `FRESH`, `NEXT`, `SAME`.

    Returns:
        The greatest mismatch of a friction loss (`friction_loss`).
    """
    clear(w.constraint)
    mismatch = 0.0
    losses = 0
    for j in range(w.nv):
        w.rate[j] = (w.velocity[j] - w.start[j]) / h
    i = np.int64(0)  # a literal would be compiled for on its own
    while i < w.nefc:
        kind = w.efc_type[i]
        if kind == _ELLIPTIC:
            contact = w.contact[w.efc_id[i]]
            add_cone(w, i, contact, h)
            i += contact.dim
            continue
        x, mass = along_row(w, i), w.efc_D[i]
        force, stiffness = -mass * x, mass
        if kind != _EQUALITY and kind <= _FRICTION:
            last, limit = w.friction[losses], w.efc_frictionloss[i]
            force, stiffness, own = friction_loss(last, x, limit, mass, update)
            mismatch = max(mismatch, own)
            losses += 1
        elif kind != _EQUALITY and x >= 0.0:
            force, stiffness = 0.0, 0.0
        add_row(w, kept_row(w, i), force, stiffness, h)
        i += 1
    return mismatch


@compiled
def friction_loss(last, x, limit, mass, update):
    """Friction with a limit, f = -L x / max(|x|, L / D), and minus its derivative.

    From one side of rest to the other Newton's method could leap for ever, as it could with the
    sand's: the multiplier p = -x / max(|x|, L / D) is unknown beside x (`law.kernel`; for this
    function M. Hintermueller, G. Stadler, SIAM J. Sci. Comput. 28 (2006)).

    Args:
        last: x and p that were last looked at; will be those of now.
        x: acceleration along the row, less its reference.
        limit: L.
        mass: D, of the row while it holds.
        update: `FRESH`, `NEXT`, `SAME`.

    Returns:
        (force, stiffness, square of the difference of p and the one of x itself).
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
def add_cone(w, first, contact, h):
    """A contact with an elliptic cone, rows `first` to `first + dim`.

    In coordinates scaled by friction, U = (mu x_0, friction_k x_k), N the first of them and T the
    size of the others: above the cone (N >= mu T) nothing; below its polar (mu N + T <= 0) all
    rows are springs; between, one spring D_m along the distance d = N - mu T from the cone,

        f = -D_m d grad d,    -f' = D_m (grad d grad d^T - d mu T''),
        T'' = (diag(friction_k^2) - grad T grad T^T) / T.
    """
    dim, mu = contact.dim, contact.mu
    x, away, along = numbers_of_contact(), numbers_of_contact(), numbers_of_contact()
    t = 0.0
    for k in range(dim):
        x[k] = along_row(w, first + k)
        if k > 0:
            t += (x[k] * contact.friction[k - 1]) ** 2
    n, t = mu * x[0], math.sqrt(t)
    if n >= mu * t:
        return
    if mu * n + t <= 0.0:
        for k in range(dim):
            mass = w.efc_D[first + k]
            add_row(w, kept_row(w, first + k), -mass * x[k], mass, h)
        return
    spring = w.efc_D[first] / (mu * mu * (1.0 + mu * mu))
    distance = n - mu * t
    bend = -spring * distance * mu / t
    away[0], along[0] = mu, 0.0  # grad d, grad T
    for k in range(1, dim):
        friction = contact.friction[k - 1] ** 2
        along[k] = friction * x[k] / t
        away[k] = -mu * along[k]
        add_row(w, kept_row(w, first + k), 0.0, bend * friction, h)
    sum_rows(w, first, dim, away)
    add_row(w, _SUM, -spring * distance, spring, h)
    sum_rows(w, first, dim, along)
    add_row(w, _SUM, 0.0, -bend, h)


@compiled
def sum_rows(w, first, dim, factors):
    """Writes a sum of multiples of so many rows to `w.rows` and `w.damped_rows`."""
    clear(w.rows[_SUM])
    clear(w.damped_rows[_SUM])
    for k in range(dim):
        row = kept_row(w, first + k)
        add_scaled(w.rows[_SUM], factors[k], w.rows[row])
        add_scaled(w.damped_rows[_SUM], factors[k], w.damped_rows[row])
