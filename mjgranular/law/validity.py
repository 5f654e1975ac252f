"""Validity of laws: limits and found errors as data, and motions held against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from mjgranular.law.error_table import FOUND, SOURCE

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


@dataclass(frozen=True)
class Finding:
    """The error that was found where a law was held against measured motion.

    Attributes:
        froude: greatest Froude number of these runs.
        grains: least width of their bodies, in grains.
        error: the worst of them, of whole trajectories: root-mean-square of the error in depth over
            time in parts of the final depth, or in force in parts of the greatest force.
        runs: how many.
        source: the page that has them.
    """

    froude: float
    grains: float
    error: float
    runs: int
    source: str = SOURCE


def findings_of(name: str) -> tuple[Finding, ...]:
    """What was found for a law, by the name it has on the page of validity."""
    return tuple(Finding(*numbers) for numbers in FOUND.get(name, ()))


def found_at(
    findings: Sequence[Finding], froude: float, grains: float | None = None
) -> Finding | None:
    """The finding that tells most of a motion; None where nothing as fast or thin was compared.

    Of the runs at least as fast and as thin those of the slowest group, and of these the widest.

    Args:
        findings: of the law.
        froude: of the motion.
        grains: width of the body in grains; None where it is not known, and is taken for great.
    """
    fit = [f for f in findings if f.froude >= froude and (grains is None or f.grains <= grains)]
    return min(fit, key=lambda f: (f.froude, -f.grains), default=None)
