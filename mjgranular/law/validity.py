"""Validity of laws: limits and measured errors as data, and motions compared with them."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

Measure = Literal["froude", "inertial_number", "depth_over_width", "slope"]
"""froude is |v| / sqrt(g w), with an element's width w; inertial_number (|v| / w) d sqrt(rho /
(rho g z)), with the grain's diameter d and the depth z, at least d; depth_over_width z / w; slope
the angle of the surface against the horizontal [rad]. The first three are the greatest over a
body's immersed elements."""


@dataclass(frozen=True)
class Limit:
    """A bound on one measure.

    Attributes:
        measure: bounded quantity, one of `Measure`.
        most: the law holds up to this value.
        source: source of the bound.
    """

    measure: Measure
    most: float
    source: str


@dataclass(frozen=True)
class Standing:
    """A body compared with a limit.

    Attributes:
        value: the measure now; None if it is unknown (no grain size).
        holds: whether it is within the limit; true if it is unknown.
    """

    limit: Limit
    value: float | None

    @property
    def holds(self) -> bool:
        return self.value is None or self.value <= self.limit.most


@dataclass(frozen=True)
class Finding:
    """The error of a law against measured motion.

    Attributes:
        froude: greatest Froude number of these runs.
        grains: least width of their bodies, in grains.
        error: the worst of them, of whole trajectories: root-mean-square error of depth over time
            relative to the final depth, or of force relative to the greatest force.
        runs: number of runs.
        source: page that lists them.
    """

    froude: float
    grains: float
    error: float
    runs: int
    source: str = "docs/validity.md"


@cache
def findings_of(name: str) -> tuple[Finding, ...]:
    """Return the errors of a law, by its name on the page of validity.

    The table is written by `python referee/validate.py`.
    """
    with Path(__file__).with_name("error_table.csv").open(encoding="utf-8") as file:
        return tuple(
            Finding(
                float(row["froude"]), float(row["grains"]), float(row["error"]), int(row["runs"])
            )
            for row in csv.DictReader(file)
            if row["law"] == name
        )


def found_at(
    findings: Sequence[Finding], froude: float, grains: float | None = None
) -> Finding | None:
    """Return the most relevant finding for a motion; None if no run was as fast or thin.

    Of the runs at least as fast and as thin it is the slowest group, and of these the widest. The
    width is in grains; None counts as wide.
    """
    fit = [f for f in findings if f.froude >= froude and (grains is None or f.grains <= grains)]
    return min(fit, key=lambda f: (f.froude, -f.grains), default=None)
