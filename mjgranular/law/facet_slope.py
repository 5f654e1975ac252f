"""Force on a facet and its derivative by the direction of motion, in closed form.

A stress that knows the outward normal n, the direction of motion u and the normal of the surface z
lies in their span, `s (alpha n + beta u + gamma z)`, and the factors depend on the cosines between
the three alone. So a law that gives the factors with their nine partial derivatives (its `slope`)
gives everything. The rest is a facet's own: what leads of it has a load and a centroid, and so a
normal, that change with u (`patch_slope`).

The derivative is put together from few columns, each times the gradient of one number,

    dS/du = sum of column x gradient,

for the cosines u.z and n'.u and for the two ratios that say what leads.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from mjgranular.kernel.compiled import compiled
from mjgranular.law.patch_slope import leading_slope, wet_slope

# Where the velocity at the end of a step is sought, a flat face begins to lead over directions
# within this sine of its plane on either side. Chosen: the search needs a slope where the law
# jumps.
RAMP = 0.05


@partial(compiled, inline=True)
def dissipative(factors, rise, lead):
    """Factors of a stress, and their derivatives, with what of it would push the facet on cut off.

    The fit describes faces that lead; on the ramp it is asked for some that just do not.

    Args:
        factors: what a `slope` gives.
        rise: u.z.
        lead: n.u.
    """
    s, n, u, z, n_r, u_r, z_r, n_d, u_d, z_d, n_l, u_l, z_l = factors
    against = -(n * lead + z * rise)
    if u > against:
        u = against
        u_r, u_d = -(n_r * lead + z_r * rise + z), -(n_d * lead + z_d * rise)
        u_l = -(n_l * lead + z_l * rise + n)
    return s, n, u, z, n_r, u_r, z_r, n_d, u_d, z_d, n_l, u_l, z_l


def led_slope_kernel(slope: Any) -> Any:
    """Makes a kernel `led_slope(facet, law, g, ux, uy, uz, size)`: `size` times force S and slope.

    That is what `facet_kernel`'s `turning_stress` gives: S(u), and the derivative of |p| S(p / |p|)
    by p, row by row.

    Args:
        slope: the law's, see `RftLaw`.
    """

    @partial(compiled, inline=True)
    def led_slope(facet, law, g, ux, uy, uz, size):
        nx, ny, nz = facet[5], facet[6], facet[7]
        zx, zy, zz = facet[8], facet[9], facet[10]
        c = ux * nx + uy * ny + uz * nz
        ax, ay, az = facet[11], facet[12], facet[13]
        bx, by, bz = facet[14], facet[15], facet[16]
        a = ux * ax + uy * ay + uz * az
        b = ux * bx + uy * by + uz * bz
        s, t = math.copysign(1.0, a), math.copysign(1.0, b)
        # h and k: the larger and the smaller of both sizes; x = c/h, y = k/h.
        a_size, b_size = abs(a), abs(b)
        ramp = a_size + b_size < RAMP
        first = RAMP - b_size if ramp else a_size
        swap = first < b_size
        h, k = max(first, b_size), min(first, b_size)
        share, lh, lk, share_x, share_y, h_x, h_y, k_x, k_y, per_h = leading_slope(c, h, k)
        la, la_x, la_y = (lk, k_x, k_y) if swap else (lh, h_x, h_y)
        lb, lb_x, lb_y = (lh, h_x, h_y) if swap else (lk, k_x, k_y)
        h1, h2 = facet[18], facet[19]
        rise_a, rise_b = (1.0 - la) * h1, (1.0 - lb) * h2
        la, la_x, la_y = s * la, s * la_x, s * la_y
        lb, lb_x, lb_y = t * lb, t * lb_x, t * lb_y
        wet, wet_d, wet_a, wet_b = wet_slope(facet[17] + la * h1 + lb * h2, rise_a, rise_b)
        wet_a, wet_b = share * h1 * (wet_d - s * wet_a), share * h2 * (wet_d - t * wet_b)
        load = share * wet
        load_x = share_x * wet + wet_a * la_x + wet_b * lb_x
        load_y = share_y * wet + wet_a * la_y + wet_b * lb_y

        mx, my, mz = nx + la * ax + lb * bx, ny + la * ay + lb * by, nz + la * az + lb * bz
        scale = 1.0 / math.sqrt(mx * mx + my * my + mz * mz)
        mx, my, mz = scale * mx, scale * my, scale * mz
        rise = ux * zx + uy * zy + uz * zz
        down = mx * zx + my * zy + mz * zz
        lead = mx * ux + my * uy + mz * uz
        strength, n, u, z, n_r, u_r, z_r, n_d, u_d, z_d, n_l, u_l, z_l = dissipative(
            slope(law, g, rise, down, lead), rise, lead
        )
        strength *= facet[21] * size
        gain = strength * load
        # What turning towards a spread does to the normal along itself, to n'.z and to n'.u.
        an = scale * (ax * mx + ay * my + az * mz)
        bn = scale * (bx * mx + by * my + bz * mz)
        ad = scale * (ax * zx + ay * zy + az * zz) - an * down
        bd = scale * (bx * zx + by * zy + bz * zz) - bn * down
        al, bl = scale * a - an * lead, scale * b - bn * lead

        load_x, load_y = strength * load_x, strength * load_y
        n_x, u_x, z_x = load_x * n, load_x * u, load_x * z
        n_y, u_y, z_y = load_y * n, load_y * u, load_y * z
        n, u, z = gain * n, gain * u, gain * z
        n_d, u_d, z_d = gain * n_d, gain * u_d, gain * z_d
        n_l, u_l, z_l = gain * n_l, gain * u_l, gain * z_l
        # Columns of the ratios x and y.
        dl, dd, dn = al * la_x + bl * lb_x, ad * la_x + bd * lb_x, an * la_x + bn * lb_x
        n_x, u_x = n_x + n_l * dl + n_d * dd - n * dn, u_x + u_l * dl + u_d * dd
        z_x += z_l * dl + z_d * dd
        dl, dd, dn = al * la_y + bl * lb_y, ad * la_y + bd * lb_y, an * la_y + bn * lb_y
        n_y, u_y = n_y + n_l * dl + n_d * dd - n * dn, u_y + u_l * dl + u_d * dd
        z_y += z_l * dl + z_d * dd
        turn = n * scale
        la_x, lb_x, la_y, lb_y = turn * la_x, turn * lb_x, turn * la_y, turn * lb_y
        x1 = n_x * mx + u_x * ux + z_x * zx + la_x * ax + lb_x * bx
        x2 = n_x * my + u_x * uy + z_x * zy + la_x * ay + lb_x * by
        x3 = n_x * mz + u_x * uz + z_x * zz + la_x * az + lb_x * bz
        y1 = n_y * mx + u_y * ux + z_y * zx + la_y * ax + lb_y * bx
        y2 = n_y * my + u_y * uy + z_y * zy + la_y * ay + lb_y * by
        y3 = n_y * mz + u_y * uz + z_y * zz + la_y * az + lb_y * bz
        # Their gradients, across u, from those of c, h and k: n, and spreads with a sign.
        x, y = c * per_h, k * per_h
        first_h, first_k = (0.0, s) if swap else (s, 0.0)
        second_h, second_k = (t, 0.0) if swap else (0.0, t)
        if ramp:  # |a| = RAMP - |b|
            first_h, first_k = 0.0, 0.0
            second_h, second_k = (t, -t) if swap else (-t, t)
        xa, xb = -x * first_h, -x * second_h
        ya, yb = first_k - y * first_h, second_k - y * second_h
        gx, gy, gz = nx + xa * ax + xb * bx, ny + xa * ay + xb * by, nz + xa * az + xb * bz
        ex, ey, ez = ya * ax + yb * bx, ya * ay + yb * by, ya * az + yb * bz
        gu, eu = c + xa * a + xb * b, ya * a + yb * b
        gx, gy, gz = per_h * (gx - gu * ux), per_h * (gy - gu * uy), per_h * (gz - gu * uz)
        ex, ey, ez = per_h * (ex - eu * ux), per_h * (ey - eu * uy), per_h * (ez - eu * uz)

        sx, sy, sz, d0, d1, d2, d3, d4, d5, d6, d7, d8 = plate_slope(
            gain, n, u, z, (n_r, u_r, z_r), (n_l, u_l, z_l),
            (mx, my, mz), (ux, uy, uz), (zx, zy, zz), rise, lead,
        )  # fmt: skip
        d0, d1, d2 = d0 + x1 * gx + y1 * ex, d1 + x1 * gy + y1 * ey, d2 + x1 * gz + y1 * ez
        d3, d4, d5 = d3 + x2 * gx + y2 * ex, d4 + x2 * gy + y2 * ey, d5 + x2 * gz + y2 * ez
        d6, d7, d8 = d6 + x3 * gx + y3 * ex, d7 + x3 * gy + y3 * ey, d8 + x3 * gz + y3 * ez
        if gain <= 0.0:  # of what does not lead there need be no stress, not even a number
            sx, sy, sz = 0.0, 0.0, 0.0
            d0, d1, d2, d3, d4, d5, d6, d7, d8 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        return sx, sy, sz, d0, d1, d2, d3, d4, d5, d6, d7, d8

    return led_slope


def simple_slope_kernel(slope: Any) -> Any:
    """The same for a facet that leads as a whole or not at all, on small turns too.

    Args:
        slope: the law's, see `RftLaw`.
    """

    @partial(compiled, inline=True)
    def simple_slope(facet, law, g, ux, uy, uz, size):
        nx, ny, nz = facet[5], facet[6], facet[7]
        zx, zy, zz = facet[8], facet[9], facet[10]
        rise = ux * zx + uy * zy + uz * zz
        down = nx * zx + ny * zy + nz * zz
        lead = nx * ux + ny * uy + nz * uz
        strength, n, u, z, n_r, u_r, z_r, _, _, _, n_l, u_l, z_l = dissipative(
            slope(law, g, rise, down, lead), rise, lead
        )
        gain = strength * facet[20] * facet[21] * size
        sx, sy, sz, d0, d1, d2, d3, d4, d5, d6, d7, d8 = plate_slope(
            gain, gain * n, gain * u, gain * z,
            (n_r, u_r, z_r), (gain * n_l, gain * u_l, gain * z_l),
            (nx, ny, nz), (ux, uy, uz), (zx, zy, zz), rise, lead,
        )  # fmt: skip
        if lead <= 0.0:  # there need be no stress, not even a number
            sx, sy, sz = 0.0, 0.0, 0.0
            d0, d1, d2, d3, d4, d5, d6, d7, d8 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        return sx, sy, sz, d0, d1, d2, d3, d4, d5, d6, d7, d8

    return simple_slope


@partial(compiled, inline=True)
def plate_slope(gain, n, u, z, by_rise, by_lead, normal, motion, up, rise, lead):
    """Force S = n N + u U + z Z, N, U and Z the three directions, and |p| S(p / |p|) by p.

    As if the normal N were fixed.

    Args:
        gain: what the derivatives of the factors by U.Z are to be multiplied with.
        n: factor of the normal [N].
        u: factor of the direction of motion [N].
        z: factor of the surface's normal [N].
        by_rise: derivatives of the three by U.Z, without the gain.
        by_lead: their derivatives by N.U [N].
        normal: N.
        motion: U.
        up: Z.
        rise: U.Z.
        lead: N.U.
    """
    n_r, u_r, z_r = by_rise
    n_l, u_l, z_l = by_lead
    nx, ny, nz = normal
    ux, uy, uz = motion
    zx, zy, zz = up
    fx, fy, fz = n * nx + z * zx, n * ny + z * zy, n * nz + z * zz  # S - u U
    n_r, u_r, z_r = gain * n_r, gain * u_r, gain * z_r
    rx, ry, rz = (
        n_r * nx + u_r * ux + z_r * zx,
        n_r * ny + u_r * uy + z_r * zy,
        n_r * nz + u_r * uz + z_r * zz,
    )
    lx, ly, lz = (
        n_l * nx + u_l * ux + z_l * zx,
        n_l * ny + u_l * uy + z_l * zy,
        n_l * nz + u_l * uz + z_l * zz,
    )
    # Gradients of U.Z and N.U, across U.
    tx, ty, tz = zx - rise * ux, zy - rise * uy, zz - rise * uz
    ex, ey, ez = nx - lead * ux, ny - lead * uy, nz - lead * uz
    return (
        fx + u * ux, fy + u * uy, fz + u * uz,
        fx * ux + rx * tx + lx * ex + u, fx * uy + rx * ty + lx * ey, fx * uz + rx * tz + lx * ez,
        fy * ux + ry * tx + ly * ex, fy * uy + ry * ty + ly * ey + u, fy * uz + ry * tz + ly * ez,
        fz * ux + rz * tx + lz * ex, fz * uy + rz * ty + lz * ey, fz * uz + rz * tz + lz * ez + u,
    )  # fmt: skip
