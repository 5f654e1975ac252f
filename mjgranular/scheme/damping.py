"""Forces as damping by their secants: slower than Newton's method, and never lost.

With C the secants of the forces at a velocity (`law.secant`), the balance

    A (v' - v) = h (q + q_c(v') - J^T C J v')

is linear but for MuJoCo's constraints, and whatever v' it gives, the sand takes energy. Forces and
secants are looked at there, and so on: a fixed point has the law's own forces. The way from one
velocity to the next is prolonged (as D. G. Anderson, J. ACM 12 (1965), mixes them, of depth one):
where an element comes to a stop in the step its velocity shrinks by a factor each time.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.dense import add_scaled, copy, inner, solve
from mjgranular.scheme.evaluation import evaluation_kernel, following_kernel
from mjgranular.scheme.forces import FRESH

FURTHEST = 3.0
"""How far beyond the velocity found the next one may be, in parts of the change between the last
two. Chosen; steps in MuJoCo Warp are alike with 1 and 10. Never between the two: a box that slides
to a stop is wrong by half as much again then."""


@cache
def damping_kernel(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """Makes the kernel `damp(table, w, eps, steps)` for a law and a surface.

    Args:
        kernel: of the law.
        scene_dtype: record of law and surface.
    """
    evaluate = evaluation_kernel(kernel, scene_dtype, damped=True)
    follow_all = following_kernel(kernel, scene_dtype)

    @compiled
    def damp(table, w, eps, steps):
        """Goes some steps from `w.velocity`; ends where damping balances the momenta.

        Args:
            table: of addresses.
            w: the workspace.
            eps: softness [m/s].
            steps: how many, each an evaluation.

        Returns:
            The residual with the law's own forces, one step before the last.
        """
        error = 0.0
        for step in range(steps):
            error, _ = evaluate(table, w, eps, FRESH, eps)
            solved = solve(w.jacobian, w.residual, w.change)
            if not (solved and inner(w.change, w.change) < math.inf):  # forces that are no numbers
                break
            beyond = beyond_the_last(w) if 0 < step < steps - 1 else 0.0
            copy(w.gap, w.change)
            add_scaled(w.velocity, -1.0, w.change)
            for j in range(w.nv):
                found = w.velocity[j]
                w.velocity[j] = found + beyond * (found - w.found[j])
                w.found[j] = found
        follow_all(w, eps)
        return error

    return damp


@compiled
def beyond_the_last(w):
    """The part by which the way from the last velocity found to this one is prolonged."""
    product = square = 0.0
    for j in range(w.nv):
        fall = w.gap[j] - w.change[j]
        product += w.change[j] * fall / w.weight[j]
        square += fall * fall / w.weight[j]
    return prolonged(product, square)


@partial(compiled, inline=True)
def prolonged(product, square):
    """The part by which a way is prolonged, from 0 to `FURTHEST`: there the next gap is least.

    Args:
        product: of the gap between the velocity looked at and the one found there, and what that
            gap has fallen by since the step before; both as momenta.
        square: of what it has fallen by, likewise.
    """
    return min(max(product / square, 0.0), FURTHEST) if square > 0.0 else 0.0
