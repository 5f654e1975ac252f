"""Resistance of an element as a damping matrix C, the secant at the predicted velocity v.

If v is the velocity at the end of the step, the force -C v is the law's own (`law.secant`).
"""

# Kernels are written in Warp's language, which Python type checkers do not understand.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false

# No `from __future__ import annotations`: Warp reads the types of local structs in place.
import functools
from typing import Any

import warp as wp

from mjgranular.law.kernel import LawKernel
from mjgranular.law.multiplier import TWO_LIMITS
from mjgranular.law.secant import secant
from mjgranular.warp.translate import translated

secant_of = translated(secant)


def resistance_of(kernel: LawKernel) -> Any:
    """Make the resistance function of an immersed element.

    It returns C for a sample, the law, g, the velocity v, the softness eps and the factors on
    static resistance and on drag.
    """
    respond = translated(kernel.respond)
    if kernel.multiplier is TWO_LIMITS:
        return _two_limits(respond)
    return _one_limit(respond)


@wp.func
def _soft(square: float, eps: float):
    return 1.0 / wp.sqrt(square + eps * eps)


@functools.cache
def _one_limit(respond: Any) -> Any:
    """Make the function for a law with one limit: static resistance and drag share one secant."""

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
        slope = wp.mat33()
        if eps > 0.0:  # else the law is discontinuous and its slopes are rounding errors
            slope = -soft * by_p - dense * by_v
        return secant_of(soft * static + (dense * per_speed) * drag, slope, u)

    return resistance


@functools.cache
def _two_limits(respond: Any) -> Any:
    """Make the function for a law with one limit along the surface's normal and one across."""

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
            c += secant_of((dense / speed) * drag, -dense * by_v, v / speed)
        return c

    return resistance
