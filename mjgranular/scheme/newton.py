"""Newton's method for the balance of momentum, with friction multipliers, and damping.

    R'(v') c = R(v'),    v' <- v' - c

Unknowns besides v' are the elements' friction multipliers p, tied to their velocities v by
sqrt(v^2 + eps^2) p = v. That equation is linearized too, and p is eliminated element by element
(`law.kernel`), so that nv equations remain.
"""

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.scheme.balance import evaluate, evaluate_last, follow_all
from mjgranular.scheme.dense import add_scaled, copy, inner, solve
from mjgranular.scheme.forces import DAMP, FRESH, LAST, NEXT, RESPOND

# Square of the difference between a multiplier and its velocity's: below the first the force counts
# as the law's, below the second the residual is expected to decrease along a step. Chosen.
_MATCHED, _STRAIGHT = 1e-8, 1e-6
_STUCK = 4  # steps that do not halve the residual
# Allowed error of linearly extrapolated forces, squared, relative to the limit; and the error
# estimated from joint velocities instead of element velocities below which it is evaluated at all.
# Chosen: in 2,990 steps of four robots driven at random the law itself would have left 1e-9 of the
# momentum in the median, and 3e-6 in 99 of 100.
_MISFIT, _NEARLY = 1e-8, 1e-6
_SHORTEST = 0.1  # of a step
_NOTHING = 1e-150  # smallest speed to divide by


class Search(NamedTuple):
    """Options of one run of Newton's method."""

    # Multipliers at the beginning: `FRESH`, those of the velocity itself with the softness `loose`;
    # `SAME`, those there; `LAST`, those of the motions in `w`, at which forces are linearized.
    update: np.int64
    loose: float  # [m/s]
    eps: float  # softness [m/s]
    goal: float  # residual to be reached
    steps: np.int64  # at most
    most_mismatch: float  # at which to give up


@compiled
def newton(table, w, search):
    """Run Newton's method from `w.velocity`; leave it at the last iterate.

    Full steps are taken: turning multipliers are how the method finds out what holds and what
    slides, and the residual grows meanwhile. Only if multipliers have stopped turning and the
    residual still grows is there a kink in between, and the step is halved.

    The last step is not evaluated with the law. If it is so short that the law is linear over it
    (`misfit`), forces are extrapolated by their derivative: the momenta balance with them, and they
    equal the law's within the tolerance. The balance itself is checked, since one of MuJoCo's
    constraints may begin or end on the way.

    Return the evaluations, and the residual, which is infinite while it is not meaningful.
    """
    velocity, change, eps = w.velocity, w.change, search.eps
    if search.update == LAST:
        error, mismatch, turn = evaluate_last(table, w, eps)
        if error <= search.goal:
            if misfit(turn, mismatch) <= _MISFIT:
                return 1, follow_all(table, w, eps)[0]
            error = math.inf
    else:
        error, mismatch = evaluate(table, w, RESPOND, eps, search.update, search.loose)
    done, stuck = 1, 0
    while (
        done <= search.steps
        and stuck < _STUCK
        and mismatch < search.most_mismatch
        and (error > search.goal or mismatch > _MATCHED)
    ):
        if not solve(w.jacobian, w.residual, change):
            break
        add_scaled(velocity, -1.0, change)
        turn = inner(change, change) / (inner(velocity, velocity) + _NOTHING)
        if misfit(turn, mismatch) <= _NEARLY:
            left, turn = follow_all(table, w, eps)
            if left <= search.goal and misfit(turn, mismatch) <= _MISFIT:
                return done, left
        found, mismatch = evaluate(table, w, RESPOND, eps, NEXT, 0.0)
        done += 1
        back = 0.5
        while (
            not found < error and mismatch < _STRAIGHT and back > _SHORTEST and done <= search.steps
        ):
            add_scaled(velocity, back, change)
            back *= 0.5
            found, mismatch = evaluate(table, w, RESPOND, eps, NEXT, 0.0)
            done += 1
        stuck += mismatch < _STRAIGHT and not found < 0.5 * error
        error = found
    return done, error if mismatch <= _MATCHED else math.inf


@compiled
def misfit(turn, mismatch):
    """Estimate the square of the error of linearizing a law over a step, relative to the limit.

    With delta = |c| / s and beta = |v / s - p| the estimate is beta^2 + delta (delta + beta);
    `turn` is delta^2, with the speed s over which the law turns, and `mismatch` beta^2. A stress
    turns with the multiplier, which has to make up for its mismatch; and speed and multiplier
    change together, in a product that is known only to first order.
    """
    delta, beta = math.sqrt(turn), math.sqrt(mismatch)
    return (mismatch + delta * (delta + beta)) ** 2


# Forces as damping, by their secants: slower than Newton's method, but it never diverges. With
# secants (docs/scheme.md, "Damping") the balance is linear except for MuJoCo's constraints, and the
# sand dissipates energy for any velocity it gives. Forces and secants are then evaluated there, and
# so on: a fixed point has the law's own forces.

FURTHEST = 3.0
"""How far the next velocity may lie beyond the one found, as a multiple of the change between the
last two. Chosen; steps in MuJoCo Warp are alike with 1 and 10. Never negative (between the two):
that increases the error of a box sliding to a stop by half."""

DAMPINGS = 8
"""Iterations of `damp`. Chosen."""


@partial(compiled, merge=True)
def damp(table, w, eps):
    """Iterate from `w.velocity`; end at a velocity where damping balances the momenta.

    Return the residual with the law's own forces, one iteration before the last.
    """
    error = 0.0
    for step in range(DAMPINGS):
        error, _ = evaluate(table, w, DAMP, eps, FRESH, eps)
        solved = solve(w.jacobian, w.residual, w.change)
        if not (solved and inner(w.change, w.change) < math.inf):  # forces that are not finite
            break
        beyond = beyond_the_last(w) if 0 < step < DAMPINGS - 1 else 0.0
        copy(w.gap, w.change)
        add_scaled(w.velocity, -1.0, w.change)
        for j in range(w.nv):
            found = w.velocity[j]
            w.velocity[j] = found + beyond * (found - w.found[j])
            w.found[j] = found
    follow_all(table, w, eps)
    return error


@compiled
def beyond_the_last(w):
    """Return the extrapolation factor from the last velocity found to this one."""
    product = square = 0.0
    for j in range(w.nv):
        fall = w.gap[j] - w.change[j]
        product += w.change[j] * fall / w.weight[j]
        square += fall * fall / w.weight[j]
    return prolonged(product, square)


@partial(compiled, inline=True)
def prolonged(product, square):
    """Return the extrapolation factor, from 0 to `FURTHEST`, that minimizes the next gap.

    The gap is that between the velocity evaluated and the one found. Given, both as momenta, are
    its inner product with its decrease since the iteration before, and the square of that decrease.
    """
    return min(max(product / square, 0.0), FURTHEST) if square > 0.0 else 0.0
