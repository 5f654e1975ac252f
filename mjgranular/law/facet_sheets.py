"""Facets side by side under a plane of sand: which are in it, how, and what resists them.

What `facet_kernel` does for one facet under any surface is done here for a sheet of facets of one
body (`law.kernel.Sheets`). Under a plane depth is linear in the coordinates: it is taken in the
body's frame, and only what the law needs is turned into the world's.

Loops over lanes are of a fixed length and of arithmetic alone: the compiler makes vector
instructions of them, and works out both sides of every branch for all lanes. What most sheets have
no need of is asked for once a sheet.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.lanes import aligned, choose, count_of, rows
from mjgranular.kernel.memory import column, held
from mjgranular.law.kernel import Sheets, in_world
from mjgranular.law.patch import wet_part

LANES = 8
# Below this speed [m/s] an element has no direction of motion. Chosen: far below any motion, far
# above the square root of the smallest number.
STILL = 1e-150
# A face leads when its normal's share of the motion is above this. Chosen: a face that slides along
# itself has a finite response in RFT, so rounding must not decide whether it leads.
EDGE = 1e-9
_ROUNDED = 1.0 + 1e-12  # what is beyond a bound by more is so however it is rounded; chosen
_THIRD = 1.0 / 3.0

# The rows of a sheet, by the fields of the facets. On facets without an area there is no force.
_COLUMNS = ("point", "edges", "normal", "spread", "area")
_POINT, _EDGES, _NORMAL, _SPREAD, _AREA, _ROWS = 0, 3, 9, 12, 18, 19
# Those numbers of an immersed facet that are known before the others (`facet_kernel`).
_DEEPEST, _CENTRE, _DEPTH, _MEAN = 0, 2, 17, 20


def lay_facets(facets: np.ndarray) -> np.ndarray:
    """The sheets of facets (`Sheets.lay`)."""
    rows = np.column_stack([facets[name].reshape(len(facets), -1) for name in _COLUMNS])
    sheets = [np.zeros((0, _ROWS, LANES))]
    for count in np.bincount(facets["slot"]):
        mine, rows = rows[:count], rows[count:]
        room = np.repeat(mine[-1:], -count % LANES, axis=0)
        room[:, _AREA] = 0.0
        sheets.append(np.concatenate([mine, room]).reshape(-1, LANES, _ROWS).transpose(0, 2, 1))
    return aligned(np.concatenate(sheets))


_read_immersed = column(23, LANES).read
_read_three, _write_three = column(3, LANES).read, column(3, LANES).write
_rows_of_one, _rows_of_two, _rows_of_three = (rows(count, LANES) for count in (1, 2, 3))
_look_one = _rows_of_one.read
_look_three, _look_six = _rows_of_three.read, rows(6, LANES).read
_put_one, _put_two, _put_three = _rows_of_one.write, _rows_of_two.write, _rows_of_three.write
_put_all = rows(15, LANES).write


@partial(compiled, inline=True)
def reach_down(sheet, level):
    """Depths of facets' middles [m], and their rises along both half edges."""
    nx, ny, nz, origin = level
    px, py, pz = _look_three(sheet, _POINT * LANES)
    ax, ay, az, bx, by, bz = _look_six(sheet, _EDGES * LANES)
    middle = origin - (nx * px + ny * py + nz * pz)
    return middle, -(nx * ax + ny * ay + nz * az), -(nx * bx + ny * by + nz * bz)


@compiled
def skim_facets(sheet, level, depths):
    """See `Sheets.skim`."""
    middle, h1, h2 = reach_down(sheet, level)
    deepest = middle + abs(h1) + abs(h2)
    _put_one(depths, 0, (deepest,))
    return LANES - count_of(deepest <= 0.0)


@cache
def immersion(first: int) -> Any:
    """See `Sheets.immerse`; the numbers are those of `facet_kernel`."""

    @compiled
    def lower(sheet, pose, g, block):
        """Takes off the depths of middles by how a turning body lowers the surface behind it."""
        px, py, pz = pose.position
        for lane in range(LANES):
            x, y, z = _read_three(sheet, _POINT * LANES + lane)
            x, y, z = in_world(pose, x, y, z)
            depth = block[first + _DEPTH * LANES + lane]
            depth = lowered(depth, pose, px + x, py + y, pz + z, g)
            block[first + _DEPTH * LANES + lane] = depth

    @compiled
    def immerse_facets(sheet, pose, level, up, law, g, block):
        depth, h1, h2 = reach_down(sheet, level)
        reach = abs(h1) + abs(h2)
        deepest = depth + reach
        _put_two(block, first, (deepest, 0.0))
        _put_three(block, first + _DEPTH * LANES, (depth, h1, h2))
        if law.rise != 0.0:
            lower(sheet, pose, g, block)
            depth, h1, h2 = _look_three(block, first + _DEPTH * LANES)
        if count_of(depth >= reach) == LANES and count_of(depth > 0.0) == LANES:
            # In the sand as a whole, like most.
            scale = _THIRD / depth
            mean, s, t = depth, h1 * scale, h2 * scale
        else:
            mean, s, t = wet_part(depth, h1, h2)
        _put_one(block, first + _MEAN * LANES, (mean,))
        px, py, pz = _look_three(sheet, _POINT * LANES)
        ax, ay, az, bx, by, bz = _look_six(sheet, _EDGES * LANES)
        # The force acts at the wet part's centre of pressure.
        x, y, z = in_world(
            pose, px + (s * ax + t * bx), py + (s * ay + t * by), pz + (s * az + t * bz)
        )
        ox, oy, oz = pose.position
        nx, ny, nz = _look_three(sheet, _NORMAL * LANES)
        nx, ny, nz = in_world(pose, nx, ny, nz)
        ax, ay, az, bx, by, bz = _look_six(sheet, _SPREAD * LANES)
        ax, ay, az = in_world(pose, ax, ay, az)
        bx, by, bz = in_world(pose, bx, by, bz)
        zx, zy, zz = up
        _put_all(
            block,
            first + _CENTRE * LANES,
            (ox + x, oy + y, oz + z, nx, ny, nz, zx, zy, zz, ax, ay, az, bx, by, bz),
        )
        (area,) = _look_one(sheet, _AREA * LANES)
        push = choose(deepest <= 0.0, 0.0, law.inertia * area)
        _put_two(block, first + (_MEAN + 1) * LANES, (area, push))

    return immerse_facets


