"""Force on a facet and its derivative by the direction of motion.

A stress that depends on the outward normal n, the direction of motion u and the surface normal z
lies in their span, `s (alpha n + beta u + gamma z)`, and the factors depend only on the cosines
between the three. So a law that gives the factors with their nine partial derivatives (its `slope`)
is sufficient. The rest depends on the facet: its leading part has a load and a centroid, and
therefore a normal, that change with u (`patch`).

The derivative is a sum of few columns, each times the gradient of one number,

    dS/du = sum of column x gradient,

for the cosines u.z and n'.u and for the two ratios that determine the leading part.

Each kernel `led(facet, law, g, u, eps)` here gives the force S(u) on a facet [N], and the
derivative of |p| S(p / |p|) by p: along u it is S, across u the change of S with direction. If
`eps` is 0 a face either leads or trails (`EDGE`), else the leading part of a flat face grows over a
ramp.
"""

import math
from functools import cache, partial
from typing import Any

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import across, cross, diagonal, dot, norm, outer, vector
from mjgranular.law.patch import immersed_part, immersed_slope, leading_part, leading_slope
from mjgranular.law.slip import followed, opposed, turned_slope

# In the search for the velocity at the end of a step, a flat face begins to lead over directions
# within this sine of its plane on either side. Chosen: the search needs a slope where the law is
# discontinuous.
RAMP = 0.05
# A face leads if its normal's component of the motion exceeds this. Chosen: a face that slides
# along itself has a finite response in RFT, so rounding must not decide whether it leads.
EDGE = 1e-9
# A smaller change of the normal along the motion counts as zero: dividing by its square would fail.
# Chosen.
_FLAT = 1e-100
# Rotation of the direction of motion for finite differences of a stress. Chosen: the square root of
# the precision, plus a margin for the rounding of a fit of 60 terms.
_TURN = 1e-6


@partial(compiled, inline=True)
def dissipative(factors, rise, lead, eps):
    """Return factors of a stress (of a `slope`), without the part that would add energy.

    The fit describes leading faces; on the ramp (`eps` > 0) it is also evaluated for slightly
    trailing ones, by u.z (`rise`) and n.u (`lead`).
    """
    strength, f, by_rise, by_down, by_lead = factors
    against = -(f.x * lead + f.z * rise)
    if eps > 0.0 and f.y > against:
        by_rise = vector(by_rise.x, -(by_rise.x * lead + by_rise.z * rise + f.z), by_rise.z)
        by_down = vector(by_down.x, -(by_down.x * lead + by_down.z * rise), by_down.z)
        by_lead = vector(by_lead.x, -(by_lead.x * lead + by_lead.z * rise + f.x), by_lead.z)
        f = vector(f.x, against, f.z)
    return strength, f, by_rise, by_down, by_lead


@partial(compiled, inline=True)
def standing(factors, cone, rise):
    """Return factors of a stress (of a `slope`) with that of stagnant sand, 1 + cone u_z^2."""
    strength, f, by_rise, by_down, by_lead = factors
    more = 1.0 + cone * rise * rise
    by_rise = more * by_rise + (2.0 * cone * rise) * f
    return strength, more * f, by_rise, more * by_down, more * by_lead


