"""The loop over facets that laws of surface elements share."""

# What belongs to a body is read when its first facet comes, which a type checker cannot follow.
# pyright: reportPossiblyUnboundVariable=false

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
from mjgranular.shape.facets import facet_records

# Below this speed [m/s] an element has no direction of motion. Chosen: far below any motion, far
# above the square root of the smallest number.
_STILL = 1e-150
# A face leads when its normal's share of the motion is above this. Chosen: a face that slides along
# itself has a finite response in RFT, so rounding must not decide whether it leads.
_EDGE = 1e-9


@cache
def facet_kernel(stress: Any, probe: Any, scene_dtype: np.dtype) -> Any:
    """The kernel of a law of surface elements for surfaces with that `probe`.

    Args:
        stress: kernel `stress(law, g, n, v, z) -> (x, y, z)` of the law's record, gravity [m/s^2],
            and unit vectors: outward normal, direction of motion, normal of the surface. Gives the
            resistance for an area and a depth of one [N/m^3].
        probe: the surface's.
        scene_dtype: record of `law` and `surface`. `law` has `inertia`, lambda rho [kg/m^3], and
            `rise`, 1 where the surface behind a turning body is lowered.
    """
    scene_records = records(scene_dtype)

    @compiled
    def facet_wrenches(table, lead):
        facets = facet_records(table[ELEMENTS], table[ELEMENT_COUNT])
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

        slot = -1
        for i in range(len(facets)):
            facet = facets[i]
            if facet.slot != slot:  # facets come body by body
                slot = facet.slot
                body = bodies[slot]
                b = body.body
                ox, oy, oz = xpos[3 * b], xpos[3 * b + 1], xpos[3 * b + 2]
                r0, r1, r2 = xmat[9 * b], xmat[9 * b + 1], xmat[9 * b + 2]
                r3, r4, r5 = xmat[9 * b + 3], xmat[9 * b + 4], xmat[9 * b + 5]
                r6, r7, r8 = xmat[9 * b + 6], xmat[9 * b + 7], xmat[9 * b + 8]
                root = 3 * body.root
                tx, ty, tz = subtree_com[root], subtree_com[root + 1], subtree_com[root + 2]
                ix, iy, iz = xipos[3 * b], xipos[3 * b + 1], xipos[3 * b + 2]
                motion = body_velocity(table, b)
                change = velocity_change(table, body.last_dof, lead)

            lx, ly, lz = facet.point[0], facet.point[1], facet.point[2]
            px = ox + r0 * lx + r1 * ly + r2 * lz
            py = oy + r3 * lx + r4 * ly + r5 * lz
            pz = oz + r6 * lx + r7 * ly + r8 * lz
            depth, zx, zy, zz = probe(surface, px, py, pz)
            contact = contacts[i]
            contact.depth = depth
            if depth <= 0.0:
                continue
            contact.length = 0.0

            lx, ly, lz = facet.normal[0], facet.normal[1], facet.normal[2]
            nx = r0 * lx + r1 * ly + r2 * lz
            ny = r3 * lx + r4 * ly + r5 * lz
            nz = r6 * lx + r7 * ly + r8 * lz
            vx, vy, vz = velocity_at(motion, px - tx, py - ty, pz - tz)
            contact.point[0], contact.point[1], contact.point[2] = px, py, pz
            contact.velocity[0], contact.velocity[1], contact.velocity[2] = vx, vy, vz
            fx, fy, fz = 0.0, 0.0, 0.0
            speed = math.sqrt(vx * vx + vy * vy + vz * vz)
            if speed > _STILL and vx * nx + vy * ny + vz * nz > _EDGE * speed:  # a leading face
                if law.rise != 0.0:
                    depth = lowered(depth, motion, px - ix, py - iy, pz - iz, vx, vy, vz, g)
                s = 1.0 / speed
                sx, sy, sz = stress(law, g, nx, ny, nz, s * vx, s * vy, s * vz, zx, zy, zz)
                gain = depth * facet.area
                fx, fy, fz = gain * sx, gain * sy, gain * sz
            if law.inertia != 0.0:
                cx, cy, cz = velocity_at(change, px - tx, py - ty, pz - tz)
                vn = (vx + cx) * nx + (vy + cy) * ny + (vz + cz) * nz
                if vn > 0.0:
                    gain = law.inertia * vn * vn * facet.area
                    fx -= gain * nx
                    fy -= gain * ny
                    fz -= gain * nz
            contact.force[0], contact.force[1], contact.force[2] = fx, fy, fz

            px, py, pz = px - ix, py - iy, pz - iz
            add_force(body.wrench, fx, fy, fz, px, py, pz)

    return facet_wrenches


@compiled
def lowered(depth, motion, x, y, z, vx, vy, vz, g):
    """Depth below the surface that a turning body has lowered behind itself.

    Agarwal et al. 2021: `r (r w^2 / g)` on the rear half of a wheel; here r is the element's own
    distance from the axis through the body's centre of mass, and the rear half is where the body's
    velocity points away from the element.

    Args:
        depth: below the undisturbed surface [m].
        motion: spatial velocity of the body.
        x: of the element from the body's centre of mass [m]; y, z: likewise.
        y: see x.
        z: see x.
        vx: velocity of the element [m/s]; vy, vz: likewise.
        vy: see vx.
        vz: see vx.
        g: gravity [m/s^2].
    """
    wx, wy, wz = motion[0], motion[1], motion[2]
    # Velocity of the centre of mass, and the part of the element's that is turning.
    tx, ty, tz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
    rear = (vx - tx) * x + (vy - ty) * y + (vz - tz) * z
    if rear >= 0.0 or g == 0.0:
        return depth
    turning = tx * tx + ty * ty + tz * tz  # (r w)^2
    return max(depth - turning / g, 0.0)
