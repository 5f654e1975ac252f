"""NumPy structured arrays as arrays of Warp structs."""

from __future__ import annotations

import functools
from typing import Any, get_type_hints

import numpy as np
import warp as wp

from mjgranular.relief.relief import Relief, relief_dtype
from mjgranular.surface import Surface
from mjgranular.warp.grid import Grid, struct
from mjgranular.warp.translate import MATRIX_2X3, struct_of

_UNREAD = ("points", "spheres", "feet")  # addresses that no kernel reads on a device
_ADDRESSES = {"data": wp.array(dtype=wp.float32), "state": Grid}
_BY_SHAPE = {(): wp.float32, (3,): wp.vec3, (9,): wp.mat33, (3, 3): wp.mat33, (2, 3): MATRIX_2X3}


@functools.cache
def struct_of_dtype(name: str, dtype: np.dtype) -> Any:
    """Make the Warp struct with the fields of a dtype: numbers, vectors, matrices, records.

    Addresses of heights become arrays named `data`; the address of a relief's state becomes its
    `Grid`.
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
        else:
            fields[key] = _of_shape(kind.shape)
    return struct(name, fields)


def _of_shape(shape: tuple[int, ...]) -> Any:
    """Return the type of a numeric field."""
    if shape not in _BY_SHAPE and len(shape) == 1:
        return wp.types.vector(length=shape[0], dtype=wp.float32)
    return _BY_SHAPE[shape]


def _without_base(relief: np.dtype) -> np.dtype:
    return np.dtype([(name, relief[name]) for name in relief.names or () if name != "base"])


PlainRelief = struct_of_dtype("PlainRelief", _without_base(relief_dtype(np.dtype([]))))
"""A surface with memory but without its base surface, which many kernels do not need."""


def to_device(records: np.ndarray, kind: Any, device: Any) -> wp.array:
    """Copy records, shape (n,), to a device, as structs (`struct_of`) with the same fields."""
    made = struct_of(kind) if hasattr(kind, "_fields") else kind
    names = list(get_type_hints(kind)) if hasattr(kind, "_fields") else list(made.vars)
    packed: Any = np.zeros(len(records), made.numpy_dtype())
    fields: Any = records
    for name in names:
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
