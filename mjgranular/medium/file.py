"""A custom medium, from a YAML file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mjgranular._util.checks import kind_of
from mjgranular._util.io import place
from mjgranular._util.parse import parse_number
from mjgranular.errors import InputError, shown
from mjgranular.medium.medium import Medium, Quantity
from mjgranular.medium.outline import read_outline_file

LARGEST = 100_000
"""Size up to which a file is read [bytes]; chosen, ten times what a medium with every law needs."""

EXAMPLE = """\
name: my_sand
title: Sand of the beach at home
density: {value: 1500, unit: kg/m^3, source: weighed}
default_law: link
constants:
  link:
    eta_d: {value: 6.5, source: guessed}
    eta_h: {value: 8, source: guessed}
    eta_v: {value: 22, source: guessed}
    exponent: {value: 1.1, source: guessed}
"""
"""An example of such a file. `grain: {value: ..., unit: m, source: ...}` is optional."""

_REQUIRED = ("name", "title", "density", "default_law", "constants")


def read_medium(path: str | Path) -> Medium:
    """Read a medium from a YAML file of the form of `EXAMPLE`.

    The file may be untrusted: nothing in it is executed, and no more is read than a medium needs
    (`LARGEST`, `medium.outline`).

    Raises:
        InputError: the path cannot be read, is not a file, or is too large; a key is missing; or a
            value is not a number or out of range; says which.
    """
    if not isinstance(path, (str, Path)):
        raise InputError(f"a medium is read from a file, not from {kind_of(path)}")
    path = Path(path)
    outline = read_outline_file(path, "the medium", largest=LARGEST, extra="media")
    try:
        return _medium(outline)
    except InputError as error:
        raise InputError(f"{place(path)}: {error}") from None


def _medium(content: Any) -> Medium:
    if not isinstance(content, dict):
        raise InputError(f"a medium is a mapping with the keys {', '.join(_REQUIRED)}")
    known = {*_REQUIRED, "grain"}
    for key in _REQUIRED:
        if key not in content:
            raise InputError(f"the key {key!r} is missing; needed: {', '.join(_REQUIRED)}")
    for key in content:
        if key not in known:
            raise InputError(f"no key {shown(key)} in a medium; there are: {sorted(known)}")
    if not isinstance(content["constants"], dict):
        raise InputError("constants must map names of laws to their constants")
    constants = {}
    for law, values in content["constants"].items():
        if not isinstance(values, dict):
            raise InputError(f"constants.{_key(law)} must map names to values")
        constants[law] = {
            key: _quantity(f"constants.{_key(law)}.{_key(key)}", value)
            for key, value in values.items()
        }
    grain = content.get("grain")
    return Medium(
        name=_text("name", content["name"]),
        title=_text("title", content["title"]),
        density=_quantity("density", content["density"]),
        grain=None if grain is None else _quantity("grain", grain),
        default_law=_text("default_law", content["default_law"]),
        constants=constants,
    )


def _quantity(key: str, entry: Any) -> Quantity:
    if not isinstance(entry, dict) or "value" not in entry or "source" not in entry:
        raise InputError(
            f"{key} must be {{value: NUMBER, unit: UNIT, source: WHERE FROM}}, not {shown(entry)}"
        )
    unit = entry.get("unit")
    return Quantity(
        _number(f"{key}.value", entry["value"]),
        "" if unit is None else _text(f"{key}.unit", unit),
        _text(f"{key}.source", entry["source"]),
    )


def _number(key: str, value: Any) -> float:
    """Parse a number in Python's notation, or YAML's .inf or .nan."""
    plain = str(value).lower().replace(".inf", "inf").replace(".nan", "nan")
    number = parse_number(plain) if isinstance(value, str) else None
    if number is None:
        raise InputError(f"{key} must be a number, not {shown(value)}")
    return number


def _text(key: str, value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(f"{key} must be a text, not {shown(value)}")
    return value


def _key(key: str) -> str:
    return shown(key)[1:-1]
