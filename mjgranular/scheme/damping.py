"""Forces as damping, by their secants: slower than Newton's method, but it never diverges.

docs/scheme.md, "Damping", has the secants (`law.secant`). With them the balance is linear except
for MuJoCo's constraints, and the sand dissipates energy for any velocity it gives. Forces and
secants are then evaluated there, and so on: a fixed point has the law's own forces.
"""

import math
from functools import partial

from mjgranular.kernel.compiled import compiled
from mjgranular.scheme.balance import evaluate, follow_all
from mjgranular.scheme.dense import add_scaled, copy, inner, solve
from mjgranular.scheme.forces import DAMP, FRESH

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
