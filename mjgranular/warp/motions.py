"""Bodies in the sand: records, motions, 6 x 6 damping matrices; the damping C of an element.

C is the secant at the predicted velocity v: if that is the velocity at the end of the step, the
force -C v is the law's own (`scheme.forces.secant`).
"""

# Kernels are written in Warp's language, which Python type checkers do not understand.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false
# pyright: reportAttributeAccessIssue=false

import functools
from typing import Any

import numpy as np
import warp as wp

from mjgranular.kernel import motion
from mjgranular.law.kernel import LawKernel
from mjgranular.law.multiplier import TWO_LIMITS, softened
from mjgranular.scheme.forces import secant
from mjgranular.warp.grid import struct
from mjgranular.warp.translate import struct_of, translated

_NAMES = ("body", "root", "first", "end", "spin", "chain", "chain_end")
SLOT_DTYPE = np.dtype([(name, np.int32) for name in _NAMES])
Slot = struct("Slot", dict.fromkeys(_NAMES, wp.int32))
"""A body in the sand: its id, its tree's root, its elements, its degrees of freedom in `chain`;
before them, from `spin` on, those that turn its tree (`scheme.workspace.spins`)."""

Damping = struct(
    "Damping", {"turn": wp.mat33, "mixed": wp.mat33, "slide": wp.mat33, "arm": wp.vec3}
)
"""A symmetric 6 x 6 matrix for (angular, linear), by blocks; `mixed` is (angular, linear).

Its reference point, at `arm` from the center of the body's tree, has the greatest resistance and so
moves least; about others the power about a standing foot is a difference of large numbers."""

WarpMotion = struct_of(motion.Motion)

secant_of, velocity_at = translated(secant), translated(motion.velocity_at)
_soft = translated(softened)


@wp.func
def spatial(vectors: wp.array2d(dtype=wp.spatial_vector), world: int, i: int):
    """Return a spatial vector of MuJoCo as a motion."""
    both = vectors[world, i]
    return WarpMotion(wp.spatial_top(both), wp.spatial_bottom(both))


@wp.func
def moved(motion: WarpMotion, arm: wp.vec3):
    """Return the same motion about another point."""
    return WarpMotion(motion.angular, velocity_at(motion, arm))


@wp.func
def motion_of(
    slot: Slot,
    chain: wp.array(dtype=int),
    cdof: wp.array2d(dtype=wp.spatial_vector),
    rates: wp.array2d(dtype=float),
    world: int,
):
    """Compute the motion of a body about its tree's center from joint velocities."""
    return motion_by(slot.chain, slot.chain_end, chain, cdof, rates, world)


@wp.func
def motion_by(
    first: int,
    end: int,
    chain: wp.array(dtype=int),
    cdof: wp.array2d(dtype=wp.spatial_vector),
    rates: wp.array2d(dtype=float),
    world: int,
):
    """Compute what degrees of freedom, from `first` to before `end` in `chain`, add to a motion."""
    angular, linear = wp.vec3(), wp.vec3()
    for k in range(first, end):
        axis = spatial(cdof, world, chain[k])
        rate = rates[world, chain[k]]
        angular += rate * axis.angular
        linear += rate * axis.linear
    return WarpMotion(angular, linear)


@wp.func
def added_to(d: Damping, c: wp.mat33, arm: wp.vec3):
    """Return the damping of a body plus that of one of its points."""
    r = wp.skew(arm - d.arm)
    rc = r * c
    return Damping(d.turn - rc * r, d.mixed + rc, d.slide + c, d.arm)


@wp.func
def about(d: Damping, arm: wp.vec3):
    """Return the damping of a body about another point."""
    s = wp.skew(arm - d.arm)
    crossed = d.mixed * s
    turn = d.turn + crossed + wp.transpose(crossed) - s * d.slide * s
    return Damping(turn, d.mixed - s * d.slide, d.slide, arm)


@wp.func
def _norm(c: wp.mat33):
    """Return the maximum absolute row sum: an upper bound in every direction."""
    rows = wp.vec3(1.0, 1.0, 1.0)
    sizes = wp.vec3(
        wp.dot(wp.abs(c[0]), rows), wp.dot(wp.abs(c[1]), rows), wp.dot(wp.abs(c[2]), rows)
    )
    return wp.max(sizes)


@wp.func
def bounded(d: Damping, most: float):
    """Return the damping of a body, scaled down to an upper bound [N s/m]."""
    part = wp.min(1.0, most / _norm(d.slide))
    return Damping(part * d.turn, part * d.mixed, part * d.slide, d.arm)


@wp.func
def wrench_of(d: Damping, motion: WarpMotion):
    """Return the wrench -C v of a motion about its point, as a motion (moment, force)."""
    moment = d.turn * motion.angular + d.mixed * motion.linear
    force = wp.transpose(d.mixed) * motion.angular + d.slide * motion.linear
    return WarpMotion(-moment, -force)


def resistance_of(kernel: LawKernel) -> Any:
    """Make the function that returns C of an immersed element."""
    respond = translated(kernel.respond)
    if kernel.multiplier is TWO_LIMITS:
        return _two_limits(respond)
    return _one_limit(respond)


@functools.cache
def _one_limit(respond: Any) -> Any:
    """Make the function for a law with one limit: static resistance and drag share one secant."""

    @wp.func
    def resistance(
        found: Any, law: Any, g: float, v: wp.vec3, eps: float, strong: float, dense: float
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
        found: Any, law: Any, g: float, v: wp.vec3, eps: float, strong: float, dense: float
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
