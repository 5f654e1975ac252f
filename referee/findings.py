"""Reduction of comparisons to the error table that reports use."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from comparison import Comparison

BANDS = (0.4, 1.5, 2.5, 4.0, 7.0, 10.0)
"""Froude numbers that separate groups of runs; chosen, 0.4 is the limit of quasi-static RFT."""

_WIDE = 5.0  # grains across a body that counts as wide; chosen
_FORCES = ("drop", "intrude", "drag")  # too little is measured for legs, wheels and robots
_NOT_MEASURED = ("paper_link",)

Row = tuple[float, float, float, int]


def findings(found: list[list[Comparison]]) -> dict[str, list[Row]]:
    """Return by law: largest Froude number, least width in grains, worst error, number of runs.

    Runs that a constant of the law was fitted to do not test other motion, and are omitted. A run
    counts in the group of its largest Froude number. It passes through all slower motion too, but
    runs that are slow throughout are a better test of that.
    """
    table: dict[str, dict[tuple[int, bool], list[tuple[float, float, float]]]] = {}
    for comparison in (c for group in found for c in group):
        if comparison.errors is None or comparison.mark == "fitted to":
            continue
        if comparison.runs.name in _NOT_MEASURED or comparison.run.kind not in _FORCES:
            continue
        run, grain = comparison.run, comparison.runs.medium.grain
        grains = run.width / grain.value if grain is not None else 100.0
        band = next((i for i, top in enumerate(BANDS) if run.froude <= top), None)
        if band is None:
            continue
        groups = table.setdefault(comparison.candidate.name, {})
        key = (band, grains >= _WIDE)
        groups.setdefault(key, []).append((run.froude, grains, comparison.errors.trajectory))
    out: dict[str, list[Row]] = {}
    for law, groups in table.items():
        rows = []
        for (_, _), members in sorted(groups.items()):
            froude = max(m[0] for m in members)
            grains = min(min(m[1] for m in members), 100.0)
            worst = max(m[2] for m in members)
            rows.append((round(froude, 2), round(grains, 1), round(worst, 3), len(members)))
        out[law] = sorted(rows)
    return out


def write_findings(file: Path, found: list[list[Comparison]]) -> None:
    """Write `mjgranular/law/error_table.csv`."""
    with file.open("w", newline="", encoding="utf-8") as table:
        writer = csv.writer(table, lineterminator="\n")
        writer.writerow(("law", "froude", "grains", "error", "runs"))
        for law, rows in findings(found).items():
            writer.writerows((law, *row) for row in rows)
