"""Static resistance to sideways motion: passive pressure in place of bearing.

A fit of resistive force theory has one ratio of lateral to vertical strength for all sand: an
upright plate that is drawn meets 0.219 of the stress of a level one that is pushed down. Passive
pressure on a rough wall (R. Lancellotta, Geotechnique Letters, 2002) over bearing capacity
(Prandtl, Reissner) gives another for every friction angle phi,

    R = (1 - sin phi) exp(-(pi/2 - phi) tan phi),                                 (S1)

and the stagnant cone (`law.raised`), which takes part of the strength of a vertical push, is not
there sideways. So a stress is multiplied by

    G = 1 + (C H s - 1) (1 - u_z^2) (1 - b n_z^2),    C = 1 + cone, H = R/0.219,   (S2)
    s = b (1 + (n.u)^8)/2 + 0.6 (1 - b),                                          (S3)

with the normal n, the direction of motion u, and the share b of the skin there that is one flat
face. Where G is above one only the normal part grows, so friction on the face stays what it is.
Vertical motion, and level faces, are left alone. The forms of s and of both brackets are chosen,
by drawn bodies in simulated grains, by legs and by a robot (docs/laws/rft.md).
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import vector

RATIO = 0.219
"""Stress of an upright plate drawn over that of a level one pushed: of the fit of `rft3d`."""

_CURVED = 0.6  # s of curved skin; chosen


def lateral_strength(friction: float) -> float:
    """Return H of (S2).

    Args:
        friction: coefficient of internal friction, tan phi.
    """
    phi = math.atan(friction)
    return (1.0 - math.sin(phi)) * math.exp(-(math.pi / 2 - phi) * friction) / RATIO


@partial(compiled, inline=True)
def as_it_is(law, flat, strength, f, by_rise, by_down, by_lead, rise, down, lead):
    """No more and no less than the law says."""
    return strength, f, by_rise, by_down, by_lead


@partial(compiled, inline=True)
def sideways(law, flat, strength, f, by_rise, by_down, by_lead, rise, down, lead):
    """Return what a `slope` gives (`RftLaw`), times G of (S2).

    The law's record has `lateral`, C H.

    Args:
        law: its record.
        flat: b.
        strength: what the `slope` gives, as all until `by_lead`; Warp takes no tuples.
        f: factors of n, u and z.
        by_rise: their derivatives by u.z.
        by_down: by n.z.
        by_lead: by n.u.
        rise: u.z.
        down: n.z.
        lead: n.u.
    """
    c = max(lead, 0.0)
    c_3 = c * c * c
    shape = 0.5 * flat * (1.0 + c_3 * c_3 * c * c) + _CURVED * (1.0 - flat)
    across, steep = 1.0 - rise * rise, 1.0 - flat * down * down
    more = law.lateral * shape - 1.0
    gain = more * across * steep
    g_rise = -2.0 * more * steep * rise
    g_down = -2.0 * more * across * flat * down
    g_lead = 4.0 * law.lateral * flat * c_3 * c_3 * c * across * steep
    if gain > 0.0:  # of the normal part alone
        part = f.x + f.y * lead + f.z * down
        p_rise = by_rise.x + by_rise.y * lead + by_rise.z * down
        p_down = by_down.x + by_down.y * lead + by_down.z * down + f.z
        p_lead = by_lead.x + by_lead.y * lead + by_lead.z * down + f.y
        f = vector(f.x + gain * part, f.y, f.z)
        by_rise = vector(by_rise.x + gain * p_rise + g_rise * part, by_rise.y, by_rise.z)
        by_down = vector(by_down.x + gain * p_down + g_down * part, by_down.y, by_down.z)
        by_lead = vector(by_lead.x + gain * p_lead + g_lead * part, by_lead.y, by_lead.z)
    else:
        whole = 1.0 + gain
        by_rise = whole * by_rise + g_rise * f
        by_down = whole * by_down + g_down * f
        by_lead = whole * by_lead + g_lead * f
        f = whole * f
    return strength, f, by_rise, by_down, by_lead


def sideways_of(lateral: float) -> Any:
    """Return the kernel for a law with that C H: none is asked for where it is 0."""
    return sideways if lateral > 0 else as_it_is
