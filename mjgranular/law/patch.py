"""Parts of a facet: the immersed one, and the leading one.

A facet is taken as a parallelogram over which depth and v.n vary linearly: `d + a s + b t`, s and t
from -1 to 1, where a and b are the rises of the quantity along its half edges. With h >= k for the
sizes of a and b, the positive part is everything, nothing, or one of
- |d| <= h - k: a trapezium; the line d + a s + b t = 0 crosses the two edges along which the
  quantity rises by h;
- |d| > h - k: a corner, or everything but a corner, with legs q/h and q/k, q = h + k - |d|.

Integrals over these are polynomials in d/h, k/h or q, each written without cancellation: a quantity
is divided by k or q only if it vanishes with it. So a and b may have any size, also zero. The signs
of a and b only mirror the parallelogram.

`leading_part` is a scalar kernel; `immersed_part` has no branches and takes numbers as well as
lanes (`kernel.lanes`). `leading_slope` and `immersed_slope` add derivatives, for many facets side
by side: all branches are evaluated, and values of branches not taken may be infinite. The caller
handles signs: rises are sizes, h the larger. A facet without edges and spread (a = b = 0) is fully
immersed, and leads fully, if d > 0.
"""

import math
from functools import partial

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.lanes import choose

# A division takes ten times as long as a product: each quotient is computed once.
_THIRD, _SIXTH, _TWELFTH = 1.0 / 3.0, 1.0 / 6.0, 1.0 / 12.0
# Least leg of a corner, relative to the larger rise: below the precision, where there is no corner.
_LEAST_LEG = 1e-20
# Least product of two rises of the depth [m^2]: a quotient by it is still finite.
_LEAST_PRODUCT = 1e-290


@partial(compiled, inline=True)
def leading_part(c, a, b):
    """Return the part of a facet where c + a s + b t > 0: its share of the area, and its centroid.

    Measured along those two edges a trapezium is y + (k/h) s wide, with y = 1 + c/h and s from -1
    to 1, of a total width of 2: the share is y/2, and the centroid follows from the means of the
    width and of its square. A corner is a triangle, with its centroid at a third of its legs.

    With the depths for c, a and b it is the immersed part. Else c is the normal velocity v.n at the
    facet's middle, and a its rise along the first half edge, v.spread[0]; that v changes along it,
    as on a wheel, is neglected. The centroid, s and t, is 0 if the share is 0 or 1.
    """
    reach = abs(a) + abs(b)
    if c <= -reach:
        return 0.0, 0.0, 0.0
    if c >= reach:
        return 1.0, 0.0, 0.0
    h, k = max(abs(a), abs(b)), min(abs(a), abs(b))
    per_h = 1.0 / h
    if abs(c) <= h - k:
        y, ratio = (h + c) * per_h, k * per_h
        third = ratio / (3.0 * y)
        share = 0.5 * y
        along_h = 1.0 - 0.5 * y - 0.5 * ratio * third
        along_k = third
    else:
        q = reach - abs(c)
        q_h, q_k = q * per_h, q / k
        corner = q_h * q_k * 0.125
        along_h, along_k = 1.0 - q_h * _THIRD, 1.0 - q_k * _THIRD
        share = corner
        if c > 0.0:  # the corner is the trailing part
            share = 1.0 - corner
            other = corner / share
            along_h *= other
            along_k *= other
    if abs(a) >= abs(b):
        return share, math.copysign(along_h, a), math.copysign(along_k, b)
    return share, math.copysign(along_k, a), math.copysign(along_h, b)


@partial(compiled, inline=True)
def immersed_part(depth, a, b):
    """Return the mean depth over a facet [m], negative depth counting as zero, and its center.

    The mean of <depth + a s + b t> and its moments, over the same trapeziums and corners as in
    `leading_part`; the depth over a corner is a pyramid, with a mean of a third of its height and
    its center of pressure, s and t, at a quarter of its legs. Fully immersed the mean is `depth`,
    that of the facet's middle, and the moments are a/3 and b/3. For a level surface the rise a is
    -edges[0].z.
    """
    size_a, size_b = abs(a), abs(b)
    reach, first = size_a + size_b, size_a >= size_b
    h, k = choose(first, size_a, size_b), choose(first, size_b, size_a)
    per_h = 1.0 / h
    # A trapezium: mean depth, and moments times `whole`.
    y, ratio = (h + depth) * per_h, k * per_h
    whole = 3.0 * y * y + ratio * ratio
    along_h = y * y * (3.0 - y) + (1.0 - y) * ratio * ratio
    along_k = 2.0 * ratio * y
    # A corner; the complement of a corner, <x> = x + <-x>; if no corner is left, everything.
    q = reach - abs(depth)
    q_h, q_k = q * per_h, q / k
    corner = q_h * q_k * q * (0.5 * _TWELFTH)
    corner_h, corner_k = 1.0 - 0.25 * q_h, 1.0 - 0.25 * q_k
    is_cut = q > 0.0
    rest = depth + choose(is_cut, corner, 0.0)
    rest_h = h * _THIRD - choose(is_cut, corner * corner_h, 0.0)
    rest_k = k * _THIRD - choose(is_cut, corner * corner_k, 0.0)
    is_corner, is_trapezium = depth <= 0.0, abs(depth) <= h - k
    mean = choose(is_trapezium, h * whole * _TWELFTH, choose(is_corner, corner, rest))
    scale = 1.0 / choose(is_trapezium, whole, choose(is_corner, 1.0, rest))
    along_h = choose(is_trapezium, along_h, choose(is_corner, corner_h, rest_h)) * scale
    along_k = choose(is_trapezium, along_k, choose(is_corner, corner_k, rest_k)) * scale
    s, t = choose(first, along_h, along_k), choose(first, along_k, along_h)
    is_dry = depth <= -reach
    return (
        choose(is_dry, 0.0, mean),
        choose(is_dry, 0.0, choose(a < 0.0, -s, s)),
        choose(is_dry, 0.0, choose(b < 0.0, -t, t)),
    )


