"""The interface of surfaces, and their kinds: a plane, a box geom as a bed, an hfield geom."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from functools import cache, partial
from itertools import product
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular._util.checks import check_finite, check_records, kind_of
from mjgranular._util.parse import Registry, read_part
from mjgranular.errors import InputError
from mjgranular.kernel.compiled import check_compiled, compiled, entry
from mjgranular.kernel.memory import records
from mjgranular.kernel.vector import dot, norm, read_matrix, read_vector, transposed, vector
from mjgranular.shape.sizes import check_extents
from mjgranular.surface.place import check_geom, find_geom, tilt_of, world_pose


class Surface(ABC):
    """Surface of the sand. A final surface is a frozen dataclass.

    Attributes:
        probe: kernel `probe(record, point) -> (depth, normal)`, of vectors (`kernel.vector`): depth
            of a point below the surface along its normal [m], negative above the sand, and the unit
            normal out of the sand; world frame.
        is_plane: whether it is an infinite plane, and its `probe` only arithmetic (`kernel.lanes`):
            then laws with many elements skip dry ones at a fraction of the cost.
    """

    probe: ClassVar[Any]
    is_plane: ClassVar[bool] = False

    def probe_kernel(self) -> Any:
        """Return the kernel that computes elements' depths; `probe` unless overridden."""
        return type(self).probe

    def toward_kernel(self) -> Any:
        """Return a kernel `toward(record, point, outward)`: `probe` for a face with that normal.

        None if depth does not depend on the normal.
        """
        return None

    def ceiling_kernel(self) -> Any:
        """Return a kernel like `probe`, of a plane that is above all of the sand; None for none."""
        return type(self).probe if type(self).is_plane else None

    @abstractmethod
    def record(self, model: mujoco.MjModel) -> np.ndarray:
        """Return the surface in a model as its `probe` reads it: structured, shape (1,)."""

    def geoms(self, model: mujoco.MjModel) -> tuple[int, ...]:
        """Return ids of the geoms that are the sand and so do not meet it."""
        return ()

    def shape(self, model: mujoco.MjModel) -> tuple[np.ndarray, ...]:
        """Return integers of the model that set array lengths in `record`.

        They are views of arrays of the model, int32, shape (1,) each. An `MjData` may be run on
        another model: they must be the same there.
        """
        return ()

    def lift(self, model: mujoco.MjModel) -> Mapping[str, np.ndarray]:
        """Return the changes of fields of the record per meter that the surface rises [1/m].

        It rises along its normal. Each change has the shape of its field.
        """
        raise InputError(f"{type(self).__name__} cannot be raised: give it a method lift")

    @property
    def state_size(self) -> int:
        """Length of the surface's own state in a simulation."""
        return 0

    @abstractmethod
    def tilt(self, model: mujoco.MjModel) -> float:
        """Return the steepest angle of the surface from the horizontal, across gravity [rad]."""


@cache
def _measure_kernel(probe: Any, dtype: np.dtype) -> Any:
    place_records = records(dtype)

    @compiled
    def measure(address, x, y, z, step):
        """Return the length of the normal, or how much depth falls per meter of a step along it."""
        place, point = place_records(address, 1)[0], vector(x, y, z)
        depth, normal = probe(place, point)
        if depth <= 0.0 or (step > 0.0 and depth > 1e6 * step):  # deeper than the model
            return 1.0
        ahead, _ = probe(place, point + step * normal)
        return (depth - ahead) / step if step > 0.0 else norm(normal)

    return measure


def check_surface(surface: Surface, model: mujoco.MjModel) -> None:
    """Check a custom surface: kinds of its attributes, and normals near and far from a model."""
    name, record = type(surface).__name__, surface.record(model)
    probe = getattr(type(surface), "probe", None)
    if type(surface).__module__ == __name__:
        return  # has been tested; to load the kernel takes time
    check_records(f"{name}.record", record)
    check_compiled(f"{name}.probe", probe)
    measure = entry(_measure_kernel(probe, record.dtype), f"float64(int64{4 * ', float64'})")
    for distance, *corner in product((0.1, 1, 10, 100), *3 * [(-1, 0, 1)]):
        point = model.stat.center + distance * model.stat.extent * np.array(corner)
        length = measure(record.ctypes.data, *point, 0.0)
        if not abs(length - 1.0) <= 1e-6:  # chosen
            raise InputError(f"{name}.probe: normals must have length 1, got {length:.6g}")
        if not measure(record.ctypes.data, *point, 1e-6 * model.stat.extent) > 0.0:
            raise InputError(f"{name}.probe: depth must decrease along the normal, out of the sand")