@cache
def led_slope_kernel(slope: Any) -> Any:
    """Make the kernel `led` for any facet, from the `slope` of the law (`RftLaw`)."""

    @partial(compiled, inline=True)
    def led(facet, law, g, u, eps):
        n, z, spread_1, spread_2 = facet.normal, facet.up, facet.spread_1, facet.spread_2
        straight, along_1, along_2 = dot(u, n), dot(u, spread_1), dot(u, spread_2)
        c = straight + facet.turn_0
        a, b = along_1 - facet.turn_1, along_2 - facet.turn_2
        s, t = math.copysign(1.0, a), math.copysign(1.0, b)
        # h and k: the larger and the smaller of both sizes; x = c/h, y = k/h.
        a_size, b_size = abs(a), abs(b)
        ramp = eps > 0.0 and a_size + b_size < RAMP
        first = RAMP - b_size if ramp else a_size
        # On the ramp alone no side leads: the leading part is in the middle of the facet.
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
        immersed, immersed_d, immersed_a, immersed_b = immersed_slope(
            facet.middle + la * rise_1 + lb * rise_2, rest_1, rest_2
        )
        immersed_a, immersed_b = (
            share * rise_1 * (immersed_d - s * immersed_a),
            share * rise_2 * (immersed_d - t * immersed_b),
        )
        load = share * immersed
        load_x = share_x * immersed + immersed_a * la_x + immersed_b * lb_x
        load_y = share_y * immersed + immersed_a * la_y + immersed_b * lb_y

        m = n + la * spread_1 + lb * spread_2
        scale = 1.0 / norm(m)
        m = scale * m
        down, leads = dot(m, z), dot(m, u)
        if facet.slides > 0.0:
            leads = scale * (c + la * a + lb * b)
        w, size, e, d = followed(facet, m, u, leads) if facet.slides > 0.0 else (u, 1.0, u, u)
        rise, lead = dot(w, z), leads / size
        strength, f, by_rise, by_down, by_lead = dissipative(
            standing(slope(law, g, rise, down, lead), facet.cone, rise), rise, lead, eps
        )
        strength *= facet.area
        gain = strength * load
        # Changes of the normal along itself, of n'.z and of n'.u when it turns toward a spread.
        an, bn = scale * dot(spread_1, m), scale * dot(spread_2, m)
        ad, bd = scale * dot(spread_1, z) - an * down, scale * dot(spread_2, z) - bn * down
        al, bl = scale * dot(spread_1, w) - an * lead, scale * dot(spread_2, w) - bn * lead

        # Columns of the ratios x and y.
        frame = vector(m, w, z)
        f_x, f_y = (strength * load_x) * f, (strength * load_y) * f
        f_sided = (strength * immersed_a) * f
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
        gradient_x = (
            n + xa * spread_1 + xb * spread_2 - (straight + xa * along_1 + xb * along_2) * u
        )
        gradient_y = ya * spread_1 + yb * spread_2 - (ya * along_1 + yb * along_2) * u

        force, by_p = plate_slope(f, gain * by_rise, by_lead, frame, rise, lead)
        if facet.slides > 0.0:
            opposing = opposed(force, facet, m, u)
            by_p = turned_slope(by_p, force, m, u, (w, size, e, d), opposing)
            force = opposing[0]
        by_p = by_p + outer(column_x, per_h * gradient_x) + outer(column_y, per_h * gradient_y)
        if ramp:  # `sided` changes too
            f_sided = f_sided + al * by_lead + ad * by_down - vector(f.x * an, 0.0, 0.0)
            column = la_sided * (dot(f_sided, frame) + turn * spread_1)
            sa, sb = s / first, sided * t / first
            gradient = sa * spread_1 + sb * spread_2 - (sa * along_1 + sb * along_2) * u
            by_p = by_p + outer(column, gradient)
        # Trailing parts may have an undefined stress, even NaN.
        if gain <= 0.0 or leads <= edge_of(eps):
            force, by_p = vector(0.0, 0.0, 0.0), diagonal(0.0)
        return force, by_p

    return led