@partial(compiled, inline=True)
def immersed_share(depth, a, b):
    """Return the immersed share of a facet's area: the mean depth, derived by depth."""
    size_a, size_b, size = abs(a), abs(b), abs(depth)
    first = size_a >= size_b
    h, k = choose(first, size_a, size_b), choose(first, size_b, size_a)
    q, is_immersed = h + k - size, depth > 0.0
    corner = 0.125 * (q / h) * (q / k)
    share = choose(is_immersed, 1.0 - corner, corner)
    share = choose(size <= h - k, 0.5 + 0.5 * depth / h, share)
    return choose(q <= 0.0, choose(is_immersed, 1.0, 0.0), share)


@partial(compiled, inline=True)
def leading_slope(c, h, k):
    """Return `leading_part` for c, h and k, and its derivatives by x = c/h and y = k/h.

    c is the normal velocity at the facet's middle, h > 0 and k the sizes of its larger and smaller
    rise along a half edge. The numbers are the share that leads, the centroid along the edge of h
    and along that of k; the derivatives of each of the three by x and by y; 1/h.
    """
    size = abs(c)
    trapezium = size <= h - k
    leg = max(h + c if trapezium else k, _LEAST_LEG * h)
    both = 1.0 / (h * leg)
    per_h, per_leg = both * leg, both * h * h  # in units of h
    y = k * per_h
    # A trapezium.
    width, p = leg * per_h, y * per_leg
    share, along_h, along_k = 0.5 * width, 1.0 - 0.5 * width - _SIXTH * y * p, _THIRD * p
    share_x, share_y = 0.5, 0.0
    h_x, h_y = _SIXTH * p * p - 0.5, -along_k
    k_x, k_y = -along_k * per_leg, _THIRD * per_leg
    if not trapezium:
        q = (h + k - size) * per_h
        w = q * per_leg
        corner, corner_x, corner_y = 0.125 * q * w, -0.25 * w, 0.125 * w * (2.0 - w)
        along_h, h_x, h_y = 1.0 - _THIRD * q, _THIRD, -_THIRD
        along_k, k_x, k_y = 1.0 - _THIRD * w, _THIRD * per_leg, _THIRD * per_leg * (w - 1.0)
        share, share_x, share_y = corner, -corner_x, corner_y
        if c > 0.0:  # the corner is the trailing part
            share = 1.0 - corner
            per_share = 1.0 / share
            other = corner * per_share
            turn = per_share * per_share
            other_x, other_y = turn * corner_x, turn * corner_y
            h_x, h_y = h_x * other + along_h * other_x, h_y * other + along_h * other_y
            k_x, k_y = k_x * other + along_k * other_x, k_y * other + along_k * other_y
            along_h, along_k = along_h * other, along_k * other
            share_y = -share_y
        else:
            h_x, k_x = -h_x, -k_x
    if size >= h + k:
        share = 1.0 if c > 0.0 else 0.0
        along_h, along_k = 0.0, 0.0
        share_x, share_y, h_x, h_y, k_x, k_y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    return share, along_h, along_k, share_x, share_y, h_x, h_y, k_x, k_y, per_h


@partial(compiled, inline=True)
def immersed_slope(depth, a, b):
    """Return the mean depth of `immersed_part`, and its derivatives by all three [m]."""
    a_size, b_size, size = abs(a), abs(b), abs(depth)
    h, k = max(a_size, b_size), min(a_size, b_size)
    trapezium = size <= h - k
    leg = 1.0 if trapezium else k
    both = 1.0 / max(h * leg, _LEAST_PRODUCT)
    per_h = both * leg
    y, r = (h + depth) * per_h, k * per_h
    whole = _TWELFTH * (3.0 * y * y + r * r)
    mean, by_depth, by_h, by_k = h * whole, 0.5 * y, 0.5 * y - whole, _SIXTH * r
    if not trapezium:
        q = h + k - size
        edge = 0.125 * q * q * both
        mean = _THIRD * q * edge
        by_depth, by_h, by_k = edge, edge - mean * per_h, edge - mean * (both * h)
        if depth > 0.0:  # the corner is the dry part
            mean, by_depth = depth + mean, 1.0 - edge
    if size >= h + k:
        mean = max(depth, 0.0)
        by_depth, by_h, by_k = (1.0 if depth > 0.0 else 0.0), 0.0, 0.0
    by_a, by_b = (by_h, by_k) if a_size >= b_size else (by_k, by_h)
    return mean, by_depth, math.copysign(1.0, a) * by_a, math.copysign(1.0, b) * by_b
