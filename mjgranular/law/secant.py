"""The secant of a force: damping that equals it at one velocity, and dissipates at any other.

docs/scheme.md, "Damping", has the formula of the secant Z, for which Z v = -F(v). Both engines use
it (`scheme.damping`, `warp.damping`).
"""

import math
from functools import partial

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import across, cross, dot, norm, outer

# A force nearly perpendicular to the motion has no secant; its power counts as at least this share
# of |F| |v|. Chosen.
_LEAST_POWER = 0.02


@partial(compiled, inline=True)
def secant(force, slope, u):
    """Return Z of a force F / |v| [N s/m] that moves along u = v / |v|.

    The slope is minus the force's derivative by the velocity, a matrix [N s/m].
    """
    size, power = norm(force), -dot(force, u)
    resists = power > 0.0
    inverse = 1.0 / max(power, _LEAST_POWER * size) if resists else 0.0
    least = size if resists else 0.0
    # Y by its two eigenvalues.
    a = across(u)
    b = cross(u, a)
    by_a, by_b = slope @ a, slope @ b
    aa, bb, ab = dot(a, by_a), dot(b, by_b), 0.5 * (dot(a, by_b) + dot(b, by_a))
    middle, half = 0.5 * (aa + bb), 0.5 * (aa - bb)
    radius = math.sqrt(half * half + ab * ab)
    first, second = max(middle + radius, least), max(middle - radius, least)
    middle = 0.5 * (first + second)
    part = 0.5 * (first - second) / radius if radius > 0.0 else 0.0
    aa, bb, ab = middle + part * half, middle - part * half, part * ab
    turn = outer(aa * a + ab * b, a) + outer(ab * a + bb * b, b)
    return outer(inverse * force, force) + turn
