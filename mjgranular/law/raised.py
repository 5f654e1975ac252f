"""Static resistance beyond that of depth: of stagnant sand under flat faces, and of fast shear.

Both (docs/laws/rft.md, "Faster motion") are factors on the static resistance of a facet, known from
its position and motion at the start of a step: they change limits, not how a law holds at rest.
"""

import math
from functools import partial

from numpy.polynomial import Polynomial

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.lanes import choose, root
from mjgranular.kernel.motion import velocity_at
from mjgranular.kernel.vector import dot

FRICTION_CUBIC = Polynomial([0.0, 89.0, -386.0, 894.0])
"""xi_n / (rho_c g) by the coefficient of internal friction mu: 894 mu^3 - 386 mu^2 + 89 mu, of
Agarwal, Goldman and Kamrin, PNAS 120 (2023)."""

INERTIAL_NUMBER = 0.279
"""I_0, at which half of the rise is reached: glass beads, Jop, Forterre and Pouliquen 2006."""

RATE = 0.26
"""Rise of friction from slow flow to fast: of glass beads, tan 32.76 - tan 20.9 degrees, ibid."""

SHEAR_KEYS = ("shear", "rate_1", "rate_2", "rate_3")
"""Fields of a law's record that fast shear needs (`shear_constants`)."""

CONE_FORMS = 0.1
"""Depth over which the cone forms, in widths; chosen."""

_PACKING = 0.59  # solid fraction of a loose bed: of the beds of `referee`
_NO_STRESS = 1e-9  # stress that counts as zero [Pa]; chosen


def cone_under(friction: float) -> float:
    """Return the mean depth of the cone of stagnant sand below a flat face, in its widths."""
    return math.tan(math.pi / 4 + math.atan(friction) / 2) / 6


def shear_constants(density: float, grain: float, friction: float, rate: float) -> dict[str, float]:
    """Return what the kernel reads: d sqrt(rho_s) [kg^(1/2) m^(-1/2)], and three factors.

    xi_n(mu + s rate) / xi_n(mu) = 1 + s (a + s (b + s c)) with s = I / (I + I_0). The density of
    the bed is in [kg/m^3], the diameter of a grain in [m], `friction` is mu.
    """
    whole = FRICTION_CUBIC(friction)
    if not (rate > 0 and whole > 0):
        return dict.fromkeys(SHEAR_KEYS, 0.0)
    size = grain * math.sqrt(density / _PACKING)
    rise = FRICTION_CUBIC(Polynomial([friction, rate])) / whole  # Taylor coefficients by s
    return dict(zip(SHEAR_KEYS, (size, *rise.coef[1:]), strict=True))


@partial(compiled, inline=True)
def not_raised(law, facet, pose, centre, normal, up, mean, g):
    """Return 1 and 0: static resistance by depth alone."""
    return 1.0, 0.0 * mean


@partial(compiled, inline=True)
def raised_by_cone(law, facet, pose, centre, normal, up, mean, g):
    """Return 1, and what stagnant sand adds; the law's record has `cone` [widths]."""
    down = -dot(normal, up)
    least = CONE_FORMS * facet.face
    deep = choose(mean > least, mean, least)
    return 1.0, law.cone * facet.flat * facet.face * choose(down > 0.0, down, 0.0) / deep


@partial(compiled, inline=True)
def raised_by_shear(law, facet, pose, centre, normal, up, mean, g):
    """Return the factor of fast shear, and what stagnant sand adds.

    The record also has `stiffness`, xi_n / g [kg/m^3], and `shear` and `rate_1` to `rate_3`
    (`shear_constants`).
    """
    _, cone = raised_by_cone(law, facet, pose, centre, normal, up, mean, g)
    stress = law.stiffness * g * mean * (1.0 + cone)
    stress = choose(stress > _NO_STRESS, stress, _NO_STRESS)
    v = velocity_at(pose.motion, centre - pose.tree)
    per = law.shear / facet.face
    number = root(per * per * dot(v, v) / stress)
    s = number / (number + INERTIAL_NUMBER)
    return 1.0 + s * (law.rate_1 + s * (law.rate_2 + s * law.rate_3)), cone
