"""What the link law computes at every step, for each rod."""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.law.kernel import LawKernel, grip, in_world
from mjgranular.shape.rods import rod_records

LINK_KEYS = ("eta_d", "eta_h", "eta_v", "exponent")
LINK_DTYPE = np.dtype([(name, np.float64) for name in (*LINK_KEYS, "density")])


@compiled
def lumped_limits(depth, cos_q, length, diameter, law, g):
    """Limits of the paper's static resistance for one rod.

    Args:
        depth: depth of the end T, y_T > 0 [m].
        cos_q: cosine of the angle between the axis and the normal.
        length: immersed length l [m].
        diameter: of the rod [m].
        law: record of the coefficients, `LINK_DTYPE`.
        g: size of gravity [m/s^2].

    Returns:
        (along the normal, along the surface) [N].
    """
    # Eqs. (9), (11): -sign(v) eta_v (y_T/d)^lambda g rho_g V, with V the immersed volume.
    volume = 0.25 * math.pi * diameter * diameter * length
    normal = law.eta_v * (depth / diameter) ** law.exponent * g * law.density * volume
    # Eq. (10): -sign(v) eta_h g rho_g y_T^2 d.
    return normal, law.eta_h * g * law.density * depth * depth * diameter


@compiled
def distributed_limits(depth, cos_q, length, diameter, law, g):
    """The same for one short piece of a rod; arguments as for `lumped_limits`.

    They are the derivatives of the lumped ones along the axis (dy = cos q ds), taken at the middle
    of the piece's immersed part.
    """
    middle = max(depth - 0.5 * length * cos_q, 0.0)
    weight = g * law.density * diameter * length
    slope = (1.0 + law.exponent) * law.eta_v * (middle / diameter) ** law.exponent
    normal = slope * weight * 0.25 * math.pi * diameter
    return normal, 2.0 * law.eta_h * weight * middle * cos_q


@compiled
def link_resist(rod, law, g, v, d):
    """Resistance of an immersed rod to a velocity (see `law.kernel`)."""
    ux, uy, uz, nx, ny, nz, limit_n, limit_t, drag = rod[5:]
    vx, vy, vz = v
    normal_v = vx * nx + vy * ny + vz * nz
    tx, ty, tz = vx - normal_v * nx, vy - normal_v * ny, vz - normal_v * nz
    tangent_v = math.sqrt(tx * tx + ty * ty + tz * tz)
    along_n = 0.0
    if normal_v != 0.0:
        along_n = -math.copysign(limit_n, normal_v)
    along_t = 0.0
    if tangent_v > 0.0:
        along_t = limit_t / tangent_v
    # Eqs. (2), (7): F_d = -eta_d rho_g A_r |v_E| v_E with A_r = d l |sin|, so that the speed
    # cancels and nothing is divided by it.
    dx, dy, dz = d
    sx, sy, sz = uy * dz - uz * dy, uz * dx - ux * dz, ux * dy - uy * dx
    c = drag * math.sqrt(sx * sx + sy * sy + sz * sz)
    return (
        -c * dx + along_n * nx - along_t * tx,
        -c * dy + along_n * ny - along_t * ty,
        -c * dz + along_n * nz - along_t * tz,
    )


