"""Sets of measured runs: a folder with `runs.yaml`, a CSV file per run, and their source.

`runs.yaml` describes the runs, with the keys of calibration:

    medium: {density: 1469, internal_friction: 0.35, surface_friction: 0.45, grain: 0.003}
    runs:
      - {name: slow, kind: drop, body: {shape: sphere, diameter: 0.0254, mass: 0.0692},
         speed: 1.0, data: slow.csv}
      - {name: rod, kind: drop, body: {shape: capsule, length: 0.1, diameter: 0.01, mass: 0.0605},
         speed: 2.0, angle: 45, data: rod.csv}
      - {name: plate, kind: intrude, body: {shape: plate, length: 0.02, diameter: 0.005},
         speed: 0.05, data: plate.csv}
      - {name: drawn, kind: drag, body: {shape: plate, length: 0.016, diameter: 0.001},
         angle: 90, depth: 0.028, data: drawn.csv}
      - {name: leg, kind: turn, body: {file: leg.xml}, speed: 0.2, data: leg.csv}

A body from an MJCF file has a joint for each prescribed motion: `x`, `y` and `z` slide, `turn` is a
hinge. At `qpos0` its lowest point is at the surface; for a turning leg, the hip is at its height. A
walking robot starts at its first keyframe, and its legs are all hinges but `pitch`.

`about.json` next to it has `title`, `source`, the `marks` of runs by name, and the names of runs
that are `guided` (the body keeps its angle) or recorded only `to_the_stop` of the lowest point.
"""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import mujoco
import numpy as np

from mjgranular._util.checks import is_finite
from mjgranular._util.extras import require
from mjgranular._util.io import place, read_file
from mjgranular.errors import InputError, UnknownNameError, listed, shown
from mjgranular.medium import Medium, Quantity, get_medium
from mjgranular.medium.outline import OutlineError, read_outline
from mjgranular.models import Projectile
from mjgranular.models.projectile import Shape
from mjgranular.referee.motion import Motion

Kind = Literal["drop", "intrude", "drag", "turn", "roll", "sink", "walk"]
Mark = Literal["fitted to", "seen", "blind"]

MARKS: dict[Mark, str] = {
    "fitted to": "a constant of a law or medium was chosen by this run",
    "seen": "authors of laws knew the run while they worked, but no constant was chosen by it",
    "blind": "no law or constant was changed after the run was made",
}
"""Meaning of each label."""

_LARGEST = 5_000_000  # limit of one file [bytes]; chosen
_COLUMNS = {
    "time": "time [s]",
    "depth": "depth [m]",
    "speed": "speed [m/s]",
    "force": "force [N]",
    "pitch": "pitch [deg]",
    "lift": "lift [N]",
    "side": "side force [N]",
    "angle": "angle [deg]",
    "spin": "spin [rad/s]",
    "rate": "rate [Hz]",
}
_JOINTS = {
    "drag": ("x", "z"),
    "turn": ("turn",),
    "roll": ("x", "y", "z", "turn"),
    "sink": ("x", "y", "z", "turn"),
    "walk": ("x",),
}
_WHEEL = ("speed", "angle", "spin", "depth", "force", "side", "lift")
_NEEDED = {
    "drop": ("time", "depth"),
    "intrude": ("depth", "force"),
    "drag": ("speed", "force"),
    "turn": ("angle", "force", "lift"),
    "roll": _WHEEL,
    "sink": _WHEEL,
    "walk": ("rate", "speed"),
}


