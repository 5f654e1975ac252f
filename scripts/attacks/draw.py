"""Draw a model and its events from a seed and a number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from attacks import changes, models

import mjgranular

SHARES = (0.4, 0.3, 0.2, 0.1)
"""Weights of the kinds of events."""

RESTING = ("link_distributed", "rft2d", "rft3d", *models.MOVING)
"""Laws under which everything comes to rest."""


@dataclass
class Drawn:
    """The case of a seed and a number."""

    model: models.Drawn
    kind: str
    plan: changes.Plan


def draw(
    seed: int,
    number: int,
    steps: int,
    programs: Sequence[tuple[str, str, str]] = models.PROGRAMS,
    kind: str | None = None,
) -> Drawn:
    """Draw a model, its sand, and its events."""
    rng = np.random.default_rng([seed, number])
    chosen = str(rng.choice(changes.KINDS, p=SHARES))
    program = programs[int(rng.integers(len(programs)))]
    kind = kind or chosen
    if kind == "rest":
        still = [p for p in programs if p[0] in RESTING and p[1:] == ("plane", "implicit")]
        still = still or [("link_distributed", "plane", "implicit")]
        made = models.draw_at_rest(rng, still[int(rng.integers(len(still)))])
    else:
        made = models.draw(rng, program)
    return Drawn(made, kind, changes.plan(rng, kind, steps))


def arguments(sand: str) -> dict[str, Any]:
    """Parse the arguments of `Sand` from a string."""
    return eval(f"dict({sand})", vars(mjgranular).copy())
