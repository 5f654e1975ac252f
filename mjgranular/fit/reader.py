"""Runs from a YAML file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mjgranular._util.io import place
from mjgranular.errors import InputError, UnknownNameError, shown
from mjgranular.fit.body import Body
from mjgranular.fit.fit import Fit
from mjgranular.fit.known import known_medium, number
from mjgranular.fit.run import Run
from mjgranular.law import Law
from mjgranular.medium.outline import read_outline_file

LARGEST = 1_000_000
"""Size up to which a file is read [bytes]; chosen."""

EXAMPLE = """\
medium: {density: 1500, internal_friction: 0.6, surface_friction: 0.4}
runs:
  - {name: slow, kind: drop, speed: 1.0, data: slow.csv,
     body: {shape: sphere, diameter: 0.0254, mass: 0.0692}}
"""
"""An example of such a file; docs/calibration.md has all keys."""

_GRAVITY = 9.81
_NUMBERS = ("speed", "touch", "depth")
_TEXTS = ("model_body", "keyframe")
_RUN_KEYS = (
    "name", "kind", "data", "body", "angle", "height", "columns", "model", *_NUMBERS, *_TEXTS
)  # fmt: skip
_BODY_KEYS = ("shape", "diameter", "length", "mass", "density")


def read_fit(
    path: str | Path,
    *,
    law: str | Law | None = None,
    free: Sequence[str] = (),
    hold_out: Sequence[str] = (),
) -> Fit:
    """Read a medium and runs from a YAML file of the form of `EXAMPLE`.

    Data files are searched next to it. Angles are in degrees there.

    Args:
        path: path of the file.
        law: a law, or its name; None for that of the medium that the file is based on.
        free: names of the constants to fit.
        hold_out: names of runs that are predicted only.

    Raises:
        InputError: the file cannot be read, lacks a key, or has a bad value; says which.
        UnknownNameError: a law, medium, constant or run does not exist.
    """
    path = Path(path)
    outline = read_outline_file(
        path,
        "the runs",
        "runs need",
        largest=LARGEST,
        extra="fit",
        purpose="Reading runs from a file",
    )
    name = place(path)
    if not isinstance(outline, dict) or not isinstance(outline.get("runs"), list):
        raise InputError(f"{name}: runs are a list under the key runs, beside the key medium")
    for key in outline:
        if key not in ("medium", "runs"):
            raise InputError(f"{name}: no key {shown(key)}; there are: medium, runs")
    if not outline["runs"]:
        raise InputError(f"{name}: runs is empty")
    medium = known_medium(outline.get("medium"), law, path)
    runs = tuple(_run(entry, k, path) for k, entry in enumerate(outline["runs"]))
    return Fit(runs, medium, tuple(free), law, tuple(hold_out))


def _run(entry: Any, index: int, path: Path) -> Run:
    where = f"{place(path)}: runs[{index}]"
    if not isinstance(entry, dict):
        raise InputError(f"{where} must be a mapping with name, kind and data, not {shown(entry)}")
    for key in entry:
        if key not in _RUN_KEYS:
            raise InputError(f"{where} has no key {shown(key)}; there are: {', '.join(_RUN_KEYS)}")
    for key in ("name", "kind", "data"):
        if not isinstance(entry.get(key), str):
            raise InputError(f"{where} needs {key}, a text")
    values: dict[str, Any] = {
        key: number(entry[key], f"{where}.{key}") for key in _NUMBERS if entry.get(key) is not None
    }
    values |= {key: entry[key] for key in _TEXTS if entry.get(key) is not None}
    if entry.get("height") is not None:
        if "speed" in values:
            raise InputError(f"{where}: a drop has a speed at the touch or a height, not both")
        height = number(entry["height"], f"{where}.height")
        if height < 0:
            raise InputError(f"{where}: the height of a drop must not be negative, not {height} m")
        values["speed"] = math.sqrt(2 * _GRAVITY * height)
    if entry.get("angle") is not None:
        values["angle"] = math.radians(number(entry["angle"], f"{where}.angle"))
    if entry.get("model") is not None:
        values["model"] = path.parent / str(entry["model"])
    body = entry.get("body")
    if isinstance(body, str) and entry["kind"] == "model":
        values["model_body"] = body
    elif body is not None:
        values["body"] = _body(body, f"{where}.body")
    columns = entry.get("columns")
    if columns is not None and not (
        isinstance(columns, dict) and all(isinstance(c, str) for c in columns.values())
    ):
        raise InputError(f"{where}.columns maps names such as force to headings of the file")
    try:
        return Run(
            entry["name"],
            entry["kind"],
            path.parent / entry["data"],
            columns=columns or {},
            **values,
        )
    except UnknownNameError:
        raise
    except InputError as error:
        raise InputError(f"{place(path)}: {error}") from None


def _body(entry: Any, where: str) -> Body:
    if not isinstance(entry, dict):
        raise InputError(f"{where} must be a mapping with shape and diameter, not {shown(entry)}")
    for key in entry:
        if key not in _BODY_KEYS:
            raise InputError(f"{where} has no key {shown(key)}; there are: {', '.join(_BODY_KEYS)}")
    if not isinstance(entry.get("shape"), str) or entry.get("diameter") is None:
        raise InputError(f"{where} needs shape and diameter [m]")
    sizes = {
        key: number(entry[key], f"{where}.{key}")
        for key in _BODY_KEYS[1:]
        if entry.get(key) is not None
    }
    try:
        return Body(entry["shape"], **sizes)
    except UnknownNameError:
        raise
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
