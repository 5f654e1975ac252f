"""A medium of one's own, from a YAML file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mjgranular.errors import InputError
from mjgranular.extras import need
from mjgranular.medium.medium import Medium, Quantity

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
"""What such a file looks like. `grain: {value: ..., unit: m, source: ...}` is optional."""

_REQUIRED = ("name", "title", "density", "default_law", "constants")


def read_medium(path: Path) -> Medium:
    """Reads a medium from a YAML file of the form of `EXAMPLE`.

    Raises:
        InputError: the file cannot be read, lacks a key, or a value is not a number or outside
            its range; says which.
    """
    yaml = need("yaml", extra="media", purpose="Reading a medium from a file")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read the medium {path}: {error.strerror or error}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: a medium is a mapping with the keys {', '.join(_REQUIRED)}")
    known = {*_REQUIRED, "grain"}
    for key in _REQUIRED:
        if key not in content:
            raise InputError(f"{path}: the key {key!r} is missing; needed: {', '.join(_REQUIRED)}")
    for key in content:
        if key not in known:
            raise InputError(f"{path}: no key {key!r} in a medium; there are: {sorted(known)}")
    if not isinstance(content["constants"], dict):
        raise InputError(f"{path}: constants must map names of laws to their constants")
    constants = {}
    for law, values in content["constants"].items():
        if not isinstance(values, dict):
            raise InputError(f"{path}: constants.{law} must map names to values")
        constants[str(law)] = {
            str(key): _quantity(path, f"constants.{law}.{key}", value)
            for key, value in values.items()
        }
    grain = content.get("grain")
    return Medium(
        name=str(content["name"]),
        title=str(content["title"]),
        density=_quantity(path, "density", content["density"]),
        grain=None if grain is None else _quantity(path, "grain", grain),
        default_law=str(content["default_law"]),
        constants=constants,
    )


def _quantity(path: Path, key: str, entry: Any) -> Quantity:
    if not isinstance(entry, dict) or "value" not in entry or "source" not in entry:
        raise InputError(
            f"{path}: {key} must be {{value: NUMBER, unit: UNIT, source: WHERE FROM}}, "
            f"not {entry!r}"
        )
    value = entry["value"]
    try:
        # YAML takes 1e-3 for a text: it wants 1.0e-3.
        number = float(value) if isinstance(value, (int, float, str)) else None
    except ValueError:
        number = None
    if number is None or isinstance(value, bool):
        raise InputError(f"{path}: {key}.value must be a number, not {value!r}")
    return Quantity(number, str(entry.get("unit", "")), str(entry["source"]))
