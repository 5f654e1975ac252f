"""CSV files beside the validity page: every error behind it."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from findings import findings
from motions import ranges
from quantities import QUANTITIES, accuracy, values

if TYPE_CHECKING:
    from comparison import Comparison

_DATA = Path(__file__).parent / "data"

FILES = {
    "quantities.csv": "the table above for every law",
    "values.csv": "each error that it averages",
    "motions.csv": "the range of errors of each law by kind of motion",
    "runs.csv": "every law in every run",
    "constants.csv": "the constants of each law in each set",
    "sets.csv": "sources of the sets, and doubts about them",
    "reported_errors.csv": "the errors that a report gives",
}
"""Names of the files, with their content."""


def write_tables(folder: Path, found: list[list[Comparison]]) -> None:
    """Write the files of `FILES`; errors are fractions, angles are in degrees."""
    folder.mkdir(parents=True, exist_ok=True)
    tables = (_quantities, _values, _motions, _runs, _constants, _sets, _reported)
    for name, table in zip(FILES, tables, strict=True):
        with (folder / name).open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(table(found))


def about(name: str) -> dict[str, str]:
    """Return the description of a set."""
    return json.loads((_DATA / name / "about.json").read_text())


def _number(value: float | None) -> str:
    return "" if value is None else f"{round(value, 3):g}"


_Rows = Iterable[Sequence[object]]


def _quantities(found: list[list[Comparison]]) -> _Rows:
    yield "law", "quantity", "data", "bias", "spread", "values"
    all_ = values(found)
    for law in dict.fromkeys(v.comparison.candidate.name for v in all_):
        mine = [v for v in all_ if v.comparison.candidate.name == law]
        for quantity, title in QUANTITIES.items():
            here = [v for v in mine if v.quantity == quantity]
            blind = [v for v in here if v.comparison.mark == "blind"]
            for data, chosen in (("all", here), ("blind", blind)):
                a = accuracy(chosen)
                if a.values:
                    yield law, title, data, _number(a.bias), _number(a.spread), a.values


def _values(found: list[list[Comparison]]) -> _Rows:
    yield "law", "set", "run", "label", "quantity", "error"
    for value in values(found):
        c = value.comparison
        yield (
            *(c.candidate.name, c.runs.name, c.run.name, c.mark),
            *(QUANTITIES[value.quantity], _number(value.error)),
        )


def _motions(found: list[list[Comparison]]) -> _Rows:
    yield (
        *("law", "motion", "runs", "fitted", "best trajectory", "worst trajectory"),
        *("worst final", "lowest stop", "highest stop"),
    )
    for r in ranges(found):
        low, high = r.stops or (None, None)
        yield (
            *(r.law, r.motion, r.runs, "yes" if r.fitted else "no", _number(r.best)),
            *(_number(r.worst), _number(r.worst_final), _number(low), _number(high)),
        )


def _runs(found: list[list[Comparison]]) -> _Rows:
    yield (
        *("set", "run", "Froude number", "law", "label", "trajectory", "final", "stop", "peak"),
        *("pitch [degrees]", "lift", "sinkage"),
    )
    for c in (c for group in found for c in group):
        if c.errors is None:
            continue
        e = c.errors
        errors = (e.trajectory, e.final, e.stopping_time, e.peak, e.pitch, e.lift, e.depth)
        yield (
            *(c.runs.name, c.run.name, f"{c.run.froude:.2g}", c.candidate.name, c.mark),
            *map(_number, errors),
        )


def _constants(found: list[list[Comparison]]) -> _Rows:
    yield "set", "law", "constants"
    for group in found:
        constants = {c.candidate.name: c.candidate.constants for c in group if c.errors}
        yield from ((group[0].runs.name, law, text) for law, text in constants.items())


def _sets(found: list[list[Comparison]]) -> _Rows:
    yield "set", "title", "source", "doubts"
    for group in found:
        runs = group[0].runs
        yield runs.name, runs.title, runs.source, about(runs.name).get("doubts", "")


def _reported(found: list[list[Comparison]]) -> _Rows:
    yield "law", "Froude number to", "grains across", "error", "runs"
    for law, rows in findings(found).items():
        for froude, grains, error, runs in rows:
            yield law, f"{froude:g}", f"{grains:g}", f"{error:g}", runs
