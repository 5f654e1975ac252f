"""The kernels of laws and surfaces, compiled by Warp from the same source, and their records.

A kernel is Python that numba compiles (`kernel.compiled`). Warp compiles Python too; only the
meaning of the names differs. `translated` takes a kernel's code and binds its names to Warp's
equivalents: vectors are `wp.vec3`, named tuples are structs, a kernel that is called is translated
first. So each formula is written once. All numbers are single precision.
"""

import functools
import hashlib
import inspect
import math
from collections.abc import Callable
from types import CellType, FunctionType
from typing import Any, get_type_hints

import numpy as np
import warp as wp

from mjgranular.kernel import elementary, lanes, memory, vector
from mjgranular.kernel.motion import Motion
from mjgranular.law.kernel import Level, Pose
from mjgranular.relief import grid, probe
from mjgranular.relief.relief import Relief, relief_dtype
from mjgranular.surface.surface import Surface, height_of
from mjgranular.warp import grid as grid_of_worlds
from mjgranular.warp.grid import Grid, struct

MATRIX_2X3 = wp.types.matrix(shape=(2, 3), dtype=wp.float32)
"""Two vectors: the half edges of a facet."""


@wp.func
def _diagonal(a: float):
    return wp.mat33(a, 0.0, 0.0, 0.0, a, 0.0, 0.0, 0.0, a)


@wp.func
def _read(array: Any, first: Any):
    """Read a vector or matrix of a record, which has that type already in Warp."""
    return array


@wp.func
def _all_of(condition: bool):
    return condition


@wp.func
def _copysign(size: float, sign: float):
    return wp.where(sign < 0.0, -wp.abs(size), wp.abs(size))


@wp.func
def _height(field: Any, k: int):
    return field.data[k] * field.elevation


@wp.func
def _no_length(size: int):
    return 0


class _Math:
    """Functions of `math` that kernels use."""

    pi = math.pi
    nan = math.nan
    inf = wp.inf
    sqrt = wp.sqrt
    copysign = _copysign


# Replacements of names that are not kernels to translate, by identity of the object.
_MEANINGS: dict[int, Any] = {
    id(thing): meaning
    for thing, meaning in (
        (math, _Math),
        (vector.vector, wp.vec3),
        (vector.dot, wp.dot),
        (vector.cross, wp.cross),
        (vector.norm, wp.length),
        (vector.outer, wp.outer),
        (vector.diagonal, _diagonal),
        (vector.transposed, wp.transpose),
        (vector.read_vector, _read),
        (vector.read_matrix, _read),
        (lanes.choose, wp.where),
        (lanes.all_of, _all_of),
        (lanes.root, wp.sqrt),
        (elementary.logarithm, wp.log),
        (elementary.exponential, wp.exp),
        (height_of, _height),
        (memory.floats, _read),
        (probe.state_length, _no_length),
        (probe.highest_of, grid_of_worlds.highest_of),
        (grid.height_at, grid_of_worlds.height_at),
        (grid.mean_at, grid_of_worlds.mean_at),
    )
}
_FIELD_TYPES = {
    float: wp.float32,
    vector.Vector: wp.vec3,
    vector.Matrix: wp.mat33,
    tuple[vector.Vector, vector.Vector]: MATRIX_2X3,
}
_UNTYPED: dict[type, dict[str, Any]] = {
    Level: {"normal": vector.Vector, "depth": float},
    Pose: {
        "position": vector.Vector,
        "rotation": vector.Matrix,
        "com": vector.Vector,
        "tree": vector.Vector,
        "motion": Motion,
    },
}


@functools.cache
def struct_of(kind: type) -> Any:
    """Return the Warp struct of a named tuple (`kernel.fields`)."""
    hints = _UNTYPED.get(kind) or get_type_hints(kind)
    fields = {name: _FIELD_TYPES.get(each) or struct_of(each) for name, each in hints.items()}
    return struct(kind.__name__, fields)


@functools.cache
def translated(kernel: Any) -> Any:
    """Return the Warp function of a compiled kernel of vectors, numbers and named tuples."""
    source: Callable[..., Any] = kernel.py_func
    names = source.__code__.co_names
    globals_ = dict(source.__globals__)
    globals_.update({name: _meaning(globals_[name]) for name in names if name in globals_})
    cells = tuple(CellType(_meaning(cell.cell_contents)) for cell in source.__closure__ or ())
    function: Any = FunctionType(
        source.__code__, globals_, source.__name__, source.__defaults__, cells or None
    )
    function.__module__ = source.__module__
    function.__annotations__ = dict.fromkeys(inspect.signature(source).parameters, Any)
    return wp.func(function, name=f"{source.__name__}_{_identity(kernel)}")


