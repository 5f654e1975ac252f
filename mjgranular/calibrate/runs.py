"""Measured runs: what was done, with which body, and what was measured."""

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, InitVar, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import mujoco
import numpy as np

from mjgranular._util.checks import check_finite, check_name, is_finite
from mjgranular._util.io import place
from mjgranular.calibrate.motion import Motion
from mjgranular.calibrate.table import read_table
from mjgranular.errors import InputError, UnknownNameError, loading, shown
from mjgranular.medium import Medium
from mjgranular.models import Projectile
from mjgranular.models.link import Shape

GRAVITY = 9.81  # as for all dropped bodies (models/link.xml) [m/s^2]
_STEEL = 7850.0  # default density of a body that is moved, not dropped [kg/m^3]
_PUSH_SPEED = 0.01  # default speed of a push [m/s]: slow


class Body(Projectile):
    """A body of one of the shapes of `models.Projectile`; a dropped one needs mass or density.

    Attributes:
        is_heavy: whether its weight is known.

    Raises:
        UnknownNameError: no such shape.
        InputError: a size or mass that is not positive, or both mass and density.
    """

    def __init__(
        self,
        shape: Shape,
        diameter: float,
        length: float | None = None,
        mass: float | None = None,
        density: float | None = None,
    ) -> None:
        check_name("shape of a body", shape, get_args(Shape))
        if length is None and shape != "sphere":
            what = "its side" if shape == "plate" else "along its axis"
            raise InputError(f"a {shape} needs a length, {what} [m]")
        if mass is not None and density is not None:
            raise InputError("a body has a mass or a density, got both")
        sizes = diameter if length is None else length, diameter
        if mass is not None:
            check_finite("the body's mass", mass, "kg", positive=True)
            volume = Projectile(*sizes, 1.0, shape).mass  # to MuJoCo 0 if it is less than this
            density = mass / max(volume, mujoco.mjMINVAL)
        object.__setattr__(self, "is_heavy", density is not None)
        super().__init__(*sizes, _STEEL if density is None else density, shape)