@dataclass(frozen=True)
class MeasuredRun:
    """A measured run, SI units and degrees.

    Attributes:
        name: name of the run.
        kind: "drop": released at the surface; "intrude": pushed straight down at constant speed;
            "drag": dragged along the surface at constant depth, one speed per row; "turn": a leg
            that turns about its hip, one angle per row; "roll": a wheel with given sinkage, speed
            and spin in each row; "sink": the same under its load, free to sink; "walk": a robot
            whose legs turn at a constant rate, one rate per row.
        body: the body in the sand: a shape or an MJCF file.
        speed: downward speed at the first row, or speed of a push [m/s]; of a turn [rad/s].
        angle: initial angle of the body's axis from the vertical [degrees].
        depth: depth of the lowest point in a drag [m].
        guided: whether the body keeps its angle.
        mark: label of what it can be used for (`MARKS`).
        motion: the measured motion.
    """

    name: str
    kind: Kind
    body: Projectile | Path
    motion: Motion
    speed: float = 0.0
    angle: float = 0.0
    depth: float | None = None
    guided: bool = False
    mark: Mark = "seen"

    def __post_init__(self) -> None:
        for name, value, options in (("kind of run", self.kind, Kind), ("mark", self.mark, Mark)):
            if value not in get_args(options):
                raise UnknownNameError(name, value, get_args(options))
        where = f"run {shown(self.name)}"
        for name, value in (("speed", self.speed), ("angle", self.angle)):
            if not is_finite(value):
                raise InputError(f"{where}: the {name} must be a finite number, not {shown(value)}")
        if isinstance(self.body, Path):
            self._check_joints(load_machine(self.body))
        elif self.kind in ("turn", "roll", "sink", "walk"):
            raise InputError(f"{where}: a {self.kind} needs a body from a file: {{file: leg.xml}}")
        if self.kind == "drop" and self.motion.time is None:
            raise InputError(f"{where}: a drop needs a column of times")
        if self.kind not in ("drop", "walk") and self.motion.force is None:
            raise InputError(f"{where}: a {self.kind} needs a column of forces")
        if self.motion.time is not None and (np.diff(self.motion.time) <= 0).any():
            raise InputError(f"{where}: its times must grow from row to row")

    def _check_joints(self, spec: mujoco.MjSpec) -> None:
        needed = _JOINTS.get(self.kind)
        if needed is None:
            raise InputError(f"run {shown(self.name)}: a {self.kind} needs a shape, not a file")
        names = [joint.name for joint in spec.joints]
        for name in needed:
            if name not in names:
                raise InputError(f"{shown(self.shape)}: a {self.kind} needs a joint {name!r}")
        if self.kind == "walk" and not spec.keys:
            raise InputError(f"{shown(self.shape)}: a walk needs a keyframe to start from")

    @property
    def to_the_stop(self) -> bool:
        """Whether the record ends where the lowest point stops, not where the body is at rest."""
        return self.motion.to_the_stop

    @property
    def shape(self) -> str:
        """Shape of the body, or the name of its MJCF file."""
        return self.body.name if isinstance(self.body, Path) else self.body.shape

    @cached_property
    def width(self) -> float:
        """Second largest extent of the body [m], the width of Froude numbers.

        For an MJCF file that of its last geom: a leg, a wheel.
        """
        if isinstance(self.body, Path):
            return 2 * float(sorted(load_machine(self.body).compile().geom_aabb[-1, 3:])[1])
        return 2 * sorted(self.body.halves)[1]

    @property
    def froude(self) -> float:
        """Largest Froude number of the run, v / sqrt(g w) at 9.81 m/s^2."""
        speed = self.speed
        if self.kind == "turn":
            speed *= self.width
        if self.motion.speed is not None:
            speed = max(speed, float(np.abs(self.motion.speed).max()))
        return speed / math.sqrt(9.81 * self.width)


@dataclass(frozen=True)
class RunSet:
    """Runs in one medium.

    Attributes:
        name: name of its folder.
        title: a short description.
        source: author or publication.
        medium: the known properties of the sand.
        runs: the runs.
    """

    name: str
    title: str
    source: str
    medium: Medium
    runs: tuple[MeasuredRun, ...] = field(repr=False)

    def __getitem__(self, name: str) -> MeasuredRun:
        """Return the run of a name.

        Raises:
            UnknownNameError: no such run; lists the runs.
        """
        for run in self.runs:
            if run.name == name:
                return run
        raise UnknownNameError(f"run of {self.name}", name, [run.name for run in self.runs])


def load_machine(file: Path) -> mujoco.MjSpec:
    """Load a body from its MJCF file.

    Raises:
        InputError: MuJoCo cannot read it.
    """
    try:
        return mujoco.MjSpec.from_file(str(file))
    except ValueError as error:
        raise InputError(f"{place(file)} is not a model: {error}") from None


def read_runs(folder: str | Path) -> RunSet:
    """Read a set of runs from its folder.

    Raises:
        InputError: a file cannot be read, is incomplete, or has a bad value; says which.
        UnknownNameError: no such kind, shape, mark or medium.
    """
    folder = Path(folder)
    yaml = require("yaml", extra="media", purpose="Reading a set of runs")
    file = folder / "runs.yaml"
    text = read_file(file, "the set of runs", largest=_LARGEST).decode("utf-8", "replace")
    try:
        content = read_outline(text, yaml)
    except OutlineError as error:
        raise InputError(f"{place(file)} is not YAML: {error}") from None
    about = _about(folder / "about.json")
    if not isinstance(content, dict) or not isinstance(content.get("runs"), list):
        raise InputError(f"{place(file)}: a set of runs has the keys medium and runs, a list")
    try:
        runs = tuple(_run(folder, entry, about) for entry in content["runs"])
        medium = _medium(folder.name, about, content.get("medium"))
    except InputError as error:
        if str(folder) in str(error):  # from a CSV file, which is named already
            raise
        raise InputError(f"{place(file)}: {error}") from None
    return RunSet(folder.name, about["title"], about["source"], medium, runs)


def _about(file: Path) -> dict[str, Any]:
    """Return title, source and marks of a set; defaults if the file does not exist."""
    plain: dict[str, Any] = {
        "title": file.parent.name,
        "source": "not said",
        "marks": {},
        "guided": [],
        "to_the_stop": [],
    }
    if not file.exists():
        return plain
    try:
        found = json.loads(read_file(file, "the provenance", largest=_LARGEST))
    except ValueError:
        raise InputError(f"{place(file)} is not JSON") from None
    if not isinstance(found, dict):
        raise InputError(f"{place(file)} is a mapping with title, source and marks")
    return {**plain, **found}