@cache
def facet_sheets(stress: Any, resist: Any) -> Sheets:
    """The kernels of a law of surface elements for sheets of them.

    Args:
        stress: see `facet_kernel`.
        resist: kernel `resist(immersed, law, g, v, d)` for any facet.
    """

    @partial(compiled, inline=True)
    def resist_simple(facet, law, g, v, d):
        """The same for a facet that leads as a whole or not at all."""
        nx, ny, nz, mean, area, push = (
            facet[5], facet[6], facet[7], facet[20], facet[21], facet[22],
        )  # fmt: skip
        vx, vy, vz = v
        speed = math.sqrt(vx * vx + vy * vy + vz * vz)
        scale = 1.0 / speed if speed > STILL else 0.0
        ux, uy, uz = scale * vx, scale * vy, scale * vz
        gain = mean * area
        fx, fy, fz = stress(law, g, nx, ny, nz, ux, uy, uz, facet[8], facet[9], facet[10])
        fx, fy, fz = gain * fx, gain * fy, gain * fz
        if ux * nx + uy * ny + uz * nz <= EDGE or gain <= 0.0:
            fx, fy, fz = 0.0, 0.0, 0.0  # there need be no stress, not even a number
        vn = max(d[0] * nx + d[1] * ny + d[2] * nz, 0.0)
        inertial = push * vn * vn
        return fx - inertial * nx, fy - inertial * ny, fz - inertial * nz

    @cache
    def resistance(first: int, velocity: int, drag: int, force: int) -> Any:
        @compiled
        def resist_facets(block, record, g):
            law = held(record)
            others, pushed = 0, 0
            for lane in range(LANES):
                facet = _read_immersed(block, first + lane)
                vx, vy, vz = _read_three(block, velocity + lane)
                c = vx * facet[5] + vy * facet[6] + vz * facet[7]
                a = vx * facet[11] + vy * facet[12] + vz * facet[13]
                b = vx * facet[14] + vy * facet[15] + vz * facet[16]
                reach = abs(a) + abs(b)
                size = abs(vx) + abs(vy) + abs(vz)
                flat = reach == 0.0
                whole = flat or c > reach * _ROUNDED + 2.0 * EDGE * size
                trails = c < -reach * _ROUNDED or facet[20] <= 0.0
                others += 0 if whole or trails else 1
                pushed += 0 if trails and facet[22] == 0.0 else 1
            if pushed == 0:
                for lane in range(LANES):
                    _write_three(block, force + lane, (0.0, 0.0, 0.0))
            elif others == 0:
                for lane in range(LANES):
                    facet = _read_immersed(block, first + lane)
                    v = _read_three(block, velocity + lane)
                    d = _read_three(block, drag + lane)
                    _write_three(block, force + lane, resist_simple(facet, law, g, v, d))
            else:
                for lane in range(LANES):
                    facet = _read_immersed(block, first + lane)
                    v = _read_three(block, velocity + lane)
                    d = _read_three(block, drag + lane)
                    _write_three(block, force + lane, resist(facet, law, g, v, d))

        return resist_facets

    return Sheets(lay_facets, _ROWS, skim_facets, immersion, resistance)


@compiled
def lowered(depth, pose, x, y, z, g):
    """Depth below the surface that a turning body has lowered behind itself.

    Agarwal et al. 2021: `r (r w^2 / g)` on the rear half of a wheel; here r is the element's own
    distance from the axis through the body's centre of mass, and the rear half is where the body's
    velocity points away from the element.

    Args:
        depth: below the undisturbed surface [m].
        pose: of the body.
        x: of the element [m], world; y, z: likewise.
        y: see x.
        z: see x.
        g: gravity [m/s^2].
    """
    wx, wy, wz, lx, ly, lz = pose.motion
    # From the axis to the element; velocity of the centre of mass, and the element's about it.
    rx, ry, rz = x - pose.com[0], y - pose.com[1], z - pose.com[2]
    cx, cy, cz = pose.com[0] - pose.tree[0], pose.com[1] - pose.tree[1], pose.com[2] - pose.tree[2]
    tx, ty, tz = wy * rz - wz * ry, wz * rx - wx * rz, wx * ry - wy * rx
    vx, vy, vz = lx + wy * cz - wz * cy, ly + wz * cx - wx * cz, lz + wx * cy - wy * cx
    if vx * rx + vy * ry + vz * rz >= 0.0 or g == 0.0:
        return depth
    turning = tx * tx + ty * ty + tz * tz  # (r w)^2
    return depth - turning / g
