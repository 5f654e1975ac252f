"""Validity of laws: limits as data, and motions held against them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Measure = Literal["froude", "inertial_number", "depth_over_width", "slope"]

MEANING: dict[Measure, str] = {
    "froude": "|v| / sqrt(g w), w the geom's width",
    "inertial_number": "(|v| / w) d sqrt(rho / (rho g z)), d the grain's diameter, z the depth",
    "depth_over_width": "depth over the geom's width",
    "slope": "angle of the surface against the horizontal [rad]",
}
"""Meaning of each measure; all but the slope are the greatest over a body's wet elements."""


@dataclass(frozen=True)
class Limit:
    """A bound on one measure.

    Attributes:
        measure: what is bounded; `MEANING` says how it is worked out.
        most: the law holds up to this value.
        source: who says so.
    """

    measure: Measure
    most: float
    source: str


@dataclass(frozen=True)
class Standing:
    """Standing of a body against a limit.

    Attributes:
        limit: the limit.
        value: the measure now; None where it cannot be told (no grain size is known).
        holds: whether it is within the limit; true where it cannot be told.
    """

    limit: Limit
    value: float | None

    @property
    def holds(self) -> bool:
        return self.value is None or self.value <= self.limit.most