def _medium(name: str, about: dict[str, Any], given: Any) -> Medium:
    """Return the medium of a set: a registered one by `base`, or from its known properties."""
    if not isinstance(given, dict):
        raise InputError("medium: say what is known, {density: ..., internal_friction: ..., ...}")
    if "base" in given:
        return get_medium(str(given["base"]))
    known = ("density", "internal_friction", "surface_friction", "grain", "scale")
    for key in given:
        if key not in known:
            raise UnknownNameError("constant of a set's medium", key, ("base", *known))
    source = str(about["source"])
    values = {key: _number(f"medium.{key}", value) for key, value in given.items()}
    for key in known[:3]:
        if key not in values:
            raise InputError(f"medium: {key} is missing; there are base, or {', '.join(known)}")
    units = {"density": "kg/m^3"}
    return Medium(
        name=name,
        title=str(about["title"]),
        density=Quantity(values["density"], "kg/m^3", source),
        grain=Quantity(values["grain"], "m", source) if "grain" in values else None,
        default_law="rft3d",
        constants={
            "rft3d": {
                k: Quantity(v, units.get(k, ""), source) for k, v in values.items() if k != "grain"
            },
        },
    )


def _run(folder: Path, entry: Any, about: dict[str, Any]) -> MeasuredRun:
    if not isinstance(entry, dict):
        raise InputError("a run is a mapping: {name: ..., kind: ..., body: ..., data: ...}")
    for key in ("name", "kind", "body", "data"):
        if key not in entry:
            raise InputError(f"a run needs {key}: it has {listed(list(entry))}")
    kind = entry["kind"]
    if kind not in get_args(Kind):
        raise UnknownNameError("kind of run", kind, get_args(Kind))
    numbers = {k: _number(k, entry[k]) for k in ("speed", "angle", "depth") if k in entry}
    motion = _motion(folder / str(entry["data"]), kind, numbers)
    if entry["name"] in about["to_the_stop"]:
        motion = replace(motion, to_the_stop=True)
    return MeasuredRun(
        name=str(entry["name"]),
        kind=kind,
        body=_body(folder, entry["body"]),
        motion=motion,
        guided=entry["name"] in about["guided"],
        mark=about["marks"].get(entry["name"], "seen"),
        **numbers,
    )


def _body(folder: Path, entry: Any) -> Projectile | Path:
    if isinstance(entry, dict) and set(entry) == {"file"}:
        return folder / str(entry["file"])
    if not isinstance(entry, dict) or "shape" not in entry:
        raise InputError("body: {shape: sphere, diameter: 0.0254, mass: 0.0692}, for example")
    shape: Any = entry["shape"]
    if shape not in get_args(Shape):
        raise UnknownNameError("shape of a body", shape, get_args(Shape))
    sizes = {k: _number(f"body.{k}", v) for k, v in entry.items() if k != "shape"}
    diameter = sizes.get("diameter", math.nan)
    length = sizes.get("length", diameter)
    plain = Projectile(length, diameter, 1000.0, shape)
    if "mass" not in sizes:
        return plain
    return Projectile(length, diameter, 1000.0 * sizes["mass"] / plain.mass, shape)


def _motion(file: Path, kind: Kind, numbers: dict[str, float]) -> Motion:
    """Read the motion from the columns of a CSV file."""
    text = read_file(file, "the run", largest=_LARGEST).decode("utf-8-sig", "replace")
    rows = [row for row in csv.reader(io.StringIO(text)) if row and not row[0].startswith("#")]
    headings = [cell.strip() for cell in rows[0]] if rows else []
    names = {heading: name for name, heading in _COLUMNS.items()}
    for name in _NEEDED[kind]:
        if _COLUMNS[name] not in headings:
            raise InputError(
                f"{place(file)} has no column '{_COLUMNS[name]}', which a {kind} needs: it has "
                f"{listed(headings)}"
            )
    try:
        table = np.array([[float(cell) for cell in row] for row in rows[1:]], dtype=float)
    except ValueError:
        raise InputError(f"{place(file)}: a row has what is no number") from None
    if table.ndim != 2 or table.shape[1] != len(headings) or not np.isfinite(table).all():
        raise InputError(f"{place(file)}: each row has {len(headings)} finite numbers")
    columns: dict[str, Any] = {names[h]: table[:, i] for i, h in enumerate(headings) if h in names}
    if kind != "drop":
        columns.pop("time", None)
    if kind == "drag" and "depth" not in {*columns, *numbers}:
        raise InputError("a drag needs the depth of the body's lowest point [m]")
    depth = columns.pop("depth", np.full(len(table), numbers.get("depth", math.nan)))
    return Motion(depth=depth, **columns)


def _number(key: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"{key} must be a number, not {shown(value)}") from None