def _meaning(thing: Any) -> Any:
    """Return the Warp equivalent of an object that a kernel names."""
    if id(thing) in _MEANINGS:
        return _MEANINGS[id(thing)]
    if hasattr(thing, "py_func"):
        return translated(thing)
    if isinstance(thing, type) and issubclass(thing, tuple) and hasattr(thing, "_fields"):
        return struct_of(thing)
    if isinstance(thing, tuple) and thing and all(isinstance(each, float) for each in thing):
        return wp.types.vector(length=len(thing), dtype=wp.float32)(*thing)
    return thing


def _identity(thing: Any) -> str:
    """Return a name for a kernel from its source and closure, the same in every process."""
    if not hasattr(thing, "py_func"):
        return getattr(thing, "__name__", repr(thing))
    source = thing.py_func
    parts = [source.__module__, source.__qualname__]
    parts += [_identity(cell.cell_contents) for cell in source.__closure__ or ()]
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()[:8]


_UNREAD = ("points", "spheres", "feet")  # addresses that no kernel reads on a device
_ADDRESSES = {"data": wp.array(dtype=wp.float32), "state": Grid}
_BY_SHAPE = {(): wp.float32, (3,): wp.vec3, (9,): wp.mat33, (3, 3): wp.mat33, (2, 3): MATRIX_2X3}


@functools.cache
def struct_of_dtype(name: str, dtype: np.dtype) -> Any:
    """Make the Warp struct with the fields of a dtype: numbers, vectors, matrices, records.

    Addresses of heights become arrays named `data`, that of a relief's state becomes its `Grid`.
    """
    fields: dict[str, Any] = {}
    for key in dtype.names or ():
        kind = dtype[key]
        if key in _ADDRESSES:
            fields[key] = _ADDRESSES[key]
        elif kind.names:
            fields[key] = struct_of_dtype(name.removeprefix(Relief.__name__), kind)
        elif kind.base.kind == "i":
            fields[key] = wp.int32
        elif len(kind.shape) == 1 and kind.shape not in _BY_SHAPE:
            fields[key] = wp.types.vector(length=kind.shape[0], dtype=wp.float32)
        else:
            fields[key] = _BY_SHAPE[kind.shape]
    return struct(name, fields)


_relief = relief_dtype(np.dtype([]))
PlainRelief = struct_of_dtype(
    "PlainRelief",
    np.dtype([(name, _relief[name]) for name in _relief.names or () if name != "base"]),
)
"""A surface with memory but without its base surface, which many kernels do not need."""


def to_device(records: np.ndarray, kind: Any, device: Any) -> wp.array:
    """Copy records, shape (n,), to a device, as structs (`struct_of`) with the same fields."""
    made = struct_of(kind) if hasattr(kind, "_fields") else kind
    packed: Any = np.zeros(len(records), made.numpy_dtype())
    fields: Any = records
    for name in made.vars:
        packed[name] = fields[name].reshape(packed[name].shape)
    return wp.array(packed, dtype=made, device=device)


def struct_of_surface(surface: Surface, record: np.ndarray) -> Any:
    """Return the Warp struct of a surface with that record, shape (1,)."""
    return struct_of_dtype(_name_of(surface), record.dtype)


def surface_on_device(
    surface: Surface, record: np.ndarray, model: Any, device: Any, grid: Any = None
) -> Any:
    """Return the record of a surface as a struct; a height field has its present heights.

    `grid` has its heights, if it has memory.
    """
    made = _filled(struct_of_surface(surface, record)(), record)
    names = record.dtype.names or ()
    if isinstance(surface, Relief):
        made.base = surface_on_device(surface.base, record["base"], model, device)
        made.state = grid
    elif "data" in names:
        first = int(model.hfield_adr[model.geom_dataid[surface.geoms(model)[0]]])
        count = int(record["rows"][0] * record["columns"][0])
        heights = model.hfield_data[first : first + count]
        made.data = wp.array(heights, dtype=wp.float32, device=device)
    return made


def plain_relief(record: np.ndarray, grid: Any) -> Any:
    """Return a surface with memory as a `PlainRelief`, from its record and its heights."""
    made = _filled(PlainRelief(), record)
    made.state = grid
    return made


def _filled(made: Any, record: np.ndarray) -> Any:
    """Fill a struct with the numbers, vectors and matrices of a record, without its pointers."""
    for name in record.dtype.names or ():
        value = record[name][0]
        if name not in (*_ADDRESSES, *_UNREAD, "base"):
            setattr(made, name, _BY_SHAPE[value.shape](*value) if value.shape else value.item())
    return made


def _name_of(surface: Surface) -> str:
    kind = type(surface).__name__
    return kind + _name_of(surface.base) if isinstance(surface, Relief) else kind
