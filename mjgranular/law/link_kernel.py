"""Kernels of the link law, for one rod."""

import math
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import Vector, cross, diagonal, dot, norm, outer
from mjgranular.law.kernel import LawKernel
from mjgranular.law.multiplier import TWO_LIMITS

LINK_KEYS = ("eta_d", "eta_h", "eta_v", "exponent")
LINK_DTYPE = np.dtype([(name, np.float64) for name in (*LINK_KEYS, "density")])


class Rod(NamedTuple):
    """A rod or a piece of one, body frame (`shape.rods`)."""

    center: Vector
    axis: Vector
    half_length: float
    width: float


class RodSample(NamedTuple):
    """A rod in the sand."""

    depth: float
    length: float
    point: Vector
    axis: Vector
    normal: Vector  # of the sand
    limit_n: float  # of static resistance along the normal [N]
    limit_t: float  # the same along the surface
    drag: float  # drag coefficient of motion across the axis [N s^2/m^2]


@compiled
def lumped_limits(depth, cos_q, length, diameter, law, g):
    """Return the limits of the paper's static resistance for one rod, along normal and surface [N].

    `depth` is that of the end T, y_T > 0 [m], `cos_q` the cosine of the angle between axis and
    normal, `length` the immersed length l [m].
    """
    # Eqs. (9), (11): -sign(v) eta_v (y_T/d)^lambda g rho_g V, with V the immersed volume.
    weight = g * law.density * diameter
    column = weight * (0.25 * math.pi * diameter * length)
    # The power comes last, so that the rest runs while it is computed.
    normal = (law.eta_v * column) * (depth / diameter) ** law.exponent
    # Eq. (10): -sign(v) eta_h g rho_g y_T^2 d.
    return normal, law.eta_h * weight * depth * depth


@compiled
def distributed_limits(depth, cos_q, length, diameter, law, g):
    """Return the same limits for one short piece of a rod; arguments as for `lumped_limits`.

    They are the derivatives of the lumped ones along the axis (dy = cos q ds), at the middle of the
    piece's immersed part.
    """
    middle = max(depth - 0.5 * length * cos_q, 0.0)
    weight = g * law.density * diameter * length
    slope = (1.0 + law.exponent) * law.eta_v * weight * (0.25 * math.pi * diameter)
    normal = slope * (middle / diameter) ** law.exponent
    return normal, 2.0 * law.eta_h * weight * middle * cos_q


@partial(compiled, inline=True)
def link_respond(rod, law, g, v, p, eps):
    """Return resistance and its derivatives (see `LawKernel.respond`)."""
    n, u = rod.normal, rod.axis
    more = rod.limit_n - rod.limit_t
    # Eqs. (2), (7): F_d = -eta_d rho_g A_r |v_E| v_E with A_r = d l |sin|, so that the speed
    # cancels and no division by it is needed.
    speed = norm(cross(u, v))
    drag = rod.drag * speed
    static = -rod.limit_t * p - (more * dot(p, n)) * n
    # d(c |u x v| v)/dv = c |u x v| + v (c d|u x v|/dv)
    share = rod.drag / speed if speed > 0.0 else 0.0
    by_v = diagonal(-drag) - outer(v, share * (v - dot(v, u) * u))
    return static, diagonal(-rod.limit_t) - outer(more * n, n), -drag * v, by_v


@compiled
def rod_cull(rod, level):
    """Return the depth of a rod's deeper end [m] (see `LawKernel.cull`)."""
    middle = level.depth - dot(level.normal, rod.center)
    return middle + rod.half_length * abs(dot(level.normal, rod.axis))


@cache
def link_kernel(limits: Any, probe: Any, ceiling: Any = None, lanes: int = 1) -> LawKernel:
    """Make the kernels of one form of the law, whose `limits` are a kernel like `lumped_limits`.

    `probe` and `ceiling` are the surface's; there is one lane if a body is one rod.
    """

    @partial(compiled, inline=True)
    def link_sample(rod, pose, law, surface, g):
        center = pose.position + pose.rotation @ rod.center
        axis = pose.rotation @ rod.axis
        # T is the deeper end; let the axis point from the midpoint to it.
        half = rod.half_length
        depth, normal = probe(surface, center + half * axis)
        other, other_normal = probe(surface, center - half * axis)
        if other > depth:
            depth, normal, axis = other, other_normal, -axis
        length, limit_n, limit_t = 0.0, 0.0, 0.0
        if depth > 0.0:
            length = 2.0 * half
            cos_q = -dot(axis, normal)
            if depth < length * cos_q:
                length = depth / cos_q
            center += (half - 0.5 * length) * axis  # eq. (5): L_CE
            limit_n, limit_t = limits(depth, cos_q, length, rod.width, law, g)
        drag = law.eta_d * law.density * rod.width * length
        return RodSample(depth, length, center, axis, normal, limit_n, limit_t, drag)

    return LawKernel(
        Rod,
        RodSample,
        link_sample,
        link_respond,
        TWO_LIMITS,
        lanes=lanes,
        probe=ceiling,
        cull=None if ceiling is None else rod_cull,
    )
