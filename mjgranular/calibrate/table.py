"""Tables of measurements: CSV columns found by name, converted to SI units."""

import csv
import io
import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

import numpy as np

from mjgranular._util.checks import check_name
from mjgranular._util.io import place, read_file
from mjgranular._util.parse import parse_number
from mjgranular.errors import InputError, listed, shown

_LARGEST = 50_000_000  # size up to which a table is read [bytes]; chosen

_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
_FORCES = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "MN": 1e6}
_ANGLES = {"deg": 1.0, "degrees": 1.0, "rad": 180.0 / np.pi}
_HEADINGS: dict[str, tuple[tuple[str, ...], dict[str, float]]] = {
    "time": (("time", "t"), _TIMES),
    "depth": (("depth",), _LENGTHS),
    "force": (("force", "f", "resistance"), _FORCES),
    "pitch": (("pitch", "angle"), _ANGLES),
    "speed": (("speed", "velocity", "v"), {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2}),
    "lift": (("lift",), _FORCES),
    "side": (("side force", "side"), _FORCES),
    "angle": (("angle",), _ANGLES),
    "spin": (("spin",), {"rad/s": 1.0}),
    "rate": (("rate",), {"Hz": 1.0}),
}
"""Headings of each column in lower case, and factors of its units."""


def read_table(
    path: Path,
    needed: Iterable[str],
    optional: Iterable[str] = (),
    columns: Mapping[str, str] | None = None,
) -> dict[str, np.ndarray]:
    """Read needed and optional columns of a CSV file, in SI units and degrees.

    A heading is a name with its unit, `depth [mm]`, `depth (mm)` or `depth_mm`; without one it is
    SI. Other columns are ignored, as are lines that start with `#`. `columns` has other headings.
    """
    known, columns = (*needed, *optional), columns or {}
    for column in columns:
        check_name(f"column of {place(path)}", column, known)
    text = read_file(path, "the measurement", largest=_LARGEST).decode("utf-8-sig", "replace")
    name = place(path)
    if "\0" in text:  # a workbook, or UTF-16
        raise InputError(f"{name} is not a text file: save the table as CSV in UTF-8")
    try:
        rows = [
            (line, row)
            for line, row in enumerate(csv.reader(io.StringIO(text)), 1)
            if any(cell.strip() for cell in row) and not row[0].startswith("#")
        ]
    except csv.Error as error:
        raise InputError(f"{name} is not a table: {error}; a quote may not be closed") from None
    if len(rows) < 2:
        raise InputError(f"{name} must have a line of headings and rows of numbers below it")
    headings = [cell.strip() for cell in rows[0][1]]
    if len(headings) == 1 and any(mark in headings[0] for mark in ";\t"):
        raise InputError(
            f"{name} has no commas: columns are separated by commas, and numbers have points"
        )
    if None not in map(parse_number, headings):
        raise InputError(f"{name} begins with numbers: its first line must name the columns")
    for line, row in rows[1:]:
        if any(map(str.strip, row[len(headings) :])):
            raise InputError(f"{name}, line {line}: more cells than headings; numbers have points")
    places = {column: _find(headings, column, columns.get(column), name) for column in known}
    for column in needed:
        if places[column] is None:
            raise InputError(
                f"{name} has no column {column!r}: it has {listed(headings)}; name the one that is "
                f"meant with columns: {{{column}: HEADING}}"
            )
    return {
        column: at[1] * np.array([_number(row, at[0], line, name) for line, row in rows[1:]])
        for column, at in places.items()
        if at is not None
    }


def _find(
    headings: list[str], column: str, called: str | None, name: str
) -> tuple[int, float] | None:
    """Return the place of a column among the headings, and the factor of its unit."""
    if called is not None and called not in headings:
        raise InputError(f"{name} has no column {shown(called)}: it has {listed(headings)}")
    names, units = _HEADINGS[column]
    # In lower case too, for headings in capitals; of mN and MN the first counts.
    factors = {unit.lower(): factor for unit, factor in reversed(units.items())} | units
    parts = [_split(heading, factors) for heading in headings]
    plain = headings if called else [stem for stem, _ in parts]
    chosen = called or next((known for known in names if known in plain), None)
    if chosen is None:
        return None
    if plain.count(chosen) > 1:
        raise InputError(f"{name} has {plain.count(chosen)} columns {shown(chosen)}: rename one")
    index = plain.index(chosen)
    unit = parts[index][1]
    if unit is None:
        return index, 1.0
    factor = factors.get(unit, factors.get(unit.lower()))
    if factor is None:
        raise InputError(
            f"{name}: {shown(headings[index])} must be in one of {listed(units)}, got {shown(unit)}"
        )
    return index, factor


def _split(heading: str, units: Collection[str]) -> tuple[str, str | None]:
    """Return the name of a heading in lower case, and its unit; None for no unit."""
    bracket = re.fullmatch(r"(.*?)\s*[\[(]\s*(.*?)\s*[\])]", heading)
    if bracket:
        return bracket[1].strip().lower(), bracket[2]
    stem, _, tail = heading.rpartition("_")
    return (stem.lower(), tail) if stem and tail.lower() in units else (heading.lower(), None)


def _number(row: list[str], index: int, line: int, name: str) -> float:
    cell = row[index].strip() if index < len(row) else ""
    number = parse_number(cell)
    if number is None or not np.isfinite(number):
        raise InputError(f"{name}, line {line}: {shown(cell)} is not a finite number")
    return number
