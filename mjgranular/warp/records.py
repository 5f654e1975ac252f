"""Structured arrays of NumPy's as arrays of Warp structs."""

from __future__ import annotations

import functools
from typing import Any, get_type_hints

import numpy as np
import warp as wp

from mjgranular.surface import HeightField
from mjgranular.surface.height_field import HEIGHT_FIELD_DTYPE
from mjgranular.warp.translate import MATRIX_2X3, struct, struct_of

_BY_SHAPE = {(): wp.float32, (3,): wp.vec3, (9,): wp.mat33, (3, 3): wp.mat33, (2, 3): MATRIX_2X3}


@functools.cache
def struct_of_dtype(name: str, dtype: np.dtype) -> Any:
    """The Warp struct with the fields of a structured type: numbers, vectors and matrices.

    Addresses of heights become arrays, of the name `data`.
    """
    fields: dict[str, Any] = {}
    for key in dtype.names or ():
        kind = dtype[key]
        if key == "data":
            fields[key] = wp.array(dtype=wp.float32)
        elif kind.base.kind == "i":
            fields[key] = wp.int32
        else:
            fields[key] = _BY_SHAPE[kind.shape]
    return struct(name, fields)


def to_device(records: np.ndarray, kind: Any, device: Any) -> wp.array:
    """Copies structured records to a device, as structs with fields of the same names.

    Args:
        records: shape (n,).
        kind: the struct, or a named tuple (`struct_of`).
        device: of Warp's.
    """
    made = struct_of(kind) if hasattr(kind, "_fields") else kind
    names = list(get_type_hints(kind)) if hasattr(kind, "_fields") else list(made.vars)
    packed = np.zeros(len(records), made.numpy_dtype())
    for name in names:
        packed[name] = records[name].reshape(packed[name].shape)
    return wp.array(packed, dtype=made, device=device)


def surface_on_device(surface: Any, record: np.ndarray, model: Any, device: Any) -> tuple[Any, Any]:
    """The record of a surface as a struct, in an array of one, and what kind of struct it is.

    Returns:
        The struct, and the array, shape (1,).
    """
    kind = struct_of_dtype(type(surface).__name__, record.dtype)
    if not isinstance(surface, HeightField):
        return kind, to_device(record, kind, device)
    made = kind()
    assert record.dtype == HEIGHT_FIELD_DTYPE
    for name in record.dtype.names or ():
        if name == "data":
            number = int(model.geom_dataid[surface.geoms(model)[0]])
            start, count = int(model.hfield_adr[number]), int(record["rows"][0] * record["columns"][0])
            heights = model.hfield_data[start : start + count]
            made.data = wp.array(heights, dtype=wp.float32, device=device)
        else:
            value = record[name][0]
            if value.shape == (3,):
                value = wp.vec3(*value)
            elif value.shape == (9,):
                value = wp.mat33(*value)
            else:
                value = value.item()
            setattr(made, name, value)
    return kind, made