@cache
def simple_slope_kernel(slope: Any) -> Any:
    """Make the kernel `led` for facets of which all or nothing leads, on small rotations too."""

    @partial(compiled, inline=True)
    def led(facet, law, g, u, eps):
        n, z = facet.normal, facet.up
        down, leads = dot(n, z), dot(n, u)
        if facet.slides > 0.0:
            leads = leads + facet.turn_0
        w, size, e, d = followed(facet, n, u, leads) if facet.slides > 0.0 else (u, 1.0, u, u)
        rise, lead = dot(w, z), leads / size
        strength, f, by_rise, _, by_lead = dissipative(
            standing(slope(law, g, rise, down, lead), facet.cone, rise), rise, lead, eps
        )
        gain = strength * facet.mean * facet.area
        force, by_p = plate_slope(
            gain * f, gain * by_rise, gain * by_lead, vector(n, w, z), rise, lead
        )
        if facet.slides > 0.0:
            opposing = opposed(force, facet, n, u)
            by_p = turned_slope(by_p, force, n, u, (w, size, e, d), opposing)
            force = opposing[0]
        # Trailing parts may have an undefined stress, even NaN.
        if gain <= 0.0 or leads <= (0.0 if eps > 0.0 else EDGE):
            force, by_p = vector(0.0, 0.0, 0.0), diagonal(0.0)
        return force, by_p

    return led


@partial(compiled, inline=True)
def edge_of(eps):
    """Return the least n.u at which a face leads; no limit on a ramp."""
    return -1.0 if eps > 0.0 else EDGE


@partial(compiled, inline=True)
def plate_slope(f, by_rise, by_lead, frame, rise, lead):
    """Return the force S = f_n n + f_u u + f_z z, and |p| S(p / |p|) by p, for a fixed normal.

    `f` are the factors [N], with derivatives by u.z (`rise`) and n.u (`lead`); `frame` is n, u and
    z.
    """
    n, u, z = frame.x, frame.y, frame.z
    force = dot(f, frame)
    across_z, across_n = z - rise * u, n - lead * u  # gradients of u.z and n.u
    by_p = outer(force - f.y * u, u) + diagonal(f.y)
    by_p = by_p + outer(dot(by_rise, frame), across_z) + outer(dot(by_lead, frame), across_n)
    return force, by_p


@cache
def led_by_differences(stress: Any) -> Any:
    """Make the kernel `led` of a law with a `stress` alone; its derivative by two small turns."""

    @partial(compiled, inline=True)
    def led_stress(facet, law, g, u, eps):
        c = dot(u, facet.normal) + facet.turn_0
        a, b = dot(u, facet.spread_1) - facet.turn_1, dot(u, facet.spread_2) - facet.turn_2
        rise, sided = a, 1.0
        if eps > 0.0 and abs(a) + abs(b) < RAMP:
            first = RAMP - abs(b)
            sided = abs(a) / first
            a = math.copysign(first, a)
        load, s, t = load_of(facet.middle, facet.rise_1, facet.rise_2, facet.mean, c, a, b, sided)
        m = facet.normal + s * facet.spread_1 + t * facet.spread_2
        size = norm(m)
        m = m / size
        w, leads = u, dot(m, u)
        if facet.slides > 0.0:
            leads = (c + s * rise + t * b) / size
            w, _size, _e, _d = followed(facet, m, u, leads)
        more = 1.0 + facet.cone * dot(w, facet.up) * dot(w, facet.up)
        force = (load * facet.area * more) * stress(law, g, m, w, facet.up)
        if facet.slides > 0.0:
            force, _share, _slip, _traction, _per, _full = opposed(force, facet, m, u)
        if load <= 0.0 or leads <= edge_of(eps):
            force = vector(0.0, 0.0, 0.0)
        # The fit describes leading faces; on the ramp it is also evaluated for slightly trailing
        # ones.
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
    """Return the mean depth of a facet's leading part, over the whole facet, and its centroid.

    The leading part is replaced by a parallelogram around its centroid, narrowed by the distance of
    that from the middle (`patch`).
    """
    share, s, t = leading_part(c, a, b)
    s *= sided  # 1 except on the ramp
    if share == 1.0:
        return mean, 0.0, 0.0
    if share == 0.0:
        return 0.0, 0.0, 0.0
    if h1 == 0.0 and h2 == 0.0:
        return share * max(depth, 0.0), s, t
    immersed, _, _ = immersed_part(
        depth + s * h1 + t * h2, (1.0 - abs(s)) * h1, (1.0 - abs(t)) * h2
    )
    return share * immersed, s, t