PLANE_DTYPE = np.dtype([("normal", np.float64, (3,)), ("offset", np.float64)])


@partial(compiled, inline=True)
def plane_probe(plane, point):
    """Return a point's depth below the plane along its normal [m], negative above; the normal."""
    normal = read_vector(plane.normal, 0)
    return plane.offset - dot(normal, point), normal


@dataclass(frozen=True)
class Plane(Surface):
    """An infinite plane of sand.

    Attributes:
        height: world z of the surface above the world's origin [m].
        slope: angle from the horizontal [rad], below pi/2; gravity does not rotate with it.
        uphill: direction of steepest ascent, an angle from x about z [rad], at most one turn.

    Raises:
        InputError: a value that is not finite, a slope or a direction outside its range.
    """

    probe: ClassVar[Any] = plane_probe
    is_plane: ClassVar[bool] = True

    height: float = 0.0
    slope: float = 0.0
    uphill: float = 0.0

    def __post_init__(self) -> None:
        for name in ("height", "slope", "uphill"):
            check_finite(f"the plane's {name}", getattr(self, name))
        if abs(self.slope) >= math.pi / 2:
            raise InputError(
                f"the plane's slope must be less than 90 degrees (pi/2 = 1.5708 rad), not "
                f"{self.slope:g} rad: {self.slope:g} degrees are {math.radians(self.slope):.4g}"
            )
        if abs(self.uphill) > 2 * math.pi:
            raise InputError(
                f"the plane's uphill is an angle in radians, from -2 pi to 2 pi, not "
                f"{self.uphill:g}: {self.uphill:g} degrees are {math.radians(self.uphill):.4g}"
            )

    @property
    def normal(self) -> np.ndarray:
        """Unit normal out of the sand, world frame, shape (3,)."""
        s = math.sin(self.slope)
        return np.array(
            [-s * math.cos(self.uphill), -s * math.sin(self.uphill), math.cos(self.slope)]
        )

    @property
    def offset(self) -> float:
        """Distance of the surface from the world's origin along the normal [m]."""
        return self.height * math.cos(self.slope)

    def record(self, model: mujoco.MjModel) -> np.ndarray:
        return np.array([(self.normal, self.offset)], PLANE_DTYPE)

    def lift(self, model: mujoco.MjModel) -> Mapping[str, np.ndarray]:
        return {"offset": np.ones(())}

    def tilt(self, model: mujoco.MjModel) -> float:
        return tilt_of(self.normal, model)


BED_DTYPE = np.dtype(
    [
        ("top", np.float64, (3,)),  # center of the upper face [m], world
        ("along", np.float64, (3,)),  # unit vectors of the face and its normal, world
        ("across", np.float64, (3,)),
        ("normal", np.float64, (3,)),
        ("half_along", np.float64),  # [m]
        ("half_across", np.float64),
        ("thickness", np.float64),
    ]
)

# A body on the floor of the bed penetrates it slightly, as contacts in MuJoCo do: the sand reaches
# down by this multiple of the thickness. Chosen, not measured.
_ROOM = 1.1


@compiled
def bed_probe(bed, point):
    """Return the depth below the upper face [m]; outside the bed, minus the distance to it."""
    from_top = point - read_vector(bed.top, 0)
    normal = read_vector(bed.normal, 0)
    along = abs(dot(from_top, read_vector(bed.along, 0))) - bed.half_along
    across = abs(dot(from_top, read_vector(bed.across, 0))) - bed.half_across
    beside, depth = max(along, across), -dot(normal, from_top)
    if beside > 0.0:
        depth = -beside
    elif depth > _ROOM * bed.thickness:
        depth = _ROOM * bed.thickness - depth
    return depth, normal


