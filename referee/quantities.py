"""Relative errors by quantity (depth, stopping time, lift, ...), with their bias and spread."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mjgranular.calibrate.motion import gain

if TYPE_CHECKING:
    from comparison import Comparison

QUANTITIES = {
    "depth": "depth of a dropped body",
    "stop": "stopping time of a dropped body",
    "push": "force against a push",
    "drag": "drag",
    "lift": "lift on a dragged body or a turning leg",
    "thrust": "thrust of a leg",
    "walk": "walking speed",
    "bear": "vertical force on a wheel at given sinkage",
    "pull": "pull of a wheel free to sink",
    "sinkage": "sinkage of a wheel free to sink",
}
"""Quantities, in the order of the page."""

NOT_MEASURED = ("paper_link",)
"""Sets that were computed from a law."""


@dataclass(frozen=True)
class Value:
    """Relative error of one quantity in one run; positive if the law gives too much."""

    comparison: Comparison
    quantity: str
    error: float


@dataclass(frozen=True)
class Accuracy:
    """Mean and sample standard deviation of errors; None if there are too few of them."""

    bias: float | None
    spread: float | None
    values: int


def values(found: list[list[Comparison]]) -> list[Value]:
    """Return the errors of all measured runs that no constant of the law was fitted to."""
    judged = (
        c
        for group in found
        for c in group
        if c.errors is not None and c.mark != "fitted to" and c.runs.name not in NOT_MEASURED
    )
    return [Value(c, name, error) for c in judged for name, error in _errors(c)]


def accuracy(chosen: Iterable[Value]) -> Accuracy:
    """Return bias and spread."""
    errors = [value.error for value in chosen]
    return Accuracy(
        bias=float(np.mean(errors)) if errors else None,
        spread=float(np.std(errors, ddof=1)) if len(errors) > 1 else None,
        values=len(errors),
    )


def _errors(c: Comparison) -> Iterable[tuple[str, float]]:
    """Return errors by quantity; each row of a drag, a wheel or a walk is a run of its own."""
    run, motion, e = c.run.motion, c.motion, c.errors
    assert e is not None
    assert motion is not None

    def rows(name: str, column: str) -> Iterable[tuple[str, float]]:
        measured, computed = getattr(run, column), getattr(motion, column)
        if measured is None:
            return []
        return [(name, float(b / a) - 1) for a, b in zip(measured, computed, strict=True)]

    if c.run.kind == "drop":
        return [
            ("depth", e.final),
            *([] if e.stopping_time is None else [("stop", e.stopping_time)]),
        ]
    if c.run.kind == "intrude":
        return [("push", e.final)]
    if c.run.kind == "drag":
        return [*rows("drag", "force"), *rows("lift", "lift")]
    if c.run.kind == "walk":
        return rows("walk", "speed")
    if c.run.kind == "turn":
        assert e.lift is not None
        return [("thrust", e.final), ("lift", e.lift)]
    if c.run.kind == "roll":
        return rows("bear", "lift")
    # Many of the wheel's forces are near zero: vectors are compared by least squares.
    measured, computed = (np.array([m.force, m.side]).ravel() for m in (run, motion))
    return [("pull", gain(measured, computed)), *rows("sinkage", "depth")]
