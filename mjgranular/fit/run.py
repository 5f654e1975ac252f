"""One measured run: setup and data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from mjgranular._util.checks import is_finite
from mjgranular.errors import InputError, UnknownNameError, shown
from mjgranular.fit.body import Body
from mjgranular.fit.table import read_table

Kind = Literal["drop", "intrude", "drag", "model"]

COLUMNS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "drop": (("time", "depth"), ("pitch",)),
    "intrude": (("depth", "force"), ()),
    "drag": (("speed", "force"), ()),
    "model": (("time", "depth"), ()),
}
"""Columns of each kind of run: required ones, and optional ones."""

_PUSH_SPEED = 0.01  # default speed of a push [m/s]: slow


@dataclass(frozen=True)
class Run:
    """A run, SI units and radians; depths are those of the body's lowest point.

    Attributes:
        name: name in results and `hold_out`.
        kind: "drop": the body falls freely; columns time and depth, and optionally the pitch of its
            axis from the vertical [degrees]. "intrude": it is pushed straight down at constant
            speed; depth and force. "drag": it is dragged along the surface at one depth, at several
            speeds; speed and force. "model": a body of an MJCF model that is released; time and
            depth.
        data: a CSV file, or the columns by their names, in SI units and degrees.
        body: the body that meets the sand; not for "model".
        speed: downward, when the lowest point touches the sand, or of a push [m/s].
        angle: initial angle of the body's axis from the vertical [rad].
        touch: time of the record at which the lowest point touches the sand [s]; None to find it.
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
    kind: Kind
    data: Path | Mapping[str, Any]
    _: KW_ONLY
    body: Body | None = None
    speed: float | None = None
    angle: float = 0.0
    touch: float | None = None
    depth: float | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    model: Path | None = None
    model_body: str | None = None
    keyframe: str | None = None

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise UnknownNameError("kind of run", self.kind, get_args(Kind))
        where = f"run {shown(self.name)}"
        if self.kind == "model":
            if self.model is None or self.model_body is None:
                raise InputError(
                    f"{where}: a run of a model needs model, an MJCF file, and model_body, the "
                    "name of the body that was watched"
                )
        elif self.body is None:
            raise InputError(f"{where}: a {self.kind} needs a body")
        for name in ("speed", "touch", "depth"):
            value = getattr(self, name)
            if value is not None and not is_finite(value):
                raise InputError(f"{where}: {name} must be a finite number, not {shown(value)}")
        if not (is_finite(self.angle) and abs(self.angle) <= math.pi / 2):
            raise InputError(f"{where}: the angle from the vertical is from -90 to 90 degrees")
        if self.speed is not None and self.speed < 0:
            raise InputError(f"{where}: the speed is downward and not negative, not {self.speed}")
        if self.kind == "drop":
            if self.speed is None:
                raise InputError(f"{where}: a drop needs the speed at which it meets the sand")
            if self.body is not None and not self.body.is_heavy:
                raise InputError(f"{where}: a body that is dropped needs its mass [kg]")
        if self.kind == "drag" and not (self.depth is not None and self.depth > 0):
            raise InputError(f"{where}: a drag needs the depth of the body's lowest point [m]")
        for column in self.columns:
            known = sum(COLUMNS[self.kind], ())
            if column not in known:
                raise UnknownNameError(f"column of a {self.kind}", column, known)

    @property
    def push_speed(self) -> float:
        """Speed of a push [m/s]."""
        return self.speed or _PUSH_SPEED

    def measured(self) -> dict[str, np.ndarray]:
        """Return the columns by their names, in SI units and degrees.

        Raises:
            InputError: a column is missing, is not of numbers, or not as long as the others.
        """
        needed, optional = COLUMNS[self.kind]
        if isinstance(self.data, Mapping):
            found = {k: np.asarray(v, float) for k, v in self.data.items()}
            for column in needed:
                if column not in found:
                    raise InputError(
                        f"run {shown(self.name)} has no column {column!r}: a {self.kind} needs "
                        f"{', '.join(needed)}"
                    )
            found = {k: v for k, v in found.items() if k in (*needed, *optional)}
            shapes = {values.shape for values in found.values()}
            if len(shapes) != 1 or len(next(iter(shapes))) != 1:
                raise InputError(f"run {shown(self.name)}: columns are as long as each other")
            if not all(np.isfinite(values).all() for values in found.values()):
                raise InputError(f"run {shown(self.name)}: a column has what is no finite number")
            return found
        return read_table(Path(self.data), needed, optional, self.columns)

    def config(self) -> dict[str, Any]:
        """Return the run in plain values."""
        plain = {
            "name": self.name,
            "kind": self.kind,
            "data": "given" if isinstance(self.data, Mapping) else str(self.data),
            "body": None if self.body is None else dict(vars(self.body)),
            "model": None if self.model is None else str(self.model),
            "columns": dict(self.columns) or None,
        }
        for name in ("speed", "angle", "touch", "depth", "model_body", "keyframe"):
            plain[name] = getattr(self, name)
        return {key: value for key, value in plain.items() if value is not None}
