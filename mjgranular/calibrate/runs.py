"""Measured runs: what was done, with which body, and what was measured."""

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import mujoco
import numpy as np

from mjgranular._util.checks import is_finite
from mjgranular._util.io import place, read_file
from mjgranular._util.parse import parse_number
from mjgranular.calibrate.motion import Motion
from mjgranular.errors import InputError, UnknownNameError, listed, shown
from mjgranular.medium import Medium
from mjgranular.models import Projectile
from mjgranular.models.projectile import Shape

_STEEL = 7850.0  # default density of a body that is moved, not dropped [kg/m^3]


@dataclass(frozen=True)
class Body:
    """A body of one of the shapes of `models.Projectile`, SI units.

    Attributes:
        shape: sphere, capsule, cylinder, box, plate, ellipsoid or link.
        diameter: size across the axis [m]; thickness of a plate.
        length: size along the axis [m]; side of a plate; not used for a sphere.
        mass: mass [kg]; a dropped body needs mass or density.
        density: [kg/m^3].

    Raises:
        UnknownNameError: no such shape.
        InputError: a size or mass that is not positive, or both mass and density.
    """

    shape: Shape
    diameter: float
    length: float | None = None
    mass: float | None = None
    density: float | None = None

    def __post_init__(self) -> None:
        if self.shape not in get_args(Shape):
            raise UnknownNameError("shape of a body", self.shape, get_args(Shape))
        if self.length is None and self.shape != "sphere":
            what = "its side" if self.shape == "plate" else "along its axis"
            raise InputError(f"a {self.shape} needs a length, {what} [m]")
        if self.mass is not None and self.density is not None:
            raise InputError("a body has a mass or a density, got both")
        for name in ("diameter", "length", "mass", "density"):
            value = getattr(self, name)
            if value is not None and not (is_finite(value) and value > 0):
                raise InputError(f"the body's {name} must be positive and finite, not {value}")
        _ = self.projectile

    @property
    def is_heavy(self) -> bool:
        """Whether its weight is known."""
        return self.mass is not None or self.density is not None

    @property
    def projectile(self) -> Projectile:
        length = self.diameter if self.length is None else self.length
        plain = Projectile(length, self.diameter, 1.0, self.shape)
        density = self.density or _STEEL
        if self.mass is not None:
            density = self.mass / plain.mass
        return Projectile(length, self.diameter, density, self.shape)

    @property
    def size(self) -> float:
        """Largest extent [m]."""
        return max(self.diameter, self.length or 0.0)


FitKind = Literal["drop", "intrude", "drag", "model"]
Kind = Literal["drop", "intrude", "drag", "turn", "roll", "sink", "walk"]
Mark = Literal["fitted to", "seen", "blind"]

MARKS: dict[Mark, str] = {
    "fitted to": "a constant of a law or medium was chosen by this run",
    "seen": "authors of laws knew the run while they worked, but no constant was chosen by it",
    "blind": "made after the first form of the law, and used to choose no constant",
}
"""Meaning of each label."""

_WHEEL = ("speed", "angle", "spin", "depth", "force", "side", "lift")

COLUMNS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "drop": (("time", "depth"), ("speed", "force", "pitch")),
    "intrude": (("depth", "force"), ("speed",)),
    "drag": (("speed", "force"), ("depth", "lift")),
    "model": (("time", "depth"), ()),
    "turn": (("angle", "force", "lift"), ()),
    "roll": (_WHEEL, ()),
    "sink": (_WHEEL, ()),
    "walk": (("rate", "speed"), ()),
}
"""Columns of each kind of run: required ones, and optional ones."""

_JOINTS = {
    "drag": ("x", "z"),
    "turn": ("turn",),
    "roll": ("x", "y", "z", "turn"),
    "sink": ("x", "y", "z", "turn"),
    "walk": ("x",),
}
"""Joints that a body from an MJCF file needs, by kind of run."""


