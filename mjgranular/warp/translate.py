"""The kernels of laws and surfaces, compiled by Warp from the same source.

A kernel is Python that numba compiles (`kernel.compiled`). Warp compiles Python too; only the
meaning of the names differs. `translated` takes a kernel's code and binds its names to Warp's
equivalents: vectors are `wp.vec3`, named tuples are structs, a kernel that is called is translated
first. So each formula is written once. All numbers are single precision.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import math
from collections.abc import Callable
from types import CellType, FunctionType
from typing import Any, get_args, get_type_hints

import warp as wp

from mjgranular.kernel import elementary, lanes, memory, vector
from mjgranular.kernel.motion import Motion
from mjgranular.law.kernel import Level, Pose
from mjgranular.relief import grid, probe
from mjgranular.surface import height_field
from mjgranular.warp import grid as grid_of_worlds
from mjgranular.warp.grid import struct

MATRIX_2X3 = wp.types.matrix(shape=(2, 3), dtype=wp.float32)
"""Two vectors: the half edges of a facet."""


@wp.func
def _vector(x: float, y: float, z: float):
    return wp.vec3(x, y, z)


@wp.func
def _norm(a: Any):
    return wp.length(a)


@wp.func
def _diagonal(a: float):
    return wp.mat33(a, 0.0, 0.0, 0.0, a, 0.0, 0.0, 0.0, a)


@wp.func
def _read(array: Any, first: Any):
    """Read a vector or matrix of a record, which has that type already in Warp."""
    return array


@wp.func
def _choose(condition: bool, yes: Any, no: Any):
    return wp.where(condition, yes, no)


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
        (vector.vector, _vector),
        (vector.dot, wp.dot),
        (vector.cross, wp.cross),
        (vector.norm, _norm),
        (vector.outer, wp.outer),
        (vector.diagonal, _diagonal),
        (vector.transposed, wp.transpose),
        (vector.read_vector, _read),
        (vector.read_matrix, _read),
        (lanes.choose, _choose),
        (lanes.all_of, _all_of),
        (lanes.root, wp.sqrt),
        (elementary.logarithm, wp.log),
        (elementary.exponential, wp.exp),
        (height_field.height_of, _height),
        (memory.floats, _read),
        (probe.state_length, _no_length),
        (probe.highest_of, grid_of_worlds.highest_of),
        (grid.height_at, grid_of_worlds.height_at),
        (grid.mean_at, grid_of_worlds.mean_at),
    )
}
_FIELD_TYPES = {float: wp.float32, vector.Vector: wp.vec3, vector.Matrix: wp.mat33}


_MOTION = struct("Motion", {"angular": wp.vec3, "linear": wp.vec3})
_TUPLES: dict[type, Any] = {
    Motion: _MOTION,
    Level: struct("Level", {"normal": wp.vec3, "depth": wp.float32}),
    Pose: struct(
        "Pose",
        {
            "position": wp.vec3,
            "rotation": wp.mat33,
            "com": wp.vec3,
            "tree": wp.vec3,
            "motion": _MOTION,
        },
    ),
}


def struct_of(kind: type) -> Any:
    """Return the Warp struct of a named tuple (`kernel.fields`)."""
    if kind not in _TUPLES:
        fields = {name: _field_type(each) for name, each in get_type_hints(kind).items()}
        _TUPLES[kind] = struct(kind.__name__, fields)
    return _TUPLES[kind]


def _field_type(kind: Any) -> Any:
    if get_args(kind) == (vector.Vector, vector.Vector):
        return MATRIX_2X3
    return _FIELD_TYPES[kind]


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
