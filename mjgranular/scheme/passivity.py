"""Passivity: the sand adds no energy in a step, even if the solver stops early.

With the sand's momentum j = h J^T f and the final velocity v' of the step, its work is j . v'. At a
solution no element's force contributes a positive part. If the solver stops early, forces are
bounded by the law's, but may not oppose the velocities that result. Then the largest share sigma of
them is used with

    j . v'(sigma) <= 0,    A (v'(sigma) - v) = h (q + q_c(v'(sigma))) + sigma j.
"""

import math
from functools import partial

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import forward_constraint, solve_inertia
from mjgranular.scheme.balance import balance, size_of
from mjgranular.scheme.dense import add_scaled, copy, inner, solve
from mjgranular.scheme.forces import SAME
from mjgranular.scheme.workspace import DISCRETE

_NO_ENERGY = 1e-14  # [J]; chosen
_TRUSTED = 1e-8  # largest residual that still bounds the energy
_ROUNDING = 1e-15  # of a share


@partial(compiled, merge=True)
def passive_share(w, error):
    """Return the largest share of the sand's momentum that adds no energy; 1 if all of it does not.

    The first test uses the velocity found and its residual, `error` relative to `w.scale`. The
    residual's size is measured with the diagonal of the inertia alone, which may be far too small
    for long chains of light bodies: hence a margin of a thousand, and large residuals are not
    trusted. Neither is a constraint solver that may end farther from the solution than it starts
    (`implicit.warm_start`).

    The second test uses the velocity that a share leads to, computed by the engine itself if there
    are constraints. Its product with j grows with the share, linearly if there are none. So the
    reduction needed is known from both ends, and is doubled until the rest adds no energy. The
    returned share has been tested. It must be no smaller than needed: at rest, where rounding alone
    decides the sign of the energy, a share smaller by one in a million would disturb the balance.
    """
    if (w.descends != 0 or w.nefc == 0) and error < _TRUSTED:
        work = inner(w.sand, w.velocity)
        if work + 1e3 * error * w.scale * size_of(w, w.sand) <= _NO_ENERGY:
            return 1.0
        if expected_work(w) <= _NO_ENERGY:
            return 1.0
    whole = work_of_share(w, 1.0)
    if whole <= _NO_ENERGY:
        return 1.0
    none = work_of_share(w, 0.0)
    if none >= 0.0:
        return 0.0
    less = max(whole / (whole - none), _ROUNDING)
    while less < 1.0:
        if work_of_share(w, 1.0 - less) <= 0.0:
            return 1.0 - less
        less *= 2.0
    return 0.0


@partial(compiled, merge=True)
def expected_work(w):
    """Return an upper bound on the sand's work with the step's final velocity [J].

    That velocity is the one found minus the correction for the residual if the sand's forces stay
    as they are: R over its Jacobian. Whether the engine's constraints respond to that, or its
    solver stays at its start, is unknown: both are evaluated. Destroys residual and Jacobian.
    """
    balance(w, SAME)
    copy(w.product, w.residual)
    work = work_without(w, w.jacobian, w.residual)
    if w.nefc > 0:
        for i in range(w.nv):
            copy(w.jacobian[i], w.inertia[i])
        work = max(work, work_without(w, w.jacobian, w.product))
    return work


@compiled
def work_without(w, matrix, momentum):
    """Return the sand's work with the velocity less a momentum over a matrix [J]. Destroys both."""
    if not solve(matrix, momentum, w.solution):
        return math.inf
    add_scaled(w.solution, -1.0, w.velocity)
    return -inner(w.sand, w.solution)


@compiled
def work_of_share(w, share):
    """Return the sand's momentum times the velocity that a share of it leads to [J].

    The engine's state is preserved, except for what its step recomputes.
    """
    trial, change, constrained = w.trial, w.solution, w.nefc > 0
    for j in range(w.nv):
        w.qfrc_smooth[j] = (w.smooth[j] + share * w.sand[j]) / w.h - w.shift[j]
    if constrained:
        find_smooth_acceleration(w)
        copy(w.product, w.qacc_warmstart)
        forward_constraint(w.model, w.data)
        copy(w.qacc_warmstart, w.product)
    # If the integrator adds no damping to the constraints, the engine's accelerations are used,
    # else its forces: they differ where its solver stopped early.
    if constrained and w.damped == 0:
        for j in range(w.nv):
            change[j] = w.h * w.qacc[j]
    else:
        for j in range(w.nv):
            force = w.qfrc_smooth[j] + w.qfrc_constraint[j] if constrained else w.qfrc_smooth[j]
            trial[j] = w.h * (force + w.shift[j])
        for i in range(w.nv):
            copy(w.jacobian[i], w.inertia[i])
        if not solve(w.jacobian, trial, change):
            return math.inf
    add_scaled(change, 1.0, w.start)
    return inner(w.sand, change)


@compiled
def find_smooth_acceleration(w):
    """Set the unconstrained acceleration of `w.qfrc_smooth`, as the engine computes it."""
    if w.integrator != DISCRETE:
        solve_inertia(w.model, w.data, w.qacc_smooth.ctypes.data, w.qfrc_smooth.ctypes.data, 1)
        return
    for i in range(w.nv):
        copy(w.jacobian[i], w.inertia[i])
        w.trial[i] = w.qfrc_smooth[i] + w.shift[i]
    solve(w.jacobian, w.trial, w.qacc_smooth)