@dataclass(frozen=True)
class Run:
    """A run to fit to, SI units and radians; depths are those of the body's lowest point.

    Attributes:
        name: name in results and `hold_out`.
        kind: "drop": the body falls freely; columns time and depth, and optionally the pitch of its
            axis from the vertical [degrees]. "intrude": it is pushed straight down at constant
            speed; depth and force. "drag": it is dragged along the surface at one depth, at several
            speeds; speed and force, and optionally lift. "model": a body of an MJCF model that is
            released; time and depth.
        data: a CSV file, or the columns by their names, in SI units and degrees.
        body: the body that meets the sand; not for "model".
        speed: downward, when the lowest point touches the sand, or of a push [m/s].
        angle: initial angle of the body's axis from the vertical [rad].
        depth: depth of a drag [m].
        columns: headings in the file of columns with other names, by column name.
        model: an MJCF file. It starts from its keyframe, with the model's joints.
        model_body: name of the body whose lowest point was measured.
        keyframe: name of the keyframe to start from; None for the model's own state.

    Raises:
        UnknownNameError: no such kind.
        InputError: a missing or an unused argument for this kind of run; a value out of range.
    """

    name: str
    kind: FitKind
    data: Path | Mapping[str, Any]
    _: KW_ONLY
    body: Body | None = None
    speed: float | None = None
    angle: float = 0.0
    depth: float | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    model: Path | None = None
    model_body: str | None = None
    keyframe: str | None = None

    def __post_init__(self) -> None:
        if self.kind not in get_args(FitKind):
            raise UnknownNameError("kind of run", self.kind, get_args(FitKind))
        where = f"run {shown(self.name)}"
        if self.kind == "model" and (self.model is None or self.model_body is None):
            raise InputError(
                f"{where}: a run of a model needs model, an MJCF file, and model_body, the name of "
                "the body that was measured"
            )
        if self.kind != "model" and self.body is None:
            raise InputError(f"{where}: a {self.kind} needs a body")
        for name in ("speed", "depth"):
            value = getattr(self, name)
            if value is not None and not is_finite(value):
                raise InputError(f"{where}: {name} must be a finite number, got {shown(value)}")
        if not (is_finite(self.angle) and abs(self.angle) <= math.pi / 2):
            raise InputError(f"{where}: the angle from the vertical must be from -90 to 90 degrees")
        if self.speed is not None and self.speed < 0:
            raise InputError(f"{where}: the downward speed must not be negative, got {self.speed}")
        if self.kind == "drop":
            if self.speed is None:
                raise InputError(f"{where}: a drop needs the speed at which it meets the sand")
            if self.body is not None and not self.body.is_heavy:
                raise InputError(f"{where}: a body that is dropped needs its mass [kg]")
        if self.kind == "drag" and not (self.depth is not None and self.depth > 0):
            raise InputError(f"{where}: a drag needs the depth of the body's lowest point [m]")
        for column in self.columns:
            known = sum(self._columns, ())
            if column not in known:
                raise UnknownNameError(f"column of a {self.kind}", column, known)

    @property
    def _columns(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Required and optional columns that a fit reads."""
        needed, optional = COLUMNS[self.kind]
        return needed, tuple(name for name in optional if name in ("pitch", "lift"))

    def measured(self) -> dict[str, np.ndarray]:
        """Return the columns by their names, in SI units and degrees.

        Raises:
            InputError: a column is missing, is not of numbers, or not as long as the others.
        """
        needed, optional = self._columns
        if not isinstance(self.data, Mapping):
            return read_table(Path(self.data), needed, optional, self.columns)
        where = f"run {shown(self.name)}"
        for column in needed:
            if column not in self.data:
                raise InputError(f"{where} has no column {column!r}; needed: {', '.join(needed)}")
        found = {k: np.asarray(v, float) for k, v in self.data.items() if k in needed + optional}
        shapes = {values.shape for values in found.values()}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise InputError(f"{where}: all columns must have the same length")
        if not all(np.isfinite(values).all() for values in found.values()):
            raise InputError(f"{where}: all columns must be finite numbers")
        return found


@dataclass(frozen=True)
class MeasuredRun:
    """A run to score a law against, SI units and degrees.

    Attributes:
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
                raise InputError(f"{where}: the {name} must be a finite number, got {shown(value)}")
        if isinstance(self.body, Path):
            self._check_joints(load_machine(self.body))
        elif self.kind in ("turn", "roll", "sink", "walk"):
            raise InputError(f"{where}: a {self.kind} needs a body from a file: {{file: leg.xml}}")
        time = self.motion.time
        if self.kind == "drop" and time is None:
            raise InputError(f"{where}: a drop needs a column of times")
        if self.kind not in ("drop", "walk") and self.motion.force is None:
            raise InputError(f"{where}: a {self.kind} needs a column of forces")
        if time is not None and (np.diff(time) <= 0).any():
            raise InputError(f"{where}: its times must grow from row to row")
        above = -self.motion.depth[0]
        if self.kind == "drop" and above > self.motion.depth.max() / 2:  # chosen
            raise InputError(
                f"{where}: it begins {above:.3g} m above the sand, and the speed is that of its "
                "first row: omit rows before the touch"
            )

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
    """

    name: str
    title: str
    source: str
    medium: Medium
    runs: tuple[MeasuredRun, ...] = field(repr=False)

    def __getitem__(self, name: str) -> MeasuredRun:
        for run in self.runs:
            if run.name == name:
                return run
        raise UnknownNameError(f"run of {self.name}", name, [run.name for run in self.runs])


def load_machine(file: Path) -> mujoco.MjSpec:
    """Load a body from its MJCF file."""
    try:
        return mujoco.MjSpec.from_file(str(file))
    except ValueError as error:
        raise InputError(f"{place(file)} is not a model: {error}") from None


# Tables of measurements: CSV columns found by name, converted to SI units

_LARGEST = 50_000_000
"""Size up to which a table is read [bytes]; chosen."""

_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
_FORCES = {"N": 1.0, "mN": 1e-3, "kN": 1e3}
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
        if column not in known:
            raise UnknownNameError(f"column of {place(path)}", column, known)
    text = read_file(path, "the measurement", largest=_LARGEST).decode("utf-8-sig", "replace")
    name = place(path)
    try:
        rows = [
            (line, row)
            for line, row in enumerate(csv.reader(io.StringIO(text)), 1)
            if any(cell.strip() for cell in row) and not row[0].startswith("#")
        ]
    except csv.Error as error:
        raise InputError(f"{name} is not a table: {error}; a quote may not be closed") from None
    if not rows:
        raise InputError(f"{name} is empty: a table has a line of headings and rows of numbers")
    headings = [cell.strip() for cell in rows[0][1]]
    if len(headings) == 1 and any(mark in headings[0] for mark in ";\t"):
        raise InputError(
            f"{name} has no commas: columns are separated by commas, and numbers have points"
        )
    if None not in map(parse_number, headings):
        raise InputError(
            f"{name} begins with numbers: its first line must name the columns, such as time,depth"
        )
    if len(rows) == 1:
        raise InputError(f"{name} has headings and no row of numbers")
    found = {}
    for column in known:
        index = _find(headings, column, columns.get(column), name)
        if index is not None:
            found[column] = index
        elif column in needed:
            raise InputError(
                f"{name} has no column {column!r}: it has {listed(headings)}; name the one that is "
                f"meant with columns: {{{column}: HEADING}}"
            )
    return {
        column: _factor(headings[index], column, name)
        * np.array([_number(row, index, line, name) for line, row in rows[1:]])
        for column, index in found.items()
    }


def _find(headings: list[str], column: str, called: str | None, name: str) -> int | None:
    if called is not None and called not in headings:
        raise InputError(f"{name} has no column {shown(called)}: it has {listed(headings)}")
    plain = headings if called else [_split(heading, column)[0] for heading in headings]
    chosen = called or next((known for known in _HEADINGS[column][0] if known in plain), None)
    if chosen is None:
        return None
    if plain.count(chosen) > 1:
        raise InputError(f"{name} has {plain.count(chosen)} columns {shown(chosen)}: rename one")
    return plain.index(chosen)


def _split(heading: str, column: str) -> tuple[str, str | None]:
    """Return the name and unit of a heading, both in lower case; None for no unit."""
    text = heading.lower()
    bracket = re.fullmatch(r"(.*?)\s*[\[(]\s*(.*?)\s*[\])]", text)
    if bracket:
        return bracket[1].strip(), bracket[2]
    stem, _, tail = text.rpartition("_")
    if stem and tail in map(str.lower, _HEADINGS[column][1]):
        return stem, tail
    return text, None


def _factor(heading: str, column: str, name: str) -> float:
    unit, units = _split(heading, column)[1], _HEADINGS[column][1]
    factors = {known.lower(): factor for known, factor in units.items()}
    if unit is not None and unit not in factors:
        raise InputError(
            f"{name}: {shown(heading)} must be in one of {listed(units)}, got {shown(unit)}"
        )
    return 1.0 if unit is None else factors[unit]


def _number(row: list[str], index: int, line: int, name: str) -> float:
    cell = row[index].strip() if index < len(row) else ""
    number = parse_number(cell)
    if number is None or not np.isfinite(number):
        raise InputError(f"{name}, line {line}: {shown(cell)} is not a finite number")
    return number