Kind = Literal["drop", "intrude", "drag", "turn", "roll", "sink", "walk", "model"]
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
    """A measured run, SI units and radians; depths are those of the body's lowest point.

    Attributes:
        name: name in results and `hold_out`.
        kind: "drop": the body falls freely; columns time and depth, and optionally the pitch of its
            axis from the vertical [degrees]. "intrude": it is pushed straight down at constant
            speed; depth and force. "drag": it is dragged along the surface at one depth, at several
            speeds; speed and force, and optionally lift. "turn": a leg that turns about its hip,
            one angle per row. "roll": a wheel with given sinkage, speed and spin in each row.
            "sink": the same under its load, free to sink. "walk": a robot whose legs turn at a
            constant rate, one rate per row. "model": a body of an MJCF model that is released; time
            and depth.
        data: a CSV file, or columns by their names, in SI units and degrees; read into `motion`.
        body: the body that meets the sand: a shape, or an MJCF file; for "model" it is `model`.
        speed: downward, when the lowest point touches the sand (in `simulate` at the first row),
            or of a push, by default the mean of its column, or 0.01 m/s; of a turn [rad/s].
        angle: initial angle of the body's axis from the vertical [rad].
        depth: depth of a drag [m].
        columns: headings in the file of columns with other names, by column name.
        model: an MJCF file. It starts from its keyframe, with the model's joints.
        model_body: name of the body whose lowest point was measured.
        keyframe: name of the keyframe to start from; None for the model's own state.
        motion: the measured motion, in place of `data`.
        guided: whether the body keeps its angle; such a run cannot be fitted to.
        mark: label of what it can be used for (`MARKS`).

    Raises:
        UnknownNameError: no such kind, column or mark.
        InputError: a missing, unused or invalid argument for this kind of run, or unreadable data.
    """

    name: str
    kind: Kind
    data: InitVar[Path | Mapping[str, Any] | None] = None
    _: KW_ONLY
    body: Projectile | Path = None  # pyright: ignore[reportAssignmentType] - of a model, its file
    speed: float = None  # pyright: ignore[reportAssignmentType] - by the kind
    angle: float = 0.0
    depth: float | None = None
    columns: InitVar[Mapping[str, str] | None] = None
    model: Path | None = None
    model_body: str | None = None
    keyframe: str | None = None
    motion: Motion = None  # pyright: ignore[reportAssignmentType] - made of `data`
    guided: bool = False
    mark: Mark = "seen"

    def __post_init__(
        self, data: Path | Mapping[str, Any] | None, columns: Mapping[str, str] | None
    ) -> None:
        for name, value, options in (("kind of run", self.kind, Kind), ("mark", self.mark, Mark)):
            check_name(name, value, get_args(options))
        self._check_body()
        users = {"depth": "drag", "model": "model", "model_body": "model", "keyframe": "model"}
        for name, kind in users.items():
            if getattr(self, name) is not None and self.kind != kind:
                raise self.error(f"{name} is for runs of the kind {kind}, not for a {self.kind}")
        for name in ("speed", "depth"):
            value = getattr(self, name)
            if value is not None and not is_finite(value):
                raise self.error(f"{name} must be a finite number, got {shown(value)}")
        if not (is_finite(self.angle) and abs(self.angle) <= math.pi / 2):
            raise self.error(f"angle must be from -90 to 90 degrees, got {shown(self.angle)} rad")
        if self.kind == "drop" and self.speed is None:
            raise self.error("a drop needs the speed at which it meets the sand")
        if data is not None:
            object.__setattr__(self, "motion", self._read(data, columns))
        self._check_motion()
        speed, measured = self.speed or 0.0, self.motion.speed
        if self.kind == "intrude" and not speed:
            speed = _PUSH_SPEED if measured is None else float(measured.mean())
        if speed < 0 and self.kind != "turn":
            raise self.error(f"the downward speed must not be negative, got {speed}")
        object.__setattr__(self, "speed", speed)

    def error(self, problem: str) -> InputError:
        """Return an error that names the run."""
        return InputError(f"run {shown(self.name)}: {problem}")

    def _check_body(self) -> None:
        """Check that the run has a body of the right kind, with the joints that it needs."""
        if self.kind == "model":
            if self.model is None or self.model_body is None:
                raise self.error(
                    "a run of a model needs model, an MJCF file, and model_body, the name of the "
                    "body that was measured"
                )
            object.__setattr__(self, "body", self.model)
        elif self.body is None:
            raise self.error(
                f"{self.kind} needs a body, such as {{shape: sphere, diameter: 0.0254}}"
            )
        elif not isinstance(self.body, Path | Projectile):
            raise self.error(
                f"a body must be a Body or the Path of an MJCF file, got {shown(self.body)}"
            )
        elif isinstance(self.body, Path):
            needed = _JOINTS.get(self.kind)
            if needed is None:
                raise self.error(f"a {self.kind} needs a shape, not a file")
            spec = load_machine(self.body)
            names = [joint.name for joint in spec.joints]
            for name in needed:
                if name not in names:
                    raise InputError(f"{shown(self.shape)}: a {self.kind} needs a joint {name!r}")
            if self.kind == "walk" and not spec.keys:
                raise InputError(f"{shown(self.shape)}: a walk needs a keyframe to start from")
        elif self.kind in ("turn", "roll", "sink", "walk"):
            raise self.error(f"{self.kind} needs a body from a file: {{file: leg.xml}}")
        elif self.kind == "drop" and not getattr(self.body, "is_heavy", True):
            raise self.error("a body that is dropped needs its mass [kg]")

    def _read(self, data: Path | Mapping[str, Any], columns: Mapping[str, str] | None) -> Motion:
        """Read the columns that a fit takes, in SI units and degrees."""
        needed, optional = COLUMNS[self.kind]
        if self.kind != "intrude" and not isinstance(self.body, Path):
            optional = tuple(name for name in optional if name in ("pitch", "lift"))
        if not isinstance(data, Mapping):
            return motion_of(read_table(Path(data), needed, optional, columns), self.depth)
        for column in needed:
            if column not in data:
                raise self.error(f"it has no column {column!r}; needed: {', '.join(needed)}")
        found = {k: np.asarray(v, float) for k, v in data.items() if k in needed + optional}
        shape = found[needed[0]].shape
        if shape == (0,):
            raise self.error("its columns have no rows")
        if len(shape) != 1 or any(values.shape != shape for values in found.values()):
            raise self.error("all columns must have the same length")
        if not all(np.isfinite(values).all() for values in found.values()):
            raise self.error("all columns must be finite numbers")
        return motion_of(found, self.depth)

    def _check_motion(self) -> None:
        if not isinstance(self.motion, Motion):
            raise self.error("it needs data, a CSV file or columns by their names")
        time = self.motion.time
        if self.kind in ("drop", "model") and time is None:
            raise self.error(f"a {self.kind} needs a column of times")
        if self.kind not in ("drop", "model", "walk") and self.motion.force is None:
            raise self.error(f"a {self.kind} needs a column of forces")
        if self.kind == "drag" and not (self.depth or self.motion.depth.max()) > 0:
            raise self.error("a drag needs the depth of the body's lowest point [m]")
        if time is not None and (np.diff(time) <= 0).any():
            row = int(np.argmax(np.diff(time) <= 0))
            raise self.error(
                f"times must grow, got {time[row + 1]:g} after {time[row]:g} s in row {row + 2}"
            )

    def check_start(self) -> None:
        """Check that a drop begins at the sand, where its speed is known."""
        above = -self.motion.depth[0]
        if self.kind == "drop" and above > self.motion.depth.max() / 2:  # chosen
            raise self.error(
                f"it begins {above:.3g} m above the sand, and the speed is that of its first row: "
                "omit rows before the touch"
            )

    @property
    def shape(self) -> str:
        """Shape of the body, or the name of its MJCF file."""
        return self.body.shape if isinstance(self.body, Projectile) else self.body.name

    @cached_property
    def width(self) -> float:
        """Second largest extent of the body [m], the width of Froude numbers.

        For an MJCF file that of its last geom: a leg, a wheel.
        """
        if isinstance(self.body, Projectile):
            return 2 * sorted(self.body.halves)[1]
        return 2 * float(sorted(load_machine(self.body).compile().geom_aabb[-1, 3:])[1])

    @property
    def froude(self) -> float:
        """Largest Froude number of the run, v / sqrt(g w) at 9.81 m/s^2."""
        speed = self.speed
        if self.kind == "turn":
            speed *= self.width
        if self.motion.speed is not None:
            speed = max(speed, float(np.abs(self.motion.speed).max()))
        return speed / math.sqrt(GRAVITY * self.width)


MeasuredRun = Run
"""Another name of `Run`."""


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
    runs: tuple[Run, ...] = field(repr=False)

    def __getitem__(self, name: str) -> Run:
        for run in self.runs:
            if run.name == name:
                return run
        raise UnknownNameError(f"run of {self.name}", name, [run.name for run in self.runs])


def motion_of(columns: dict[str, np.ndarray], depth: float | None, **others: Any) -> Motion:
    """Return the motion of measured columns; without one of depths, `depth` in all rows [m]."""
    rows = len(next(iter(columns.values())))
    same = np.full(rows, math.nan if depth is None else depth)
    return Motion(**{"depth": same, **columns}, **others)


def load_machine(file: Path) -> mujoco.MjSpec:
    """Load a body from its MJCF file."""
    with loading(place(file)):
        return mujoco.MjSpec.from_file(str(file))
