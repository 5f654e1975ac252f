"""Largest errors of each law by kind of motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from quantities import NOT_MEASURED

if TYPE_CHECKING:
    from comparison import Comparison

    from mjgranular.calibrate import Run

_GUIDED = ("intrude", "drag")

SLOW, SLOW_SPHERE = 0.4, 2.5  # largest Froude number of a slow push or drag, and of a slow sphere
THIN = 5  # grains across a rod; all three chosen


def _is_sphere(run: Run) -> bool:
    return run.kind == "drop" and run.shape == "sphere"


MOTIONS: dict[str, Callable[[Run, float], bool]] = {
    "slow pushes and drags": lambda r, g: r.kind in _GUIDED and r.froude <= SLOW,
    "fast drags": lambda r, g: r.kind in _GUIDED and r.froude > SLOW,
    "turning legs": lambda r, g: r.kind == "turn",
    "wheels at given sinkage": lambda r, g: r.kind == "roll",
    "wheels free to sink": lambda r, g: r.kind == "sink",
    "walking robots": lambda r, g: r.kind == "walk",
    "slow spheres": lambda r, g: _is_sphere(r) and r.froude <= SLOW_SPHERE,
    "fast spheres": lambda r, g: _is_sphere(r) and r.froude > SLOW_SPHERE,
    "flat feet": lambda r, g: r.shape == "plate" and r.kind == "drop",
    "rods": lambda r, g: r.shape == "capsule" and g >= THIN,
    "thin rods": lambda r, g: r.shape == "capsule" and g < THIN,
}
"""Kinds of motion: whether a run belongs, by the run and its width in grains."""


@dataclass(frozen=True)
class Range:
    """Errors of one law in one kind of motion; of fitted runs only if there are no others."""

    law: str
    motion: str
    runs: int
    fitted: bool
    best: float
    worst: float
    worst_final: float
    stops: tuple[float, float] | None


def ranges(found: list[list[Comparison]]) -> list[Range]:
    """Return the range of errors for each law and motion that were compared."""
    measured = [
        c
        for group in found
        for c in group
        if c.errors is not None and c.runs.name not in NOT_MEASURED
    ]
    out = []
    for law in dict.fromkeys(c.candidate.name for c in measured):
        for motion, belongs in MOTIONS.items():
            mine = [c for c in measured if c.candidate.name == law and belongs(c.run, _grains(c))]
            judged = [c for c in mine if c.mark != "fitted to"]
            errors = [c.errors for c in judged or mine if c.errors is not None]
            if not errors:
                continue
            stops = [e.stopping_time for e in errors if e.stopping_time is not None]
            out.append(
                Range(
                    law=law,
                    motion=motion,
                    runs=len(errors),
                    fitted=not judged,
                    best=min(e.trajectory for e in errors),
                    worst=max(e.trajectory for e in errors),
                    worst_final=max(abs(e.final) for e in errors),
                    stops=(min(stops), max(stops)) if stops else None,
                )
            )
    return out


def _grains(c: Comparison) -> float:
    grain = c.runs.medium.grain
    return c.run.width / grain.value if grain is not None else 100.0
