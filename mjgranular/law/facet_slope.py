"""Force on a facet and its derivative by the direction of motion.

A stress that knows the outward normal n, the direction of motion u and the normal of the surface z
lies in their span, `s (alpha n + beta u + gamma z)`, and the factors depend on the cosines between
the three alone. So a law that gives the factors with their nine partial derivatives (its `slope`)
gives everything. The rest is a facet's own: what leads of it has a load and a centroid, and so a
normal, that change with u (`patch_slope`).

The derivative is put together from few columns, each times the gradient of one number,

    dS/du = sum of column x gradient,

for the cosines u.z and n'.u and for the two ratios that say what leads.

Each kernel `led(facet, law, g, u, eps)` here gives the force S(u) on a facet [N], and the
derivative of |p| S(p / |p|) by p: that is S along u, its turn across. Where `eps` is 0 a face leads
or does not (`EDGE`), else what leads of a flat one grows over a ramp.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import across, cross, diagonal, dot, norm, outer, vector
from mjgranular.law.patch import leading_part, wet_part
from mjgranular.law.patch_slope import leading_slope, wet_slope

# Where the velocity at the end of a step is sought, a flat face begins to lead over directions
# within this sine of its plane on either side. Chosen: the search needs a slope where the law
# jumps.
RAMP = 0.05
# A face leads when its normal's share of the motion is above this. Chosen: a face that slides along
# itself has a finite response in RFT, so rounding must not decide whether it leads.
EDGE = 1e-9
# A spread of the normal along the motion that is smaller than this is none: its square could not be
# divided by. Chosen.
_FLAT = 1e-100
# Turn of the direction of motion for the derivative of a stress. Chosen: the square root of the
# precision, and some more for the rounding of a fit of 60 terms.
_TURN = 1e-6


@partial(compiled, inline=True)
def dissipative(factors, rise, lead, eps):
    """Factors of a stress, and their derivatives, with what of it would push the facet on cut off.

    The fit describes faces that lead; on the ramp it is asked for some that just do not.

    Args:
        factors: what a `slope` gives.
        rise: u.z.
        lead: n.u.
        eps: softness; without it there is no ramp.
    """
    strength, f, by_rise, by_down, by_lead = factors
    against = -(f.x * lead + f.z * rise)
    if eps > 0.0 and f.y > against:
        by_rise = vector(by_rise.x, -(by_rise.x * lead + by_rise.z * rise + f.z), by_rise.z)
        by_down = vector(by_down.x, -(by_down.x * lead + by_down.z * rise), by_down.z)
        by_lead = vector(by_lead.x, -(by_lead.x * lead + by_lead.z * rise + f.x), by_lead.z)
        f = vector(f.x, against, f.z)
    return strength, f, by_rise, by_down, by_lead


@cache
def led_slope_kernel(slope: Any) -> Any:
    """Makes the kernel `led` for any facet.

    Args:
        slope: the law's, see `RftLaw`.
    """

    @partial(compiled, inline=True)
    def led(facet, law, g, u, eps):
        n, z, spread_1, spread_2 = facet.normal, facet.up, facet.spread_1, facet.spread_2
        c, a, b = dot(u, n), dot(u, spread_1), dot(u, spread_2)
        s, t = math.copysign(1.0, a), math.copysign(1.0, b)
        # h and k: the larger and the smaller of both sizes; x = c/h, y = k/h.
        a_size, b_size = abs(a), abs(b)
        ramp = eps > 0.0 and a_size + b_size < RAMP
        first = RAMP - b_size if ramp else a_size
        # The ramp alone has no side: what leads on it is in the middle of the facet.
        sided = a_size / first if ramp else 1.0
        swap = first < b_size
        h, k = max(first, b_size, _FLAT), min(first, b_size)
        share, lh, lk, share_x, share_y, h_x, h_y, k_x, k_y, per_h = leading_slope(c, h, k)
        la, la_x, la_y = (lk, k_x, k_y) if swap else (lh, h_x, h_y)
        lb, lb_x, lb_y = (lh, h_x, h_y) if swap else (lk, k_x, k_y)
        rise_1, rise_2 = facet.rise_1, facet.rise_2
        la_sided = s * la
        la, la_x, la_y = sided * la, sided * la_x, sided * la_y
        rest_1, rest_2 = (1.0 - la) * rise_1, (1.0 - lb) * rise_2
        la, la_x, la_y = s * la, s * la_x, s * la_y
        lb, lb_x, lb_y = t * lb, t * lb_x, t * lb_y
        wet, wet_d, wet_a, wet_b = wet_slope(
            facet.middle + la * rise_1 + lb * rise_2, rest_1, rest_2
        )
        wet_a, wet_b = share * rise_1 * (wet_d - s * wet_a), share * rise_2 * (wet_d - t * wet_b)
        load = share * wet
        load_x = share_x * wet + wet_a * la_x + wet_b * lb_x
        load_y = share_y * wet + wet_a * la_y + wet_b * lb_y

        m = n + la * spread_1 + lb * spread_2
        scale = 1.0 / norm(m)
        m = scale * m
        rise, down, lead = dot(u, z), dot(m, z), dot(m, u)
        strength, f, by_rise, by_down, by_lead = dissipative(
            slope(law, g, rise, down, lead), rise, lead, eps
        )
        strength *= facet.area
        gain = strength * load
        # What turning towards a spread does to the normal along itself, to n'.z and to n'.u.
        an, bn = scale * dot(spread_1, m), scale * dot(spread_2, m)
        ad, bd = scale * dot(spread_1, z) - an * down, scale * dot(spread_2, z) - bn * down
        al, bl = scale * a - an * lead, scale * b - bn * lead

        # Columns of the ratios x and y.
        frame = vector(m, u, z)
        f_x, f_y = (strength * load_x) * f, (strength * load_y) * f
        f_sided = (strength * wet_a) * f
        f, by_down, by_lead = gain * f, gain * by_down, gain * by_lead
        dl, dd, dn = al * la_x + bl * lb_x, ad * la_x + bd * lb_x, an * la_x + bn * lb_x
        f_x = f_x + dl * by_lead + dd * by_down - vector(f.x * dn, 0.0, 0.0)
        dl, dd, dn = al * la_y + bl * lb_y, ad * la_y + bd * lb_y, an * la_y + bn * lb_y
        f_y = f_y + dl * by_lead + dd * by_down - vector(f.x * dn, 0.0, 0.0)
        turn = f.x * scale
        column_x = dot(f_x, frame) + (turn * la_x) * spread_1 + (turn * lb_x) * spread_2
        column_y = dot(f_y, frame) + (turn * la_y) * spread_1 + (turn * lb_y) * spread_2
        # Their gradients, across u, from those of c, h and k: n, and spreads with a sign.
        x, y = c * per_h, k * per_h
        first_h, first_k = (0.0, s) if swap else (s, 0.0)
        second_h, second_k = (t, 0.0) if swap else (0.0, t)
        if ramp:  # |a| = RAMP - |b|
            first_h, first_k = 0.0, 0.0
            second_h, second_k = (t, -t) if swap else (-t, t)
        xa, xb = -x * first_h, -x * second_h
        ya, yb = first_k - y * first_h, second_k - y * second_h
        gradient_x = n + xa * spread_1 + xb * spread_2 - (c + xa * a + xb * b) * u
        gradient_y = ya * spread_1 + yb * spread_2 - (ya * a + yb * b) * u

        force, by_p = plate_slope(f, gain * by_rise, by_lead, frame, rise, lead)
        by_p = by_p + outer(column_x, per_h * gradient_x) + outer(column_y, per_h * gradient_y)
        if ramp:  # `sided` changes too
            f_sided = f_sided + al * by_lead + ad * by_down - vector(f.x * an, 0.0, 0.0)
            column = la_sided * (dot(f_sided, frame) + turn * spread_1)
            sa, sb = s / first, sided * t / first
            by_p = by_p + outer(column, sa * spread_1 + sb * spread_2 - (sa * a + sb * b) * u)
        # Of what does not lead there need be no stress, not even a number.
        if gain <= 0.0 or lead <= edge_of(eps):
            force, by_p = vector(0.0, 0.0, 0.0), diagonal(0.0)
        return force, by_p

    return led


@cache
def simple_slope_kernel(slope: Any) -> Any:
    """Makes the kernel `led` for facets that lead as a whole or not at all, on small turns too.

    Args:
        slope: the law's, see `RftLaw`.
    """

    @partial(compiled, inline=True)
    def led(facet, law, g, u, eps):
        n, z = facet.normal, facet.up
        rise, down, lead = dot(u, z), dot(n, z), dot(n, u)
        strength, f, by_rise, _, by_lead = dissipative(
            slope(law, g, rise, down, lead), rise, lead, eps
        )
        gain = strength * facet.mean * facet.area
        force, by_p = plate_slope(
            gain * f, gain * by_rise, gain * by_lead, vector(n, u, z), rise, lead
        )
        # Of what does not lead there need be no stress, not even a number.
        if gain <= 0.0 or lead <= (0.0 if eps > 0.0 else EDGE):
            force, by_p = vector(0.0, 0.0, 0.0), diagonal(0.0)
        return force, by_p

    return led


@partial(compiled, inline=True)
def edge_of(eps):
    """The least n.u with which something leads; on a ramp there is none."""
    return -1.0 if eps > 0.0 else EDGE


@partial(compiled, inline=True)
def plate_slope(f, by_rise, by_lead, frame, rise, lead):
    """Force S = f_n n + f_u u + f_z z, and |p| S(p / |p|) by p, as if the normal were fixed.

    Args:
        f: the factors [N].
        by_rise: their derivatives by u.z.
        by_lead: their derivatives by n.u.
        frame: n, u and z.
        rise: u.z.
        lead: n.u.
    """
    n, u, z = frame.x, frame.y, frame.z
    force = dot(f, frame)
    across_z, across_n = z - rise * u, n - lead * u  # gradients of u.z and n.u
    by_p = outer(force - f.y * u, u) + diagonal(f.y)
    by_p = by_p + outer(dot(by_rise, frame), across_z) + outer(dot(by_lead, frame), across_n)
    return force, by_p


@cache
def led_by_differences(stress: Any) -> Any:
    """Makes the kernel `led` of a law without a slope, with a derivative from two small turns.

    Args:
        stress: the law's, see `RftLaw`.
    """

    @partial(compiled, inline=True)
    def led_stress(facet, law, g, u, eps):
        c, a, b = dot(u, facet.normal), dot(u, facet.spread_1), dot(u, facet.spread_2)
        sided = 1.0
        if eps > 0.0 and abs(a) + abs(b) < RAMP:
            first = RAMP - abs(b)
            sided = abs(a) / first
            a = math.copysign(first, a)
        load, s, t = load_of(facet.middle, facet.rise_1, facet.rise_2, facet.mean, c, a, b, sided)
        m = facet.normal + s * facet.spread_1 + t * facet.spread_2
        m = m / norm(m)
        force = (load * facet.area) * stress(law, g, m, u, facet.up)
        if load <= 0.0 or dot(m, u) <= edge_of(eps):
            force = vector(0.0, 0.0, 0.0)
        # The fit describes faces that lead; on the ramp it is asked for some that just do not.
        power = max(dot(force, u), 0.0) if eps > 0.0 else 0.0
        return force - power * u

    @partial(compiled, inline=True)
    def led(facet, law, g, u, eps):
        a = across(u)
        b = cross(u, a)
        force = led_stress(facet, law, g, u, eps)
        by_a = (1.0 / _TURN) * (led_stress(facet, law, g, u + _TURN * a, eps) - force)
        by_b = (1.0 / _TURN) * (led_stress(facet, law, g, u + _TURN * b, eps) - force)
        return force, outer(force, u) + outer(by_a, a) + outer(by_b, b)

    return led


@partial(compiled, inline=True)
def load_of(depth, h1, h2, mean, c, a, b, sided):
    """Mean depth of what leads of a facet, over the whole facet, and the centroid of that part.

    The part that leads is replaced by a parallelogram around its centroid, narrowed by the distance
    of that from the middle (`patch`).
    """
    share, s, t = leading_part(c, a, b)
    s *= sided  # 1 but on the ramp
    if share == 1.0:
        return mean, 0.0, 0.0
    if share == 0.0:
        return 0.0, 0.0, 0.0
    if h1 == 0.0 and h2 == 0.0:
        return share * max(depth, 0.0), s, t
    wet, _, _ = wet_part(depth + s * h1 + t * h2, (1.0 - abs(s)) * h1, (1.0 - abs(t)) * h2)
    return share * wet, s, t
