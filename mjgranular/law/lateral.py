"""Lateral strength of sand, passive pressure instead of bearing, and what measured plates meet.

The normal part of a stress is multiplied by G (S2), the tangential part by T (S3), and both by K J
(S4, S5). docs/laws/rft.md, "Faster motion", derives the factors. T <= G for any L, so a dissipative
stress stays dissipative. With the normal n and the direction of motion u, c is max(n.u, 0).
"""

import math
from functools import cache, partial
from typing import Any

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import vector

RATIO = 0.219
"""Stress of an upright dragged plate over that of a level pushed one, in the fit of `rft3d`."""

TILTED = 0.3  # reduction at 45 degrees: the best for 165 measured stresses (docs/laws/rft.md)


def lateral_strength(friction: float) -> float:
    """Return R/0.219 of (S2), for a coefficient of internal friction, tan phi."""
    phi = math.atan(friction)
    return (1.0 - math.sin(phi)) * math.exp(-(math.pi / 2 - phi) * friction) / RATIO


@cache
def lateral_slope(slope: Any) -> Any:
    """Make the `slope` of a law (`RftLaw`) by (S2) and (S3), with the record's `lateral` as L."""

    @partial(compiled, inline=True)
    def of_lateral(law, g, rise, down, lead):
        strength, f, by_rise, by_down, by_lead = slope(law, g, rise, down, lead)
        c = max(lead, 0.0)
        c_4 = (c * c) * (c * c)
        c_7, c_8 = c_4 * (c * c * c), c_4 * c_4
        across, steep = 1.0 - rise * rise, 1.0 - down * down
        level, level_rise, level_down = across * steep, -2.0 * steep * rise, -2.0 * across * down
        # T - 1, G - T, and the derivatives of both by n.u.
        half = 0.5 * law.lateral
        low, high = min(half - 1.0, 0.0), min(2.0 * half - 1.0, 0.0)
        less, less_lead = low + (high - low) * c_8, 8.0 * (high - low) * c_7
        more, more_lead = half * (1.0 + c_8) - 1.0 - less, 8.0 * half * c_7 - less_lead
        whole, gain = 1.0 + less * level, more * level
        normal = f.x + f.y * lead + f.z * down
        n_rise = by_rise.x + by_rise.y * lead + by_rise.z * down
        n_down = by_down.x + by_down.y * lead + by_down.z * down + f.z
        n_lead = by_lead.x + by_lead.y * lead + by_lead.z * down + f.y
        n_rise = gain * n_rise + more * level_rise * normal
        n_down = gain * n_down + more * level_down * normal
        n_lead = gain * n_lead + more_lead * level * normal
        by_rise = whole * by_rise + (less * level_rise) * f + vector(n_rise, 0.0, 0.0)
        by_down = whole * by_down + (less * level_down) * f + vector(n_down, 0.0, 0.0)
        by_lead = whole * by_lead + (less_lead * level) * f + vector(n_lead, 0.0, 0.0)
        f = whole * f + vector(gain * normal, 0.0, 0.0)
        return strength, f, by_rise, by_down, by_lead

    return of_lateral


def measured_slope(slope: Any) -> Any:
    """Make the `slope` of a law (`RftLaw`) by (S4) and (S5)."""

    @partial(compiled, inline=True)
    def of_measured(law, g, rise, down, lead):
        strength, f, by_rise, by_down, by_lead = slope(law, g, rise, down, lead)
        n_2, across, graze = down * down, 1.0 - rise * rise, 1.0 - lead * lead
        across_2, graze_2 = across * across, graze * graze
        across_4, graze_4 = across_2 * across_2, graze_2 * graze_2
        across_7, graze_7 = across_4 * across_2 * across, graze_4 * graze_2 * graze
        tilted, steep = TILTED * 4.0 * n_2 * (1.0 - n_2), 1.0 - across_2
        k, part = 1.0 - tilted * steep, graze_7 * graze * (1.0 - across_7 * across)
        k_rise = -4.0 * tilted * across * rise
        k_down = -8.0 * TILTED * steep * (down - 2.0 * n_2 * down)
        j, j_rise = 1.0 + n_2 * part, 16.0 * n_2 * graze_7 * graze * across_7 * rise
        j_down, j_lead = 2.0 * down * part, -16.0 * n_2 * graze_7 * lead * (1.0 - across_7 * across)
        kj = k * j
        by_rise = kj * by_rise + (k_rise * j + k * j_rise) * f
        by_down = kj * by_down + (k_down * j + k * j_down) * f
        return strength, kj * f, by_rise, by_down, kj * by_lead + (k * j_lead) * f

    return of_measured
