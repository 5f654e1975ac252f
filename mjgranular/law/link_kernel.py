"""What the link law computes at every step, for each rod."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import (
    BODIES,
    BODY_COUNT,
    CONTACTS,
    ELEMENT_COUNT,
    ELEMENTS,
    GRAVITY,
    NBODY,
    SCENE,
    SUBTREE_COM,
    XIPOS,
    XMAT,
    XPOS,
    floats,
    records,
)
from mjgranular.kernel.motion import add_force, body_velocity, velocity_at, velocity_change
from mjgranular.kernel.records import body_records, contact_records
from mjgranular.shape.rods import rod_records

LINK_KEYS = ("eta_d", "eta_h", "eta_v", "exponent")
LINK_DTYPE = np.dtype([(name, np.float64) for name in (*LINK_KEYS, "density")])


@compiled
def lumped_resistance(depth, cos_q, length, diameter, cross, normal_v, tangent_v, law, g):
    """The paper's law for one rod: what multiplies velocity, normal and tangent.

    Args:
        depth: depth of the end T, y_T > 0 [m].
        cos_q: cosine of the angle between the axis and the normal.
        length: immersed length l [m].
        diameter: of the rod [m].
        cross: |axis x v_E|, the speed across the axis [m/s]; its ratio to |v_E| is the sine in
            A_r.
        normal_v: component of v_E along the normal, out of the sand [m/s].
        tangent_v: size of the component of v_E along the surface [m/s].
        law: record of the coefficients, `LINK_DTYPE`.
        g: size of gravity [m/s^2].

    Returns:
        (drag, static_normal, static_tangent): the force on the rod is
        `-drag * v_E + static_normal * n - static_tangent * v_tangent`, [kg/s], [N], [kg/s].
    """
    # Eqs. (2), (7): F_d = -eta_d rho_g A_r |v_E| v_E with A_r = d l |sin|, so that the speed
    # cancels and nothing is divided by it.
    drag = law.eta_d * law.density * diameter * length * cross
    # Eqs. (9), (11): -sign(v) eta_v (y_T/d)^lambda g rho_g V, with V the immersed volume.
    static_normal = 0.0
    if normal_v != 0.0:
        volume = 0.25 * math.pi * diameter * diameter * length
        limit = law.eta_v * (depth / diameter) ** law.exponent * g * law.density * volume
        static_normal = -math.copysign(limit, normal_v)
    # Eq. (10): -sign(v) eta_h g rho_g y_T^2 d.
    static_tangent = 0.0
    if tangent_v > 0.0:
        static_tangent = law.eta_h * g * law.density * depth * depth * diameter / tangent_v
    return drag, static_normal, static_tangent


@compiled
def distributed_resistance(depth, cos_q, length, diameter, cross, normal_v, tangent_v, law, g):
    """The distributed law for one short piece of a rod; arguments as for `lumped_resistance`.

    The static limits are the derivatives of the lumped ones along the axis (dy = cos q ds), taken
    at the middle of the piece's immersed part.
    """
    middle = max(depth - 0.5 * length * cos_q, 0.0)
    drag = law.eta_d * law.density * diameter * length * cross
    weight = g * law.density * diameter * length
    static_normal = 0.0
    if normal_v != 0.0:
        slope = (1.0 + law.exponent) * law.eta_v * (middle / diameter) ** law.exponent
        static_normal = -math.copysign(slope * weight * 0.25 * math.pi * diameter, normal_v)
    static_tangent = 0.0
    if tangent_v > 0.0:
        static_tangent = 2.0 * law.eta_h * weight * middle * cos_q / tangent_v
    return drag, static_normal, static_tangent


@cache
def link_kernel(resistance: Any, probe: Any, scene_dtype: np.dtype) -> Any:
    """The kernel of one form of the law for surfaces with that `probe` (see `Law.kernel`)."""
    scene_records = records(scene_dtype)

    @compiled
    def link_wrenches(table, lead):
        rods = rod_records(table[ELEMENTS], table[ELEMENT_COUNT])
        contacts = contact_records(table[CONTACTS], table[ELEMENT_COUNT])
        bodies = body_records(table[BODIES], table[BODY_COUNT])
        scene = scene_records(table[SCENE], 1)
        law = scene[0].law
        surface = scene[0].surface
        nbody = table[NBODY]
        gravity = floats(table[GRAVITY], 3)
        g = math.sqrt(gravity[0] ** 2 + gravity[1] ** 2 + gravity[2] ** 2)
        xpos = floats(table[XPOS], 3 * nbody)
        xmat = floats(table[XMAT], 9 * nbody)
        xipos = floats(table[XIPOS], 3 * nbody)
        subtree_com = floats(table[SUBTREE_COM], 3 * nbody)

        for slot in range(len(bodies)):
            bodies[slot].wrench[:] = 0.0

        for i in range(len(rods)):
            rod = rods[i]
            contact = contacts[i]
            b = rod.body
            lx, ly, lz = rod.center[0], rod.center[1], rod.center[2]
            cx = xpos[3 * b] + xmat[9 * b] * lx + xmat[9 * b + 1] * ly + xmat[9 * b + 2] * lz
            cy = (
                xpos[3 * b + 1] + xmat[9 * b + 3] * lx + xmat[9 * b + 4] * ly + xmat[9 * b + 5] * lz
            )
            cz = (
                xpos[3 * b + 2] + xmat[9 * b + 6] * lx + xmat[9 * b + 7] * ly + xmat[9 * b + 8] * lz
            )
            lx, ly, lz = rod.axis[0], rod.axis[1], rod.axis[2]
            ux = xmat[9 * b] * lx + xmat[9 * b + 1] * ly + xmat[9 * b + 2] * lz
            uy = xmat[9 * b + 3] * lx + xmat[9 * b + 4] * ly + xmat[9 * b + 5] * lz
            uz = xmat[9 * b + 6] * lx + xmat[9 * b + 7] * ly + xmat[9 * b + 8] * lz
            # T is the deeper end; let the axis point from the midpoint to it.
            half = rod.half_length
            depth, nx, ny, nz = probe(surface, cx + half * ux, cy + half * uy, cz + half * uz)
            other, ox, oy, oz = probe(surface, cx - half * ux, cy - half * uy, cz - half * uz)
            if other > depth:
                depth, nx, ny, nz = other, ox, oy, oz
                ux, uy, uz = -ux, -uy, -uz
            contact.depth = depth
            if depth <= 0.0:
                continue

            length = 2.0 * half
            cos_q = -(ux * nx + uy * ny + uz * nz)
            if depth < length * cos_q:
                length = depth / cos_q
            arm = half - 0.5 * length  # eq. (5): L_CE
            ex, ey, ez = cx + arm * ux, cy + arm * uy, cz + arm * uz

            body = bodies[rod.slot]
            root = 3 * body.root
            px, py, pz = (
                ex - subtree_com[root],
                ey - subtree_com[root + 1],
                ez - subtree_com[root + 2],
            )
            vx, vy, vz = velocity_at(body_velocity(table, b), px, py, pz)
            # Drag takes the velocity ahead, static resistance the direction of the velocity now:
            # led as well, it creeps five times faster under load.
            dx, dy, dz = vx, vy, vz
            if lead != 0.0:
                change = velocity_at(velocity_change(table, body.last_dof, lead), px, py, pz)
                dx, dy, dz = vx + change[0], vy + change[1], vz + change[2]

            normal_v = vx * nx + vy * ny + vz * nz
            tx, ty, tz = vx - normal_v * nx, vy - normal_v * ny, vz - normal_v * nz
            tangent_v = math.sqrt(tx * tx + ty * ty + tz * tz)
            sx, sy, sz = uy * dz - uz * dy, uz * dx - ux * dz, ux * dy - uy * dx
            cross = math.sqrt(sx * sx + sy * sy + sz * sz)

            drag, static_normal, static_tangent = resistance(
                depth, cos_q, length, rod.width, cross, normal_v, tangent_v, law, g
            )
            fx = -drag * dx + static_normal * nx - static_tangent * tx
            fy = -drag * dy + static_normal * ny - static_tangent * ty
            fz = -drag * dz + static_normal * nz - static_tangent * tz

            px, py, pz = ex - xipos[3 * b], ey - xipos[3 * b + 1], ez - xipos[3 * b + 2]
            add_force(body.wrench, fx, fy, fz, px, py, pz)

            contact.length = length
            contact.point[0], contact.point[1], contact.point[2] = ex, ey, ez
            contact.velocity[0], contact.velocity[1], contact.velocity[2] = vx, vy, vz
            contact.force[0], contact.force[1], contact.force[2] = fx, fy, fz

    return link_wrenches
