"""Static resistance to sideways motion: passive pressure in place of bearing.

A fit of resistive force theory has one ratio of lateral to vertical strength for all sand: an
upright plate that is drawn meets 0.219 of the stress of a level one that is pushed down. Passive
pressure on a rough wall (R. Lancellotta, Geotechnique 52, 617, 2002) over bearing capacity
(Prandtl, Reissner) gives a ratio for every friction angle phi,

    R = (1 - sin phi) exp(-(pi/2 - phi) tan phi),                                 (S1)

and the stagnant cone (`law.raised`), which takes part of the strength of a vertical push, is absent
sideways. So a stress is multiplied by

    G = 1 + (L (1 + (n.u)^8)/2 - 1) (1 - u_z^2) (1 - n_z^2),                      (S2)
    L = (1 + cone) R/0.219,                                                       (S3)

with the normal n and the direction of motion u. Where G is above one only the normal part grows,
so the friction on the face stays the same. Vertical motion and level faces are left alone. The
three brackets are chosen, by drawn bodies in simulated grains, legs and a robot
(docs/laws/rft.md).
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import vector

RATIO = 0.219
"""Stress of an upright plate drawn over that of a level one pushed, in the fit of `rft3d`."""


def lateral_strength(friction: float) -> float:
    """Return R/0.219 of (S3).

    Args:
        friction: coefficient of internal friction, tan phi.
    """
    phi = math.atan(friction)
    return (1.0 - math.sin(phi)) * math.exp(-(math.pi / 2 - phi) * friction) / RATIO


@cache
def sideways_slope(slope: Any) -> Any:
    """Build the `slope` of a law (`RftLaw`) times G of (S2), with the record's `lateral` as L."""

    @partial(compiled, inline=True)
    def of_sideways(law, g, rise, down, lead):
        strength, f, by_rise, by_down, by_lead = slope(law, g, rise, down, lead)
        c = max(lead, 0.0)
        c_4 = (c * c) * (c * c)
        across, steep = 1.0 - rise * rise, 1.0 - down * down
        more = law.lateral * (0.5 + 0.5 * c_4 * c_4) - 1.0
        gain = more * across * steep  # G - 1, and its derivatives by the three cosines
        g_rise, g_down = -2.0 * more * steep * rise, -2.0 * more * across * down
        g_lead = 4.0 * law.lateral * c_4 * (c * c * c) * across * steep
        if gain > 0.0:
            normal = f.x + f.y * lead + f.z * down
            n_rise = by_rise.x + by_rise.y * lead + by_rise.z * down
            n_down = by_down.x + by_down.y * lead + by_down.z * down + f.z
            n_lead = by_lead.x + by_lead.y * lead + by_lead.z * down + f.y
            n_rise, n_down = gain * n_rise + g_rise * normal, gain * n_down + g_down * normal
            n_lead = gain * n_lead + g_lead * normal
            by_rise = vector(by_rise.x + n_rise, by_rise.y, by_rise.z)
            by_down = vector(by_down.x + n_down, by_down.y, by_down.z)
            by_lead = vector(by_lead.x + n_lead, by_lead.y, by_lead.z)
            f = vector(f.x + gain * normal, f.y, f.z)
        else:
            whole = 1.0 + gain
            by_rise = whole * by_rise + g_rise * f
            by_down = whole * by_down + g_down * f
            by_lead = whole * by_lead + g_lead * f
            f = whole * f
        return strength, f, by_rise, by_down, by_lead

    return of_sideways
