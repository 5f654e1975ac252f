"""Resistance of one element as a damping C, by its *secant* at the velocity v that is foreseen.

A force F(v) that opposes the velocity has a secant, a symmetric matrix that is not negative, with
C v = -F(v):

    C = F F^T / -(F.v) + |F| / |v| (1 - v v^T / |v|^2) .

The first term alone would do; the second keeps other directions from being free. A force -C v' at
the velocity v' that the step ends with takes energy, whatever v' is, and is the law's own where v'
is the v that was foreseen.
"""

# The code of kernels is Warp's language, of which type checkers of Python know little.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false

# Without `annotations` of the future: Warp reads types of local structs where they stand.
import functools
from typing import Any

import warp as wp

from mjgranular.law.facet_slope import RAMP
from mjgranular.law.kernel import LawKernel
from mjgranular.law.multiplier import TWO_LIMITS
from mjgranular.warp.translate import translated

# A force that is all but perpendicular to the motion has no secant; its power counts as at least
# this share of |F| |v|. Chosen.
_LEAST_POWER = 0.02


def resistance_of(kernel: LawKernel) -> Any:
    """Makes the function of an element that is in the sand.

    Args:
        kernel: of the law.

    Returns:
        A Warp function of a sample, the law, g, the velocity v, the softness eps and the factors on
        static resistance and on drag; it gives C.
    """
    respond = translated(kernel.respond)
    if kernel.multiplier is TWO_LIMITS:
        return _two_limits(respond)
    return _one_limit(respond, _turn if "spread_1" in kernel.samples._fields else _no_turn)


@wp.func
def _soft(square: float, eps: float):
    return 1.0 / wp.sqrt(square + eps * eps)


@wp.func
def secant(force: wp.vec3, u: wp.vec3):
    """C of a force per speed [N s/m] and a direction of motion."""
    size = wp.length(force)
    power = -wp.dot(force, u)
    if not (power > 0.0):
        return wp.mat33()
    whole = wp.max(power, _LEAST_POWER * size)
    across = wp.identity(n=3, dtype=float) - wp.outer(u, u)
    return wp.outer(force, force) / whole + size * across


@functools.cache
def _one_limit(respond: Any, turn: Any) -> Any:
    """Makes the function for a law with one limit: static resistance and drag have one secant.

    Args:
        respond: of the law.
        turn: what a turn of the motion adds, a matrix.
    """
    turn_of = turn(respond)

    @wp.func
    def resistance(
        found: Any,
        law: Any,
        g: float,
        v: wp.vec3,
        eps: float,
        strong: float,
        dense: float,
    ):
        square = wp.dot(v, v)
        u = wp.vec3(0.0, 0.0, -1.0)
        per_speed = float(0.0)
        if square > 0.0:
            per_speed = 1.0 / wp.sqrt(square)
            u = per_speed * v
        soft = strong * _soft(square, eps)
        static, by_p, drag, by_v = respond(found, law, g, v, u, eps)
        c = secant(soft * static + (dense * per_speed) * drag, u)
        return c + soft * turn_of(found, law, g, v, u, eps)

    return resistance


@functools.cache
def _no_turn(respond: Any) -> Any:
    @wp.func
    def turn(found: Any, law: Any, g: float, v: wp.vec3, u: wp.vec3, eps: float):
        return wp.mat33()

    return turn


@functools.cache
def _turn(respond: Any) -> Any:
    """Makes the function for facets, which a turn of the motion makes lead or not.

    On the ramp over which a face begins to lead, its force changes with the direction of motion by
    much more than by its secant: as much is added across the motion, where it does nothing to the
    force at the velocity that is foreseen.
    """

    @wp.func
    def turn(found: Any, law: Any, g: float, v: wp.vec3, u: wp.vec3, eps: float):
        n = found.normal
        lead = wp.dot(n, u)
        edge = wp.abs(wp.dot(u, found.spread_1)) + wp.abs(wp.dot(u, found.spread_2))
        edge = wp.max(edge, RAMP)
        if wp.abs(lead) >= edge or eps == 0.0:
            return wp.mat33()
        toward = wp.normalize(u + (edge - lead) * n)
        whole, by_p, drag, by_v = respond(found, law, g, v, toward, eps)
        across = n - lead * u
        return (wp.length(whole) / (2.0 * edge)) * wp.outer(across, across)

    return turn


@functools.cache
def _two_limits(respond: Any) -> Any:
    """Makes the function for a law with a limit along the surface's normal and one across."""

    @wp.func
    def resistance(
        found: Any,
        law: Any,
        g: float,
        v: wp.vec3,
        eps: float,
        strong: float,
        dense: float,
    ):
        n = found.normal
        v_n = wp.dot(v, n)
        v_t = v - v_n * n
        axis = wp.vec3(1.0, 0.0, 0.0)
        if wp.abs(n[0]) > 0.7:
            axis = wp.vec3(0.0, 1.0, 0.0)
        t = wp.normalize(axis - wp.dot(axis, n) * n)
        along, by_p, drag, by_v = respond(found, law, g, v, n, eps)
        across, by_p2, drag_2, by_v2 = respond(found, law, g, v, t, eps)
        a = -strong * wp.dot(along, n) * _soft(v_n * v_n, eps)
        b = -strong * wp.dot(across, t) * _soft(wp.dot(v_t, v_t), eps)
        c = b * wp.identity(n=3, dtype=float) + (a - b) * wp.outer(n, n)
        speed = wp.length(v)
        if speed > 0.0:
            c += secant((dense / speed) * drag, v / speed)
        return c

    return resistance
