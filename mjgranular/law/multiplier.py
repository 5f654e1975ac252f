"""The friction multiplier of an element, an unknown besides its velocity, and its update.

Static resistance is discontinuous where the motion reverses. Softened over a small speed eps it is
a function F(p) of the *multiplier*

    p = v / sqrt(v^2 + eps^2),

the mobilized part of the limit, a vector of size below one. Where the limit is reached, its
derivative along the motion is nearly zero, and Newton's method for v alone overshoots. So v and p
are both unknown, and `sqrt(v^2 + eps^2) p = v` is linearized: equal at the solution, but better
conditioned on the way (the primal-dual method of Chan, Golub and Mulet, SIAM J. Sci. Comput. 20
(1999), for the same function in image processing).
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import diagonal, dot, outer


@dataclass(frozen=True)
class Multiplier:
    """Kernels of a sample, its velocity v [m/s], its multiplier p and the softness eps [m/s]."""

    own: Any  # `own(sample, v, eps)`: the multiplier of a velocity
    # `update(sample, v, p, c, eps)`: the multiplier after a Newton step that changes the velocity
    # by `c`, limited to a size of one.
    update: Any
    # `by_velocity(sample, v, p, eps)`: the derivative of the multiplier used in such a step, a
    # matrix.
    by_velocity: Any
    # `turn(sample, v, c, eps)`: the square of a change `c` of the velocity, relative to the speeds
    # over which the multiplier turns.
    turn: Any


@partial(compiled, inline=True)
def softened(square, eps):
    """Return 1 / sqrt(v^2 + eps^2), the factor from velocity to multiplier [s/m]."""
    return 1.0 / math.sqrt(square + eps * eps)


@partial(compiled, inline=True)
def multiplier_of(v, eps):
    """Return the multiplier of a velocity."""
    return softened(dot(v, v), eps) * v


@partial(compiled, inline=True)
def own(sample, v, eps):
    """Compute `Multiplier.own` for one limit."""
    return multiplier_of(v, eps)


@partial(compiled, inline=True)
def update(sample, v, p, c, eps):
    """Compute `Multiplier.update` for one limit."""
    scale = softened(dot(v, v), eps)
    q = scale * (v + c - (dot(v, c) * scale) * p)
    square = dot(q, q)
    return q if square <= 1.0 else (1.0 / math.sqrt(square)) * q


@partial(compiled, inline=True)
def by_velocity(sample, v, p, eps):
    """Compute `Multiplier.by_velocity` for one limit."""
    scale = softened(dot(v, v), eps)
    return diagonal(scale) - outer(p, (scale * scale) * v)


@partial(compiled, inline=True)
def turn(sample, v, c, eps):
    """Compute `Multiplier.turn` for one limit."""
    return dot(c, c) / (dot(v, v) + eps * eps)


ONE_LIMIT = Multiplier(own, update, by_velocity, turn)
"""Multiplier of a law with one limit against motion in all directions."""


@partial(compiled, inline=True)
def split_own(sample, v, eps):
    """Compute `Multiplier.own` for two limits."""
    n = sample.normal
    v_n = dot(v, n) * n
    return multiplier_of(v_n, eps) + multiplier_of(v - v_n, eps)


@partial(compiled, inline=True)
def split_update(sample, v, p, c, eps):
    """Compute `Multiplier.update` for two limits."""
    n = sample.normal
    v_n, p_n, c_n = dot(v, n) * n, dot(p, n) * n, dot(c, n) * n
    along = update(sample, v_n, p_n, c_n, eps)
    return along + update(sample, v - v_n, p - p_n, c - c_n, eps)


@partial(compiled, inline=True)
def split_by_velocity(sample, v, p, eps):
    """Compute `Multiplier.by_velocity` for two limits."""
    n = sample.normal
    v_n, p_n = dot(v, n) * n, dot(p, n) * n
    v_t, p_t = v - v_n, p - p_n
    scale_n, scale_t = softened(dot(v_n, v_n), eps), softened(dot(v_t, v_t), eps)
    straight = diagonal(scale_t) + outer((scale_n - scale_t) * n, n)
    return straight - outer(p_n, (scale_n * scale_n) * v_n) - outer(p_t, (scale_t * scale_t) * v_t)


@partial(compiled, inline=True)
def split_turn(sample, v, c, eps):
    """Compute `Multiplier.turn` for two limits."""
    n = sample.normal
    v_n, c_n = dot(v, n) * n, dot(c, n) * n
    return max(turn(sample, v_n, c_n, eps), turn(sample, v - v_n, c - c_n, eps))


TWO_LIMITS = Multiplier(split_own, split_update, split_by_velocity, split_turn)
"""Multiplier of a law with one limit along the surface's `normal`, a field of its samples, and one
across."""
