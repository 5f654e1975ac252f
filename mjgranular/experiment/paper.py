"""The paper's table: six drops with their printed stopping times and depths."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from mjgranular._util.checks import check_kind
from mjgranular.experiment.fall import run_impact
from mjgranular.experiment.impact import Impact, ImpactResult


@dataclass(frozen=True)
class PaperCase:
    """One drop of the paper.

    Attributes:
        speed: v_Ty(0) [m/s].
        angle_deg: q(0) [degrees].
        stopping_time: printed value [s].
        depth: printed y_T at the stop [m].
        figure: number of the paper's figure that shows it.
    """

    speed: float
    angle_deg: float
    stopping_time: float
    depth: float
    figure: int


# Lee and Marghitu, Stopping Time for a Planar Link in Contact with a Granular Material, section 4.
CASES = (
    PaperCase(10, 45, 0.007363, 0.032508, 2),
    PaperCase(5, 45, 0.013261, 0.030973, 3),
    PaperCase(1, 45, 0.032544, 0.021550, 4),
    PaperCase(2, 60, 0.017698, 0.017961, 6),
    PaperCase(2, 45, 0.023452, 0.026098, 7),
    PaperCase(2, 30, 0.029802, 0.036668, 8),
)


def reproduce(
    base: Impact, *, progress: Callable[[int], None] | None = None
) -> list[tuple[PaperCase, ImpactResult]]:
    """Run the six cases.

    Args:
        base: time step, scheme and law; its speed and angle are not used.
        progress: called with the number of finished cases.
    """
    check_kind(base, Impact, "reproduce")
    results = []
    for done, case in enumerate(CASES, start=1):
        impact = replace(base, speed=case.speed, angle=math.radians(case.angle_deg))
        results.append((case, run_impact(impact)))
        if progress is not None:
            progress(done)
    return results
