"""Derivatives of a facet's leading part, and of its immersed part (`patch`).

For many facets side by side: all branches are evaluated, each quotient is computed once, and values
of branches not taken may be infinite. The caller handles signs: rises are sizes, h the larger.
"""

import math
from functools import partial

from mjgranular.kernel.compiled import compiled

_THIRD, _SIXTH, _TWELFTH = 1.0 / 3.0, 1.0 / 6.0, 1.0 / 12.0
# Least leg of a corner, relative to the larger rise: below the precision, where there is no corner.
_LEAST_LEG = 1e-20
# Least product of two rises of the depth [m^2]: a quotient by it is still finite.
_LEAST_PRODUCT = 1e-290


@partial(compiled, inline=True)
def leading_slope(c, h, k):
    """Return `patch.leading_part` for c, h and k, and its derivatives by x = c/h and y = k/h.

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
def wet_slope(depth, a, b):
    """Return the mean depth of `patch.wet_part`, and its derivatives by all three [m]."""
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
