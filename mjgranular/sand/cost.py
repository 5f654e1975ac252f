"""Rough cost of the sand per step, by the number of elements."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from mjgranular.scheme import Explicit, Scheme
from mjgranular.shape.sizes import RESOLUTION

MANY = 20_000
"""Number of elements above which a warning is given. Chosen: with all of them in the sand a step
takes twice the two milliseconds that models of robots have for a time step."""

# Per element [s], from docs/benchmarks.md and, for many bodies, benchmarks/meshes.py.
_ABOVE = 2e-9
_EXPLICIT = 16e-9
_IMPLICIT = 0.2e-6


@dataclass(frozen=True)
class Cost:
    """What the sand adds to a step [s], within a factor of two on today's machines."""

    above: float  # with all elements above the sand
    within: float  # with all of them in it

    @classmethod
    def of(cls, count: int, scheme: Scheme) -> Self:
        """Return the cost of `count` elements."""
        each = _EXPLICIT if isinstance(scheme, Explicit) else _IMPLICIT
        return cls(count * _ABOVE, count * each)

    def __str__(self) -> str:
        above, within = (f"{1e3 * seconds:.1g} ms" for seconds in (self.above, self.within))
        return f"roughly {above} a step above the sand, {within} with everything in it"


def coarser(elements: np.ndarray, resolution: int | None, most: int) -> str:
    """Return advice on how to get fewer elements, at most `most` of them."""
    advice = "take fewer geoms"
    if "normal" not in (elements.dtype.names or ()):
        return advice
    # The count grows with its square; edges are cut into an integer number, hence one less.
    fits = math.floor((resolution or RESOLUTION) * math.sqrt(most / len(elements)))
    lower = max(2, fits - 1)
    return f"resolution={lower} would make some {most:,}, or {advice}"
