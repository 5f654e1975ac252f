"""Dunes: a surface from an hfield geom of the model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import records
from mjgranular.kernel.vector import read_matrix, read_vector, transposed, vector
from mjgranular.shape.sizes import check_extents
from mjgranular.surface.place import find_geom, tilt_of, world_pose
from mjgranular.surface.surface import Surface

HEIGHT_FIELD_DTYPE = np.dtype(
    [
        ("position", np.float64, (3,)),  # of the geom [m], world
        ("axes", np.float64, (9,)),  # its rotation matrix, row by row
        ("half_x", np.float64),  # [m]
        ("half_y", np.float64),
        ("elevation", np.float64),  # height of the datum 1 [m]
        ("rows", np.int64),
        ("columns", np.int64),
        ("data", np.int64),  # address of MuJoCo's float32 heights, rows over y, columns over x
    ]
)

_heights = records(np.dtype(np.float32))


@partial(compiled, inline=True)
def height_of(field, k):
    """Return the datum with that index, as a height [m]."""
    return _heights(field.data, field.rows * field.columns)[k] * field.elevation


@compiled
def height_field_probe(field, point):
    """Return a point's depth along the normal of the bilinear surface over it; the normal."""
    axes = read_matrix(field.axes, 0)
    place = transposed(axes) @ (point - read_vector(field.position, 0))
    # NaN is not within: only valid indices of the field pass.
    if not (abs(place.x) <= field.half_x and abs(place.y) <= field.half_y):
        beside = max(abs(place.x) - field.half_x, abs(place.y) - field.half_y)
        return (-beside if beside > 0.0 else math.nan), axes @ vector(0.0, 0.0, 1.0)
    step_x = 2.0 * field.half_x / float(field.columns - 1)
    step_y = 2.0 * field.half_y / float(field.rows - 1)
    u = (place.x + field.half_x) / step_x
    v = (place.y + field.half_y) / step_y
    column = min(int(u), field.columns - 2)
    row = min(int(v), field.rows - 2)
    u -= float(column)
    v -= float(row)
    k = row * field.columns + column
    h00, h10 = height_of(field, k), height_of(field, k + 1)
    k += field.columns
    h01, h11 = height_of(field, k), height_of(field, k + 1)
    height = (1.0 - v) * ((1.0 - u) * h00 + u * h10) + v * ((1.0 - u) * h01 + u * h11)
    slope_x = ((1.0 - v) * (h10 - h00) + v * (h11 - h01)) / step_x
    slope_y = ((1.0 - u) * (h01 - h00) + u * (h11 - h10)) / step_y
    scale = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    normal = axes @ vector(-slope_x * scale, -slope_y * scale, scale)
    return (height - place.z) * scale, normal


@dataclass(frozen=True)
class HeightField(Surface):
    """The surface of an hfield geom, bilinear between its data; outside it there is no sand.

    The data may change while the simulation runs. The geom's own contacts are disabled in the model
    when the sand is bound.

    Attributes:
        geom: name of the hfield geom; it must be fixed to the world.
    """

    probe: ClassVar[Any] = height_field_probe

    geom: str

    def record(self, model: mujoco.MjModel) -> np.ndarray:
        geom = find_geom(model, self.geom, mujoco.mjtGeom.mjGEOM_HFIELD, "height field")
        number = int(model.geom_dataid[geom])
        rows, columns = int(model.hfield_nrow[number]), int(model.hfield_ncol[number])
        if rows < 2 or columns < 2:
            raise InputError(
                f"the height field of geom {self.geom!r} has {rows} rows and {columns} columns: "
                "at least 2 of each make a surface"
            )
        position, axes = world_pose(model, geom)
        half_x, half_y, elevation, _ = model.hfield_size[number]
        start = int(model.hfield_adr[number])
        if start < 0 or start + rows * columns > len(model.hfield_data):
            raise InputError(
                f"the height field of geom {self.geom!r} has {rows} rows and {columns} columns, "
                "too many for hfield_data: leave hfield_nrow and hfield_ncol as they were compiled"
            )
        check_extents(f"the height field of geom {self.geom!r}", (half_x, half_y, elevation))
        field = np.zeros(1, HEIGHT_FIELD_DTYPE)
        field["position"] = position
        field["axes"] = axes.ravel()
        field["half_x"], field["half_y"], field["elevation"] = half_x, half_y, elevation
        field["rows"], field["columns"] = rows, columns
        field["data"] = model.hfield_data[start:].ctypes.data
        return field

    def geoms(self, model: mujoco.MjModel) -> tuple[int, ...]:
        return (find_geom(model, self.geom, mujoco.mjtGeom.mjGEOM_HFIELD, "height field"),)

    def shape(self, model: mujoco.MjModel) -> tuple[np.ndarray, ...]:
        number = int(model.geom_dataid[self.geoms(model)[0]])
        arrays = (model.hfield_nrow, model.hfield_ncol, model.hfield_adr)
        return tuple(array[number : number + 1] for array in arrays)

    def lift(self, model: mujoco.MjModel) -> Mapping[str, np.ndarray]:
        return {"position": self.record(model)["axes"][0][2::3]}

    def tilt(self, model: mujoco.MjModel) -> float:
        field = self.record(model)[0]
        number = int(model.geom_dataid[self.geoms(model)[0]])
        start = int(model.hfield_adr[number])
        count = field["rows"] * field["columns"]
        heights = model.hfield_data[start : start + count].reshape(field["rows"], field["columns"])
        heights = heights * field["elevation"]
        with np.errstate(invalid="ignore"):  # heights may be set later
            dy = np.diff(heights, axis=0) / (2 * field["half_y"] / (field["rows"] - 1))
            dx = np.diff(heights, axis=1) / (2 * field["half_x"] / (field["columns"] - 1))
        steepest = math.atan(math.hypot(np.abs(dx).max(), np.abs(dy).max()))
        return steepest + tilt_of(field["axes"].reshape(3, 3)[:, 2], model)