@dataclass(frozen=True)
class Bed(Surface):
    """The sand in a box geom: its upper face (+z of the geom) is the surface.

    Beside and under the box there is no sand. Its lower face is not a floor: put an ordinary geom
    there (a plane, or another box), which bodies meet through MuJoCo's own contacts. Contacts of
    the box are disabled; an explicit contact pair, which cannot be disabled, is an error.

    Attributes:
        geom: name of the box geom; it must be fixed to the world.
    """

    probe: ClassVar[Any] = bed_probe

    geom: str

    def __post_init__(self) -> None:
        check_geom(self.geom, "bed")

    def record(self, model: mujoco.MjModel) -> np.ndarray:
        geom = find_geom(model, self.geom, mujoco.mjtGeom.mjGEOM_BOX, "bed")
        position, axes = world_pose(model, geom)
        half = model.geom_size[geom]
        check_extents(f"the bed {self.geom!r}", half)
        top = position + half[2] * axes[:, 2]
        return np.array([(top, *axes.T, *half[:2], 2 * half[2])], BED_DTYPE)

    def geoms(self, model: mujoco.MjModel) -> tuple[int, ...]:
        return (find_geom(model, self.geom, mujoco.mjtGeom.mjGEOM_BOX, "bed"),)

    def lift(self, model: mujoco.MjModel) -> Mapping[str, np.ndarray]:
        return {"top": self.record(model)["normal"][0]}

    def tilt(self, model: mujoco.MjModel) -> float:
        return tilt_of(self.record(model)["normal"][0], model)


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

    The data may change while the simulation runs. The geom's own contacts are disabled.

    Attributes:
        geom: name of the hfield geom; it must be fixed to the world.
    """

    probe: ClassVar[Any] = height_field_probe

    geom: str

    def __post_init__(self) -> None:
        check_geom(self.geom, "height field")

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
        numbers = (half_x, half_y, elevation, rows, columns, model.hfield_data[start:].ctypes.data)
        return np.array([(position, axes.ravel(), *numbers)], HEIGHT_FIELD_DTYPE)

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
        heights = model.hfield(number).data * field["elevation"]
        with np.errstate(invalid="ignore"):  # heights may be set later
            dy = np.diff(heights, axis=0) / (2 * field["half_y"] / (field["rows"] - 1))
            dx = np.diff(heights, axis=1) / (2 * field["half_x"] / (field["columns"] - 1))
        corners = [np.hypot(x, y) for x in (dx[:-1], dx[1:]) for y in (dy[:, :-1], dy[:, 1:])]
        return math.atan(np.max(corners)) + tilt_of(field["axes"].reshape(3, 3)[:, 2], model)


surfaces: Registry[type[Surface]] = Registry("surface")
"""Classes of surfaces by the names that MJCF and strings use; `surfaces.add` adds a custom one."""

surfaces.add("plane", Plane)
surfaces.add("bed", Bed)
surfaces.add("height_field", HeightField)


def surface_of(surface: Any) -> Surface:
    """Return a surface, one parsed from words, or z = 0 for None.

    Words are `plane height= slope= uphill=`, `bed geom=`, `height_field geom=`.
    """
    if surface is None:
        return Plane()
    if isinstance(surface, Surface):
        return surface
    if not isinstance(surface, str):
        meant = "Plane(height=...), Bed('geom') or HeightField('geom')"
        raise InputError(f"a surface is needed, not {kind_of(surface)}; use {meant}")
    cls, given = read_part(surface, surfaces, "surface")
    options: Any = fields(cls)  # pyright: ignore[reportArgumentType]
    missing = [f.name for f in options if f.default is MISSING and f.name not in given]
    if missing:
        name = surface.split(maxsplit=1)[0]
        raise InputError(
            f"the surface {name!r} needs {missing[0]}=..., such as '{name} {missing[0]}=NAME'"
        )
    return cls(**given)
