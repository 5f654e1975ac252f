"""What the link law computes at every step, for each rod."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.law.kernel import LawKernel, in_world, next_grip
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
    weight = g * law.density * diameter
    column = weight * (0.25 * math.pi * diameter * length)
    # The power comes last: all else is done while it is being computed.
    normal = (law.eta_v * column) * (depth / diameter) ** law.exponent
    # Eq. (10): -sign(v) eta_h g rho_g y_T^2 d.
    return normal, law.eta_h * weight * depth * depth


@compiled
def distributed_limits(depth, cos_q, length, diameter, law, g):
    """The same for one short piece of a rod; arguments as for `lumped_limits`.

    They are the derivatives of the lumped ones along the axis (dy = cos q ds), taken at the middle
    of the piece's immersed part.
    """
    middle = max(depth - 0.5 * length * cos_q, 0.0)
    weight = g * law.density * diameter * length
    slope = (1.0 + law.exponent) * law.eta_v * weight * (0.25 * math.pi * diameter)
    normal = slope * (middle / diameter) ** law.exponent
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


@partial(compiled, inline=True)
def link_respond(rod, law, g, v, p, eps):
    """Resistance and its derivative, rest made soft (see `law.kernel`)."""
    ux, uy, uz = rod[5], rod[6], rod[7]
    nx, ny, nz = rod[8], rod[9], rod[10]
    limit_n, limit_t, drag = rod[11], rod[12], rod[13]
    vx, vy, vz = v
    px, py, pz = p
    normal_v = vx * nx + vy * ny + vz * nz
    tx, ty, tz = vx - normal_v * nx, vy - normal_v * ny, vz - normal_v * nz
    normal_p = px * nx + py * ny + pz * nz
    px, py, pz = px - normal_p * nx, py - normal_p * ny, pz - normal_p * nz
    soft = eps * eps
    scale_n = 1.0 / math.sqrt(normal_v * normal_v + soft)
    scale_t = 1.0 / math.sqrt(tx * tx + ty * ty + tz * tz + soft)
    gain_n, gain_t = limit_n * scale_n, limit_t * scale_t
    stiff_n = gain_n * (1.0 - normal_p * normal_v * scale_n)
    turn = gain_t * scale_t
    bx, by, bz = scale_t * tx - px, scale_t * ty - py, scale_t * tz - pz
    bn = scale_n * normal_v - normal_p
    bend = bx * bx + by * by + bz * bz + bn * bn

    # d(c |u x v| v)/dv = c |u x v| + v (c d|u x v|/dv)
    along_u = vx * ux + vy * uy + vz * uz
    dx, dy, dz = vx - along_u * ux, vy - along_u * uy, vz - along_u * uz
    cross = math.sqrt(dx * dx + dy * dy + dz * dz)
    same = gain_t + drag * cross
    share = drag / cross if cross > 0.0 else 0.0
    dx, dy, dz = share * dx, share * dy, share * dz

    px, py, pz = turn * px, turn * py, turn * pz
    level = stiff_n - gain_t
    along_n = (gain_n - gain_t) * normal_v
    ax, ay, az = level * nx, level * ny, level * nz
    return (
        -same * vx - along_n * nx, -same * vy - along_n * ny, -same * vz - along_n * nz,
        same + ax * nx - px * tx + vx * dx,
        ax * ny - px * ty + vx * dy,
        ax * nz - px * tz + vx * dz,
        ay * nx - py * tx + vy * dx,
        same + ay * ny - py * ty + vy * dy,
        ay * nz - py * tz + vy * dz,
        az * nx - pz * tx + vz * dx,
        az * ny - pz * ty + vz * dy,
        same + az * nz - pz * tz + vz * dz,
        bend,
    )  # fmt: skip


@partial(compiled, inline=True)
def link_grip(rod, v, p, c, eps):
    """The grip along the normal and that along the surface, each with its limit."""
    nx, ny, nz = rod[8], rod[9], rod[10]
    vn = v[0] * nx + v[1] * ny + v[2] * nz
    pn = p[0] * nx + p[1] * ny + p[2] * nz
    cn = c[0] * nx + c[1] * ny + c[2] * nz
    scale = 1.0 / math.sqrt(vn * vn + eps * eps)
    q = (vn + cn - pn * (vn * cn * scale)) * scale
    q = min(max(q, -1.0), 1.0)
    x, y, z = next_grip(
        (v[0] - vn * nx, v[1] - vn * ny, v[2] - vn * nz),
        (p[0] - pn * nx, p[1] - pn * ny, p[2] - pn * nz),
        (c[0] - cn * nx, c[1] - cn * ny, c[2] - cn * nz),
        eps,
    )
    return x + q * nx, y + q * ny, z + q * nz


@partial(compiled, inline=True)
def link_stray(rod, v, c, eps):
    """How far a change of velocity leads, for both grips (see `LawKernel.stray`)."""
    nx, ny, nz = rod[8], rod[9], rod[10]
    soft = eps * eps
    vn = v[0] * nx + v[1] * ny + v[2] * nz
    cn = c[0] * nx + c[1] * ny + c[2] * nz
    vt = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - vn * vn
    ct = c[0] * c[0] + c[1] * c[1] + c[2] * c[2] - cn * cn
    return max(cn * cn / (vn * vn + soft), ct / (max(vt, 0.0) + soft))


@compiled
def rod_skim(rod, level):
    """Depth of a rod's deeper end [m], from the plane of sand in its body's frame."""
    nx, ny, nz, origin = level
    middle = origin - (nx * rod.center[0] + ny * rod.center[1] + nz * rod.center[2])
    slope = nx * rod.axis[0] + ny * rod.axis[1] + nz * rod.axis[2]
    return middle + rod.half_length * abs(slope)


@cache
def link_kernel(limits: Any, probe: Any, level: Any = None, lanes: int = 1) -> LawKernel:
    """The kernels of one form of the law for surfaces with that `probe`.

    Args:
        limits: kernel like `lumped_limits`.
        probe: the surface's.
        level: the surface's, to skim rods with it.
        lanes: as in `LawKernel`; 1 where a body is one rod.
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

    kernel = LawKernel(
        rod_records,
        link_immerse,
        link_resist,
        link_respond,
        link_grip,
        numbers=9,
        stray=link_stray,
        lanes=lanes,
    )
    return kernel if level is None else replace(kernel, level=level, skim=rod_skim)
