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
    """Makes a kernel `led_slope(facet, law, g, ux, uy, uz)`, see `facet_kernel`'s `turning_stress`.

    Args:
        slope: the law's.
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
        # h and k: the larger and the smaller of both sizes; x = c/h, r = k/h.
        a_size, b_size = abs(a), abs(b)
        ramp = a_size + b_size < RAMP
        first = RAMP - b_size if ramp else a_size
        swap = first < b_size
        h, k = max(first, b_size), min(first, b_size)
        share, lh, lk, share_x, share_r, h_x, h_r, k_x, k_r, per_h = leading_slope(c, h, k)
        la, la_x, la_r = (lk, k_x, k_r) if swap else (lh, h_x, h_r)
        lb, lb_x, lb_r = (lh, h_x, h_r) if swap else (lk, k_x, k_r)
        h1, h2 = facet[18], facet[19]
        rise_a, rise_b = (1.0 - la) * h1, (1.0 - lb) * h2
        la, la_x, la_r = s * la, s * la_x, s * la_r
        lb, lb_x, lb_r = t * lb, t * lb_x, t * lb_r
        wet, wet_d, wet_a, wet_b = wet_slope(facet[17] + la * h1 + lb * h2, rise_a, rise_b)
        wet_a, wet_b = share * h1 * (wet_d - s * wet_a), share * h2 * (wet_d - t * wet_b)
        load = share * wet
        load_x = share_x * wet + wet_a * la_x + wet_b * lb_x
        load_r = share_r * wet + wet_a * la_r + wet_b * lb_r

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

        load_x, load_r = strength * load_x, strength * load_r
        n_x, u_x, z_x = load_x * n, load_x * u, load_x * z
        n_k, u_k, z_k = load_r * n, load_r * u, load_r * z
        n, u, z = gain * n, gain * u, gain * z
        n_d, u_d, z_d = gain * n_d, gain * u_d, gain * z_d
        n_l, u_l, z_l = gain * n_l, gain * u_l, gain * z_l
        # Columns of the ratios x and r.
        dl, dd, dn = al * la_x + bl * lb_x, ad * la_x + bd * lb_x, an * la_x + bn * lb_x
        n_x, u_x = n_x + n_l * dl + n_d * dd - n * dn, u_x + u_l * dl + u_d * dd
        z_x += z_l * dl + z_d * dd
        dl, dd, dn = al * la_r + bl * lb_r, ad * la_r + bd * lb_r, an * la_r + bn * lb_r
        n_k, u_k = n_k + n_l * dl + n_d * dd - n * dn, u_k + u_l * dl + u_d * dd
        z_k += z_l * dl + z_d * dd
        turn = n * scale
        la_x, lb_x, la_r, lb_r = turn * la_x, turn * lb_x, turn * la_r, turn * lb_r
        xx = n_x * mx + u_x * ux + z_x * zx + la_x * ax + lb_x * bx
        xy = n_x * my + u_x * uy + z_x * zy + la_x * ay + lb_x * by
        xz = n_x * mz + u_x * uz + z_x * zz + la_x * az + lb_x * bz
        rx = n_k * mx + u_k * ux + z_k * zx + la_r * ax + lb_r * bx
        ry = n_k * my + u_k * uy + z_k * zy + la_r * ay + lb_r * by
        rz = n_k * mz + u_k * uz + z_k * zz + la_r * az + lb_r * bz
        # Their gradients, across u, from those of c, h and k: n, and spreads with a sign.
        x, r = c * per_h, k * per_h
        first_h, first_k = (0.0, s) if swap else (s, 0.0)
        second_h, second_k = (t, 0.0) if swap else (0.0, t)
        if ramp:  # |a| = RAMP - |b|
            first_h, first_k = 0.0, 0.0
            second_h, second_k = (t, -t) if swap else (-t, t)
        xa, xb = -x * first_h, -x * second_h
        ra, rb = first_k - r * first_h, second_k - r * second_h
        gx, gy, gz = nx + xa * ax + xb * bx, ny + xa * ay + xb * by, nz + xa * az + xb * bz
        ex, ey, ez = ra * ax + rb * bx, ra * ay + rb * by, ra * az + rb * bz
        gu, eu = c + xa * a + xb * b, ra * a + rb * b
        gx, gy, gz = per_h * (gx - gu * ux), per_h * (gy - gu * uy), per_h * (gz - gu * uz)
        ex, ey, ez = per_h * (ex - eu * ux), per_h * (ey - eu * uy), per_h * (ez - eu * uz)

        sx, sy, sz, d0, d1, d2, d3, d4, d5, d6, d7, d8 = plate_slope(
            gain, n, u, z, n_r, u_r, z_r, n_l, u_l, z_l,
            mx, my, mz, ux, uy, uz, zx, zy, zz, rise, lead,
        )  # fmt: skip
        d0, d1, d2 = d0 + xx * gx + rx * ex, d1 + xx * gy + rx * ey, d2 + xx * gz + rx * ez
        d3, d4, d5 = d3 + xy * gx + ry * ex, d4 + xy * gy + ry * ey, d5 + xy * gz + ry * ez
        d6, d7, d8 = d6 + xz * gx + rz * ex, d7 + xz * gy + rz * ey, d8 + xz * gz + rz * ez
        if gain <= 0.0:  # of what does not lead there need be no stress, not even a number
            sx, sy, sz = 0.0, 0.0, 0.0
            d0, d1, d2, d3, d4, d5, d6, d7, d8 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        return sx, sy, sz, d0, d1, d2, d3, d4, d5, d6, d7, d8

    return led_slope


def simple_slope_kernel(slope: Any) -> Any:
    """The same for a facet that leads as a whole or not at all, on small turns too.

    Args:
        slope: the law's.
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
        n_l, u_l, z_l = gain * n_l, gain * u_l, gain * z_l
        sx, sy, sz, d0, d1, d2, d3, d4, d5, d6, d7, d8 = plate_slope(
            gain, gain * n, gain * u, gain * z, n_r, u_r, z_r, n_l, u_l, z_l,
            nx, ny, nz, ux, uy, uz, zx, zy, zz, rise, lead,
        )  # fmt: skip
        if lead <= 0.0:  # there need be no stress, not even a number
            sx, sy, sz = 0.0, 0.0, 0.0
            d0, d1, d2, d3, d4, d5, d6, d7, d8 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        return sx, sy, sz, d0, d1, d2, d3, d4, d5, d6, d7, d8

    return simple_slope


@partial(compiled, inline=True)
def plate_slope(
    gain, n, u, z, n_r, u_r, z_r, n_l, u_l, z_l, nx, ny, nz, ux, uy, uz, zx, zy, zz, rise, lead
):
    """Force S = n N + u U + z Z, N, U and Z the three directions, and |p| S(p / |p|) by p.

    As if the normal N were fixed.

    Args:
        gain: what the derivatives of the factors by U.Z are to be multiplied with.
        n: factor of the normal [N].
        u: factor of the direction of motion [N].
        z: factor of the surface's normal [N].
        n_r, u_r, z_r: derivatives of the factors by U.Z, without the gain.
        n_l, u_l, z_l: derivatives by N.U, with it.
        nx, ny, nz, ux, uy, uz, zx, zy, zz: the directions.
        rise: U.Z.
        lead: N.U.
    """
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
