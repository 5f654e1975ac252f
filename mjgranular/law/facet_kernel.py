"""What laws of surface elements compute at every step, for each facet."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache, partial
from typing import Any

from mjgranular.kernel.compiled import compiled
from mjgranular.law.facet_sheets import EDGE, LANES, STILL, facet_sheets, lowered
from mjgranular.law.facet_slope import RAMP, led_slope_kernel, simple_slope_kernel
from mjgranular.law.kernel import LawKernel, grip_of_all, in_world
from mjgranular.law.patch import leading_part, wet_part
from mjgranular.shape.facets import facet_records

# Turn of the direction of motion for the derivative of a stress. Chosen: the square root of the
# precision, and some more for the rounding of a fit of 60 terms.
_TURN = 1e-6
# The numbers of an immersed facet: depth of its deepest point, no length, centre of pressure; its
# normal, that of the surface, both spreads; depth of its middle and rises along both half edges;
# mean depth, area, inertial push.


@cache
def facet_kernel(stress: Any, probe: Any, slope: Any = None, level: Any = None) -> LawKernel:
    """The kernels of a law of surface elements for surfaces with that `probe`.

    Args:
        stress: kernel `stress(law, g, n, v, z) -> (x, y, z)` of the law's record, gravity [m/s^2],
            and unit vectors: outward normal, direction of motion, normal of the surface. Gives the
            resistance for an area and a depth of one [N/m^3].
        probe: the surface's.
        slope: see `RftLaw`.
        level: the surface's, to take facets side by side (`facet_sheets`).

    The law's record has `inertia`, lambda rho [kg/m^3], and `rise`, 1 where the surface behind a
    turning body is lowered.
    """

    @partial(compiled, inline=True)
    def facet_immerse(facet, pose, law, surface, g):
        x, y, z = in_world(pose, facet.point[0], facet.point[1], facet.point[2])
        px, py, pz = pose.position[0] + x, pose.position[1] + y, pose.position[2] + z
        depth, zx, zy, zz = probe(surface, px, py, pz)
        ax, ay, az, bx, by, bz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        h1, h2 = 0.0, 0.0
        deepest = depth
        e1x, e1y, e1z, e2x, e2y, e2z = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if facet.extent > 0.0:  # a patch, not a triangle
            e1x, e1y, e1z = in_world(pose, facet.edges[0, 0], facet.edges[0, 1], facet.edges[0, 2])
            e2x, e2y, e2z = in_world(pose, facet.edges[1, 0], facet.edges[1, 1], facet.edges[1, 2])
            h1 = -(e1x * zx + e1y * zy + e1z * zz)
            h2 = -(e2x * zx + e2y * zy + e2z * zz)
            deepest += abs(h1) + abs(h2)
        if deepest <= 0.0:
            return (
                deepest, 0.0, px, py, pz, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
                0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
            )  # fmt: skip
        middle = depth
        if law.rise != 0.0:
            depth = lowered(depth, pose, px, py, pz, g)
        mean = max(depth, 0.0)
        if facet.extent > 0.0:
            # The force acts at the wet part's centre of pressure.
            mean, s, t = wet_part(depth, h1, h2)
            px, py, pz = px + s * e1x + t * e2x, py + s * e1y + t * e2y, pz + s * e1z + t * e2z
            if mean > 0.0 and middle <= 0.0 and probe(surface, px, py, pz)[0] <= 0.0:
                # The middle is not above the sand but beside it.
                return (
                    middle, 0.0, px, py, pz, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
                    0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
                )  # fmt: skip
            ax, ay, az = in_world(pose, facet.spread[0, 0], facet.spread[0, 1], facet.spread[0, 2])
            bx, by, bz = in_world(pose, facet.spread[1, 0], facet.spread[1, 1], facet.spread[1, 2])
        nx, ny, nz = in_world(pose, facet.normal[0], facet.normal[1], facet.normal[2])
        push = law.inertia * facet.area
        return (
            deepest, 0.0, px, py, pz, nx, ny, nz, zx, zy, zz,
            ax, ay, az, bx, by, bz, depth, h1, h2, mean, facet.area, push,
        )  # fmt: skip

    @partial(compiled, inline=True)
    def facet_resist(facet, law, g, v, d):
        nx, ny, nz, zx, zy, zz, ax, ay, az, bx, by, bz, depth, h1, h2, mean, area, push = facet[5:]
        vx, vy, vz = v
        fx, fy, fz = 0.0, 0.0, 0.0
        speed = math.sqrt(vx * vx + vy * vy + vz * vz)
        if speed > STILL:
            s = 1.0 / speed
            ux, uy, uz = s * vx, s * vy, s * vz
            c = ux * nx + uy * ny + uz * nz
            a = ux * ax + uy * ay + uz * az
            b = ux * bx + uy * by + uz * bz
            load = 0.0
            mx, my, mz = nx, ny, nz
            if c > abs(a) + abs(b) + EDGE:  # leads as a whole, like most facets
                load = mean
            elif c > -abs(a) - abs(b) and (a != 0.0 or b != 0.0):
                load, ls, lt = load_of(depth, h1, h2, mean, c, a, b)
                mx, my, mz = turned(nx, ny, nz, ls, ax, ay, az, lt, bx, by, bz)
                if mx * ux + my * uy + mz * uz <= EDGE:
                    load = 0.0
            if load > 0.0:
                sx, sy, sz = stress(law, g, mx, my, mz, ux, uy, uz, zx, zy, zz)
                gain = load * area
                fx, fy, fz = gain * sx, gain * sy, gain * sz
        if push != 0.0:
            vn = d[0] * nx + d[1] * ny + d[2] * nz
            if vn > 0.0:
                fx -= push * vn * vn * nx
                fy -= push * vn * vn * ny
                fz -= push * vn * vn * nz
        return fx, fy, fz

    @partial(compiled, inline=True)
    def led_stress(facet, law, g, ux, uy, uz):
        """Force on a facet for a direction of motion, what leads growing over a ramp [N]."""
        nx, ny, nz = facet[5], facet[6], facet[7]
        ax, ay, az = facet[11], facet[12], facet[13]
        bx, by, bz = facet[14], facet[15], facet[16]
        c = ux * nx + uy * ny + uz * nz
        a = ux * ax + uy * ay + uz * az
        b = ux * bx + uy * by + uz * bz
        if abs(a) + abs(b) < RAMP:
            a = math.copysign(RAMP - abs(b), a)
        load, ls, lt = load_of(facet[17], facet[18], facet[19], facet[20], c, a, b)
        nx, ny, nz = turned(nx, ny, nz, ls, ax, ay, az, lt, bx, by, bz)
        sx, sy, sz = stress(law, g, nx, ny, nz, ux, uy, uz, facet[8], facet[9], facet[10])
        gain = load * facet[21]
        if gain <= 0.0:  # of what does not lead there need be no stress, not even a number
            sx, sy, sz = 0.0, 0.0, 0.0
        # The fit describes faces that lead; on the ramp it is asked for some that just do not.
        power = max(sx * ux + sy * uy + sz * uz, 0.0)
        return gain * (sx - power * ux), gain * (sy - power * uy), gain * (sz - power * uz)

    @partial(compiled, inline=True)
    def turning_stress(facet, law, g, ux, uy, uz, size):
        """`size` times `led_stress` S(u), and times the derivative of |p| S(p / |p|) by p.

        That is S along u, its turn across. From two small turns, for a law without a slope.
        """
        sx, sy, sz = led_stress(facet, law, g, ux, uy, uz)
        ax, ay, az = across(ux, uy, uz)
        bx, by, bz = uy * az - uz * ay, uz * ax - ux * az, ux * ay - uy * ax
        mx, my, mz = led_stress(facet, law, g, ux + _TURN * ax, uy + _TURN * ay, uz + _TURN * az)
        tx, ty, tz = led_stress(facet, law, g, ux + _TURN * bx, uy + _TURN * by, uz + _TURN * bz)
        t = size / _TURN
        mx, my, mz = t * (mx - sx), t * (my - sy), t * (mz - sz)
        tx, ty, tz = t * (tx - sx), t * (ty - sy), t * (tz - sz)
        sx, sy, sz = size * sx, size * sy, size * sz
        return (
            sx, sy, sz,
            sx * ux + mx * ax + tx * bx, sx * uy + mx * ay + tx * by, sx * uz + mx * az + tx * bz,
            sy * ux + my * ax + ty * bx, sy * uy + my * ay + ty * by, sy * uz + my * az + ty * bz,
            sz * ux + mz * ax + tz * bx, sz * uy + mz * ay + tz * by, sz * uz + mz * az + tz * bz,
        )  # fmt: skip

    led_slope = turning_stress if slope is None else led_slope_kernel(slope)
    simple_slope: Any = None if slope is None else simple_slope_kernel(slope)

    @partial(compiled, inline=True)
    def facet_simple(facet, p):
        """Whether a facet leads as a whole or not at all; also where there is no grip at all."""
        px, py, pz = p
        c = px * facet[5] + py * facet[6] + pz * facet[7]
        a = px * facet[11] + py * facet[12] + pz * facet[13]
        b = px * facet[14] + py * facet[15] + pz * facet[16]
        ramp = RAMP * math.sqrt(px * px + py * py + pz * pz)
        return abs(c) >= max(abs(a) + abs(b), ramp)

    @partial(compiled, inline=True)
    def facet_respond(facet, law, g, v, p, eps):
        size, ux, uy, uz = direction(p)
        scale = softened(v, eps)
        stress = led_slope(facet, law, g, ux, uy, uz, scale)
        return answer_to(facet, stress, size, v, p, scale)

    @partial(compiled, inline=True)
    def facet_respond_simple(facet, law, g, v, p, eps):
        size, ux, uy, uz = direction(p)
        scale = softened(v, eps)
        stress = simple_slope(facet, law, g, ux, uy, uz, scale)
        return answer_to(facet, stress, size, v, p, scale)

    kernel = LawKernel(
        facet_records,
        facet_immerse,
        facet_resist,
        facet_respond,
        grip_of_all,
        numbers=18,
        lanes=LANES,
        simple=None if slope is None else facet_simple,
        respond_simple=None if slope is None else facet_respond_simple,
    )
    if level is None:
        return kernel
    return replace(kernel, level=level, sheets=facet_sheets(stress, facet_resist))


@partial(compiled, inline=True)
def direction(p):
    """Size of a grip, and its direction; no grip is as good as none at all along z."""
    px, py, pz = p
    size = math.sqrt(px * px + py * py + pz * pz)
    if size > STILL:
        scale = 1.0 / size
        return size, scale * px, scale * py, scale * pz
    return 0.0, 0.0, 0.0, 1.0


@partial(compiled, inline=True)
def softened(v, eps):
    """What makes a velocity a grip [s/m]: 1 / sqrt(v^2 + eps^2)."""
    return 1.0 / math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + eps * eps)


@partial(compiled, inline=True)
def answer_to(facet, stress, size, v, p, scale):
    """What a facet's `respond` gives.

    Args:
        facet: its numbers.
        stress: S(u) along the grip's direction, and the derivative of |p| S(p / |p|) by p, both
            times `scale`.
        size: of the grip.
        v: velocity [m/s].
        p: grip.
        scale: `softened`.
    """
    nx, ny, nz, push = facet[5], facet[6], facet[7], facet[22]
    vx, vy, vz = v
    px, py, pz = p
    sx, sy, sz, k0, k1, k2, k3, k4, k5, k6, k7, k8 = stress
    wx, wy, wz = scale * vx, scale * vy, scale * vz
    # Also where p feels nothing: what trails by its grip may lead by its velocity.
    dx, dy, dz = wx - px, wy - py, wz - pz
    bend = dx * dx + dy * dy + dz * dz
    if size == 0.0:  # S is not known: nobody asked in a direction
        k0, k1, k2, k3, k4, k5, k6, k7, k8 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    # p is to become w = v / sqrt(v^2 + eps^2): the force then, and minus its derivative.
    fx = k0 * vx + k1 * vy + k2 * vz
    fy = k3 * vx + k4 * vy + k5 * vz
    fz = k6 * vx + k7 * vy + k8 * vz
    sx, sy, sz = size * sx, size * sy, size * sz
    vn = max(vx * nx + vy * ny + vz * nz, 0.0)
    inertial = push * vn
    along = inertial * vn
    inertial *= 2.0
    ix, iy, iz = inertial * nx, inertial * ny, inertial * nz
    xy, yz, zx = ix * ny, iy * nz, iz * nx
    return (
        fx - along * nx, fy - along * ny, fz - along * nz,
        sx * wx - k0 + ix * nx, sx * wy - k1 + xy, sx * wz - k2 + zx,
        sy * wx - k3 + xy, sy * wy - k4 + iy * ny, sy * wz - k5 + yz,
        sz * wx - k6 + zx, sz * wy - k7 + yz, sz * wz - k8 + iz * nz,
        bend,
    )  # fmt: skip


@partial(compiled, inline=True)
def load_of(depth, h1, h2, mean, c, a, b):
    """Mean depth of what leads of a facet, over the whole facet, and the centroid of that part.

    The part that leads is replaced by a parallelogram around its centroid, narrowed by the distance
    of that from the middle (`patch`).
    """
    share, ls, lt = leading_part(c, a, b)
    if share == 1.0:
        return mean, 0.0, 0.0
    if share == 0.0:
        return 0.0, 0.0, 0.0
    if h1 == 0.0 and h2 == 0.0:
        return share * max(depth, 0.0), ls, lt
    f1, f2 = 1.0 - abs(ls), 1.0 - abs(lt)
    wet, _, _ = wet_part(depth + ls * h1 + lt * h2, f1 * h1, f2 * h2)
    return share * wet, ls, lt


@partial(compiled, inline=True)
def turned(nx, ny, nz, s, ax, ay, az, t, bx, by, bz):
    """A facet's unit normal at (s, t), with the spreads a and b of its normal."""
    nx, ny, nz = nx + s * ax + t * bx, ny + s * ay + t * by, nz + s * az + t * bz
    scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
    return scale * nx, scale * ny, scale * nz


@partial(compiled, inline=True)
def across(x, y, z):
    """A unit vector across a unit vector."""
    if abs(x) < 0.7:
        s = 1.0 / math.sqrt(y * y + z * z)
        return 0.0, s * z, -s * y
    s = 1.0 / math.sqrt(x * x + z * z)
    return -s * z, 0.0, s * x
