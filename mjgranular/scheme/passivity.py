"""Passivity: over a step the sand gives no energy, also where the solver stops short.

With the sand's momentum j = h J^T f and the velocity v' that the step ends with, its work is
j . v'. At a solution no element's force has a positive part in it. Where the solver stops short,
forces are bounded by the law's, but need not oppose the velocities that they lead to: then the
largest share sigma of them is taken with

    j . v'(sigma) <= 0,    A (v'(sigma) - v) = h (q + q_c(v'(sigma))) + sigma j.
"""

from __future__ import annotations

import math

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import forward_constraint, solve_inertia
from mjgranular.scheme.balance import balance, size_of
from mjgranular.scheme.dense import add_scaled, copy, inner, solve
from mjgranular.scheme.forces import SAME
from mjgranular.scheme.workspace import DISCRETE

_NO_ENERGY = 1e-14  # [J]; chosen
_TRUSTED = 1e-8  # a residual that still says something about the energy
_ROUNDING = 1e-15  # of a share


@compiled
def passive_share(w, error):
    """The share of the sand's momentum that gives no more energy than there is; 1 if all does.

    First by the velocity found and its residual, whose size is measured with the diagonal of the
    inertia alone, which may be far too little for long chains of light bodies: a margin of a
    thousand, and no trust in large residuals. Nor in what a solver of the engine's finds that does
    not only descend from where it is put (`implicit.warm_start`): it stops anywhere.

    Then by the velocity that a share leads to, which the engine itself is asked for where it has
    constraints. Its product with j grows with the share, along a straight line where there are
    none. So what has to be taken off is known from both ends, and doubled until what is left gives
    nothing. What is returned has been asked for. It has to be no more than needed: at rest, where
    rounding alone decides whether there is energy, a share less by one in a million would be a
    kick.

    Args:
        w: the workspace, with the velocity that was found.
        error: size of its residual, in parts of `w.scale`.
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


@compiled
def expected_work(w):
    """The sand's work with the velocity that the step will end with, at most [J].

    That is the velocity found, less what would make up for the residual if the sand's forces stay
    as they are: R over its Jacobian. Whether the engine's constraints answer to that, or its solver
    finds that it has nothing to do, is not known: both are looked at. Destroys residual and
    Jacobian.
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
    """The sand's work with the velocity less a momentum over a matrix [J]. Destroys both."""
    if not solve(matrix, momentum, w.solution):
        return math.inf
    add_scaled(w.solution, -1.0, w.velocity)
    return -inner(w.sand, w.solution)


@compiled
def work_of_share(w, share):
    """The sand's momentum times the velocity that a share of it leads to [J].

    Leaves the engine's state as it was, but for what its step computes anew.
    """
    trial, change, constrained = w.trial, w.solution, w.nefc > 0
    for j in range(w.nv):
        w.qfrc_smooth[j] = (w.smooth[j] + share * w.sand[j]) / w.h - w.shift[j]
    if constrained:
        find_smooth_acceleration(w)
        copy(w.product, w.qacc_warmstart)
        forward_constraint(w.model, w.data)
        copy(w.qacc_warmstart, w.product)
    # Where no damping is behind the constraints the engine's accelerations are taken, else its
    # forces: not the same where its solver has stopped short.
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
    """Sets the acceleration without constraints of `w.qfrc_smooth`, as the engine has it."""
    if w.integrator != DISCRETE:
        solve_inertia(w.model, w.data, w.qacc_smooth.ctypes.data, w.qfrc_smooth.ctypes.data, 1)
        return
    for i in range(w.nv):
        copy(w.jacobian[i], w.inertia[i])
        w.trial[i] = w.qfrc_smooth[i] + w.shift[i]
    solve(w.jacobian, w.trial, w.qacc_smooth)
