"""Files of measured runs: a YAML file that describes them, next to a CSV file per run.

docs/calibration.md has all keys, and an example. At `qpos0` of a body from an MJCF file its lowest
point is at the surface; for a turning leg, the hip is at its height.

A set of runs that laws are scored against is a folder with such a file, `runs.yaml`, and
`about.json`: `title`, `source`, the `marks` of runs by name, and the names of runs that are
`guided` (the body keeps its angle) or recorded only `to_the_stop` of the lowest point.
"""

import json
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np

from mjgranular._util.io import place, read_file
from mjgranular.calibrate.fit import Fit
from mjgranular.calibrate.medium import known_medium
from mjgranular.calibrate.motion import Motion
from mjgranular.calibrate.runs import COLUMNS, Body, Kind, MeasuredRun, Run, RunSet, read_table
from mjgranular.calibrate.trial import GRAVITY
from mjgranular.errors import InputError, UnknownNameError, shown
from mjgranular.law import Law, Rft3dLaw
from mjgranular.medium.file import check_mapping, number, read_outline_file

LARGEST = 1_000_000
"""Size up to which a file is read [bytes]; chosen."""

_NUMBERS = ("speed", "depth", "angle", "height")
_NAMES = ("model_body", "keyframe")
_RUN_KEYS = ("name", "kind", "data", "body", "columns", "model", *_NUMBERS, *_NAMES)
_MEASURED_KEYS = ("name", "kind", "data", "body", "columns", "speed", "depth", "angle")
_BODY_KEYS = ("shape", "diameter", "length", "mass", "density")

_ABOUT: dict[str, Any] = {"source": "unknown", "marks": {}, "guided": [], "to_the_stop": []}
"""What a set of runs says about them by default."""


def read_fit(
    path: str | Path,
    *,
    law: str | Law | None = None,
    free: Sequence[str] = (),
    hold_out: Sequence[str] = (),
) -> Fit:
    """Read a medium and runs from a YAML file; docs/calibration.md has all keys.

    Data files are searched next to it. Angles are in degrees there.

    Args:
        path: the file.
        law: a law, or its name; None for that of the medium that the file is based on.
        free: names of the constants to fit.
        hold_out: names of runs that are predicted only.

    Raises:
        InputError: the file cannot be read, lacks a key, or has a bad value; says which.
        UnknownNameError: a law, medium, constant or run does not exist.
    """
    path = Path(path)
    content = _content(path, "fit")
    medium = known_medium(content.get("medium"), law, path)
    runs = tuple(_runs(content, path, _run))
    return Fit(runs, medium, tuple(free), law, tuple(hold_out))


def read_runs(folder: str | Path) -> RunSet:
    """Read a set of runs from its folder.

    Raises:
        InputError: a file cannot be read, is incomplete, or has a bad value; says which.
        UnknownNameError: no such kind, shape, mark or medium.
    """
    folder = Path(folder)
    path = folder / "runs.yaml"
    content = _content(path, "media")
    about = _about(folder / "about.json")
    entry = content.get("medium")
    if isinstance(entry, dict) and list(entry) == ["base"]:
        entry = str(entry["base"])
    title, source = about["title"], about["source"]
    if isinstance(entry, dict):
        entry = {"name": folder.name, "title": title, **entry}
    medium = known_medium(entry, Rft3dLaw.name, path, source=source)
    runs = tuple(_runs(content, path, partial(_measured_run, about=about)))
    return RunSet(folder.name, title, source, medium, runs)


def _content(path: Path, extra: str) -> dict[str, Any]:
    """Return the content of a file of runs, its keys checked."""
    content = read_outline_file(path, "the runs", largest=LARGEST, extra=extra)
    where = place(path)
    check_mapping(content, where, ("medium", "runs"), needed=("runs",))
    if not isinstance(content["runs"], list) or not content["runs"]:
        raise InputError(f"{where}: runs must be a list of at least one run")
    return content


def _runs(
    content: dict[str, Any], path: Path, make: Callable[[dict[str, Any], str, Path], Any]
) -> list[Any]:
    """Return the runs that `make` builds of the entries of a file, whose keys are checked."""
    found = []
    for k, entry in enumerate(content["runs"]):
        where = f"{place(path)}: runs[{k}]"
        check_mapping(entry, where, _RUN_KEYS, needed=("name", "kind", "data"))
        for key in ("name", "kind", "data"):
            if not isinstance(entry[key], str):
                raise InputError(f"{where}.{key} must be a string, got {shown(entry[key])}")
        try:
            found.append(make(entry, where, path))
        except InputError as error:
            data = path.parent / entry["data"]
            if place(path) in str(error) or place(data) in str(error):
                raise
            raise InputError(f"{place(path)}: {error}") from None
    return found


