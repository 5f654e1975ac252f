"""Newton's method for the balance of momentum, with friction multipliers.

    R'(v') c = R(v'),    v' <- v' - c

Unknown beside v' are the elements' friction multipliers p, tied to their velocities v by
sqrt(v^2 + eps^2) p = v. That equation is linearized too, and p eliminated element by element
(`law.kernel`), so that nv equations are left.
"""

from __future__ import annotations

import math
from collections import namedtuple
from functools import cache
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.dense import add_scaled, inner, solve
from mjgranular.scheme.evaluation import evaluation_kernel, following_kernel
from mjgranular.scheme.forces import NEXT

# Square of the difference of a multiplier and its velocity's: where the force may be taken for the
# law's, and where the residual may be trusted to fall along a step. Chosen.
_MATCHED, _STRAIGHT = 1e-8, 1e-6
_STUCK = 4  # steps that do not halve the residual
# How far forces that follow by their derivative may be from the law's: the square of that, in parts
# of the limit, and where it is worth a look, by the velocities of the joints instead of those of
# the elements. Chosen: in 2,990 steps of four robots driven at random what the law itself would
# have left was 1e-9 of the momentum at hand in the median, and 3e-6 in 99 of 100.
_MISFIT, _NEARLY = 1e-8, 1e-6
_SHORTEST = 0.1  # of a step
_NOTHING = 1e-150  # a speed that may be divided by

Search = namedtuple("Search", ["update", "loose", "eps", "goal", "steps", "most_mismatch"])
Search.__doc__ = """Options of one run of Newton's method.

Attributes:
    update: of the multipliers at the beginning: `FRESH`, those of the velocity itself with the
        softness `loose`; `SAME`, those that are there.
    loose: see there [m/s].
    eps: softness [m/s].
    goal: residual to be reached.
    steps: at most.
    most_mismatch: at which to give up.
"""


@cache
def newton_kernel(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """Makes the kernel `newton(table, w, search)` for a law and a surface.

    Args:
        kernel: of the law.
        scene_dtype: record of law and surface.
    """
    evaluate = evaluation_kernel(kernel, scene_dtype)
    follow_all = following_kernel(kernel, scene_dtype)

    @compiled
    def newton(table, w, search):
        """Newton's method from `w.velocity`, which ends where it got to.

        Steps are taken whole: multipliers that turn are how it finds out what holds and what
        slides, and the residual grows on the way. Only where multipliers have stopped turning, and
        the residual grows still, is there a kink between here and there, and half of the step is
        taken back.

        The last step is not looked at again. Where it is so short that the law is a straight line
        over it (`misfit`), forces follow by their derivative: the momenta balance with them, and
        they are the law's to within what is allowed. That the momenta balance is looked at, for one
        of MuJoCo's constraints may begin or end on the way.

        Args:
            table: of addresses.
            w: the workspace.
            search: how to go.

        Returns:
            (evaluations, residual; infinite where it says nothing yet).
        """
        velocity, change, eps = w.velocity, w.change, search.eps
        error, mismatch = evaluate(table, w, eps, search.update, search.loose)
        done = 1
        stuck = 0
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
                left, turn = follow_all(w, eps)
                if left <= search.goal and misfit(turn, mismatch) <= _MISFIT:
                    return done, left
            found, mismatch = evaluate(table, w, eps, NEXT, 0.0)
            done += 1
            back = 0.5
            while (
                not found < error
                and mismatch < _STRAIGHT
                and back > _SHORTEST
                and done <= search.steps
            ):
                add_scaled(velocity, back, change)
                back *= 0.5
                found, mismatch = evaluate(table, w, eps, NEXT, 0.0)
                done += 1
            stuck += mismatch < _STRAIGHT and not found < 0.5 * error
            error = found
        return done, error if mismatch <= _MATCHED else math.inf

    return newton


@compiled
def misfit(turn, mismatch):
    """Estimates what is lost where a law is taken for a straight line over a step.

    With delta = |c| / s and beta = |v / s - p|, beta^2 + delta (delta + beta): a stress turns with
    the multiplier, which has to make up for its mismatch; and speed and multiplier change together,
    in a product of which only the parts of first order are known.

    Args:
        turn: delta^2, square of the change in parts of the speed s over which the law turns.
        mismatch: beta^2, square of the difference between the multiplier and the velocity's own.

    Returns:
        Square of the force that is lost, in parts of the limit.
    """
    delta, beta = math.sqrt(turn), math.sqrt(mismatch)
    return (mismatch + delta * (delta + beta)) ** 2
