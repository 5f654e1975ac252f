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

from mjgranular._util.checks import check_name
from mjgranular._util.io import place, read_file
from mjgranular.calibrate.fit import Fit
from mjgranular.calibrate.medium import known_medium
from mjgranular.calibrate.runs import COLUMNS, GRAVITY, Body, Kind, Run, RunSet, motion_of
from mjgranular.calibrate.table import read_table
from mjgranular.errors import InputError, shown
from mjgranular.law import Law, Rft3dLaw
from mjgranular.medium.file import check_mapping, number, read_outline_file

LARGEST = 1_000_000  # size up to which a file is read [bytes]; chosen

_NUMBERS = ("speed", "depth", "angle", "height")
_NAMES = ("model_body", "keyframe")
_RUN_KEYS = ("name", "kind", "data", "body", "columns", "model", *_NUMBERS, *_NAMES)
_SCORED_KEYS = ("name", "kind", "data", "body", "columns", "speed", "depth", "angle")
_SCORED_KINDS = [kind for kind in get_args(Kind) if kind != "model"]
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

    Data files are searched next to it. Angles are in degrees there. Further arguments are those of
    `Fit`; the law is by default that of the medium that the file is based on.

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
    runs = tuple(_runs(content, path, partial(_scored_run, about=about)))
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
    content: dict[str, Any], path: Path, make: Callable[[dict[str, Any], str, Path], Run]
) -> list[Run]:
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


def _run(entry: dict[str, Any], where: str, path: Path) -> Run:
    """Return a run to fit to."""
    values = _common(entry, where, path)
    height = values.pop("height", None)
    if height is not None:
        if entry["kind"] != "drop":
            raise InputError(f"{where}: height is for a drop, not for kind {entry['kind']}")
        if "speed" in values:
            raise InputError(f"{where}: a drop has a speed at the touch or a height, not both")
        if height < 0:
            raise InputError(f"{where}: the height of a drop must not be negative, got {height} m")
        values["speed"] = math.sqrt(2 * GRAVITY * height)
    values |= {key: entry[key] for key in _NAMES if entry.get(key) is not None}
    if entry.get("model") is not None:
        values["model"] = path.parent / str(entry["model"])
    return Run(entry["name"], entry["kind"], path.parent / entry["data"], **values)


def _scored_run(entry: dict[str, Any], where: str, path: Path, *, about: dict[str, Any]) -> Run:
    """Return a run to score laws against, with all columns of its kind."""
    name, kind = entry["name"], entry["kind"]
    check_name("kind of run", kind, _SCORED_KINDS)
    check_mapping(entry, where, _SCORED_KEYS)
    values = _common(entry, where, path)
    table = read_table(path.parent / entry["data"], *COLUMNS[kind], values.pop("columns"))
    motion = motion_of(table, values.get("depth"), to_the_stop=name in about["to_the_stop"])
    guided, mark = name in about["guided"], about["marks"].get(name, "seen")
    run = Run(name, kind, motion=motion, guided=guided, mark=mark, **values)
    run.check_start()
    return run


def _common(entry: dict[str, Any], where: str, path: Path) -> dict[str, Any]:
    """Return the numbers of a run, its angle in radians, its body and headings of columns."""
    values: dict[str, Any] = _numbers(entry, where)
    if "angle" in values:
        values["angle"] = math.radians(values["angle"])
    body = entry.get("body")
    if isinstance(body, str) and entry["kind"] == "model":
        values["model_body"] = body
    elif isinstance(body, dict) and set(body) == {"file"}:
        values["body"] = path.parent / str(body["file"])
    elif body is not None:
        values["body"] = _body(body, f"{where}.body")
    columns = values["columns"] = entry.get("columns") or {}
    if not (isinstance(columns, dict) and all(isinstance(c, str) for c in columns.values())):
        raise InputError(f"{where}.columns maps names such as force to headings of the file")
    return values


def _numbers(entry: dict[str, Any], where: str, keys: Sequence[str] = _NUMBERS) -> dict[str, float]:
    given = [key for key in keys if entry.get(key) is not None]
    return {key: number(entry[key], f"{where}.{key}") for key in given}


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