def _run(entry: dict[str, Any], where: str, path: Path) -> Run | MeasuredRun:
    """Return a run to fit to: a `MeasuredRun` where the body is in a file, but for a model."""
    if isinstance(entry.get("body"), dict) and "file" in entry["body"]:
        return _measured_run(entry, where, path, about=_ABOUT)
    values: dict[str, Any] = _numbers(entry, where)
    values |= {key: entry[key] for key in _NAMES if entry.get(key) is not None}
    if "height" in values:
        height = values.pop("height")
        if "speed" in values:
            raise InputError(f"{where}: a drop has a speed at the touch or a height, not both")
        if height < 0:
            raise InputError(f"{where}: the height of a drop must not be negative, got {height} m")
        values["speed"] = math.sqrt(2 * GRAVITY * height)
    if "angle" in values:
        values["angle"] = math.radians(values["angle"])
    if entry.get("model") is not None:
        values["model"] = path.parent / str(entry["model"])
    body = entry.get("body")
    if isinstance(body, str) and entry["kind"] == "model":
        values["model_body"] = body
    elif body is not None:
        values["body"] = _body(body, f"{where}.body")
    columns = _columns(entry, where)
    return Run(entry["name"], entry["kind"], path.parent / entry["data"], columns=columns, **values)


def _measured_run(
    entry: dict[str, Any], where: str, path: Path, *, about: dict[str, Any]
) -> MeasuredRun:
    name, kind = entry["name"], entry["kind"]
    if kind not in get_args(Kind):
        raise UnknownNameError("kind of run", kind, get_args(Kind))
    check_mapping(entry, where, _MEASURED_KEYS)
    numbers = _numbers(entry, where)
    if entry.get("body") is None:
        raise InputError(f"{where} needs body, such as {{shape: sphere, diameter: 0.0254}}")
    if isinstance(entry["body"], dict) and set(entry["body"]) == {"file"}:
        body = path.parent / str(entry["body"]["file"])
    else:
        shape = _body(entry["body"], f"{where}.body")
        if kind == "drop" and not shape.is_heavy:
            raise InputError(f"{where}.body: a body that is dropped needs its mass [kg]")
        body = shape.projectile
    found: dict[str, Any] = read_table(
        path.parent / entry["data"], *COLUMNS[kind], _columns(entry, where)
    )
    if kind == "drag" and "depth" not in {*found, *numbers}:
        raise InputError(f"{where}: a drag needs the depth of the body's lowest point [m]")
    rows = len(next(iter(found.values())))
    found.setdefault("depth", np.full(rows, numbers.get("depth", math.nan)))
    return MeasuredRun(
        name=name,
        kind=kind,
        body=body,
        motion=Motion(**found, to_the_stop=name in about["to_the_stop"]),
        guided=name in about["guided"],
        mark=about["marks"].get(name, "seen"),
        **numbers,
    )


def _numbers(entry: dict[str, Any], where: str, keys: Sequence[str] = _NUMBERS) -> dict[str, float]:
    given = [key for key in keys if entry.get(key) is not None]
    return {key: number(entry[key], f"{where}.{key}") for key in given}


def _columns(entry: dict[str, Any], where: str) -> dict[str, str]:
    columns = entry.get("columns") or {}
    if not (isinstance(columns, dict) and all(isinstance(c, str) for c in columns.values())):
        raise InputError(f"{where}.columns maps names such as force to headings of the file")
    return columns


def _body(entry: Any, where: str) -> Body:
    check_mapping(entry, where, _BODY_KEYS, needed=("shape", "diameter"))
    sizes = _numbers(entry, where, _BODY_KEYS[1:])
    try:
        return Body(entry["shape"], **sizes)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _about(file: Path) -> dict[str, Any]:
    """Return title, source and marks of a set; defaults if the file does not exist."""
    plain = {"title": file.parent.name, **_ABOUT}
    if not file.exists():
        return plain
    try:
        found = json.loads(read_file(file, "the provenance", largest=LARGEST))
    except ValueError:
        raise InputError(f"{place(file)} is not JSON") from None
    if not isinstance(found, dict):
        raise InputError(f"{place(file)} is a mapping with title, source and marks")
    about = {**plain, **found}
    for key, default in plain.items():
        if not isinstance(about[key], type(default)):
            kind = {str: "a string", dict: "a mapping", list: "a list"}[type(default)]
            raise InputError(f"{place(file)}: {key} must be {kind}, got {shown(about[key])}")
    return about