@compiled
def link_respond(rod, law, g, v, eps, reach, shares):
    """Resistance and its derivative, rest made soft (see `law.kernel`)."""
    ux, uy, uz = rod[5], rod[6], rod[7]
    nx, ny, nz = rod[8], rod[9], rod[10]
    limit_n, limit_t, drag = rod[11], rod[12], rod[13]
    vx, vy, vz = v
    normal_v = vx * nx + vy * ny + vz * nz
    tx, ty, tz = vx - normal_v * nx, vy - normal_v * ny, vz - normal_v * nz
    tangent_v = math.sqrt(tx * tx + ty * ty + tz * tz)

    gain_n, stiff_n, _ = grip(abs(normal_v), limit_n, eps, reach, shares[0])
    gain_t, along_t, across_t = grip(tangent_v, limit_t, eps, reach, shares[1])
    turn = 0.0
    if tangent_v > 0.0:
        turn = (across_t - along_t) / (tangent_v * tangent_v)
    along_n = gain_n * normal_v

    # d(c |u x v| v)/dv = c |u x v| + v (c d|u x v|/dv)
    along_u = vx * ux + vy * uy + vz * uz
    px, py, pz = vx - along_u * ux, vy - along_u * uy, vz - along_u * uz
    cross = math.sqrt(px * px + py * py + pz * pz)
    c = drag * cross
    share = drag / cross if cross > 0.0 else 0.0
    px, py, pz = share * px, share * py, share * pz

    level = stiff_n - across_t
    same = c + across_t
    return (
        -c * vx - along_n * nx - gain_t * tx,
        -c * vy - along_n * ny - gain_t * ty,
        -c * vz - along_n * nz - gain_t * tz,
        same + level * nx * nx - turn * tx * tx + vx * px,
        level * nx * ny - turn * tx * ty + vx * py,
        level * nx * nz - turn * tx * tz + vx * pz,
        level * ny * nx - turn * ty * tx + vy * px,
        same + level * ny * ny - turn * ty * ty + vy * py,
        level * ny * nz - turn * ty * tz + vy * pz,
        level * nz * nx - turn * tz * tx + vz * px,
        level * nz * ny - turn * tz * ty + vz * py,
        same + level * nz * nz - turn * tz * tz + vz * pz,
    )


@compiled
def link_speeds(rod, v, c):
    """Speeds along the normal and along the surface, and their changes (see `law.kernel`)."""
    nx, ny, nz = rod[8], rod[9], rod[10]
    normal_v = v[0] * nx + v[1] * ny + v[2] * nz
    normal_c = c[0] * nx + c[1] * ny + c[2] * nz
    tx, ty, tz = v[0] - normal_v * nx, v[1] - normal_v * ny, v[2] - normal_v * nz
    tangent_v = math.sqrt(tx * tx + ty * ty + tz * tz)
    tangent_c = tx * c[0] + ty * c[1] + tz * c[2]
    if tangent_v > 0.0:
        tangent_c /= tangent_v
    return abs(normal_v), tangent_v, math.copysign(1.0, normal_v) * normal_c, tangent_c


@cache
def link_kernel(limits: Any, probe: Any) -> LawKernel:
    """The kernels of one form of the law for surfaces with that `probe`.

    Args:
        limits: kernel like `lumped_limits`.
        probe: the surface's.
    """

    @partial(compiled, inline=True)
    def link_immerse(rod, pose, law, surface, g):
        lx, ly, lz = in_world(pose, rod.center[0], rod.center[1], rod.center[2])
        cx, cy, cz = pose.position[0] + lx, pose.position[1] + ly, pose.position[2] + lz
        ux, uy, uz = in_world(pose, rod.axis[0], rod.axis[1], rod.axis[2])
        # T is the deeper end; let the axis point from the midpoint to it.
        half = rod.half_length
        depth, nx, ny, nz = probe(surface, cx + half * ux, cy + half * uy, cz + half * uz)
        other, ox, oy, oz = probe(surface, cx - half * ux, cy - half * uy, cz - half * uz)
        if other > depth:
            depth, nx, ny, nz = other, ox, oy, oz
            ux, uy, uz = -ux, -uy, -uz
        length, limit_n, limit_t = 0.0, 0.0, 0.0
        if depth > 0.0:
            length = 2.0 * half
            cos_q = -(ux * nx + uy * ny + uz * nz)
            if depth < length * cos_q:
                length = depth / cos_q
            arm = half - 0.5 * length  # eq. (5): L_CE
            cx, cy, cz = cx + arm * ux, cy + arm * uy, cz + arm * uz
            limit_n, limit_t = limits(depth, cos_q, length, rod.width, law, g)
        drag = law.eta_d * law.density * rod.width * length
        return depth, length, cx, cy, cz, ux, uy, uz, nx, ny, nz, limit_n, limit_t, drag

    return LawKernel(rod_records, link_immerse, link_resist, link_respond, link_speeds, numbers=9)
