"""Named tuples of numbers, vectors and matrices, in kernels and in arrays of numbers.

Their parts are declared once, as the fields of a `typing.NamedTuple`: `float`, `Vector`, `Matrix`,
or a tuple of these. Reading and writing follow from that. In an array, the numbers of one value are
a fixed stride apart: several values can be stored side by side, one in each *lane*, and be read one
by one (`column`) or all at once, as `Lanes` (`rows`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, get_args, get_type_hints

import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic

from mjgranular.errors import InputError
from mjgranular.kernel.lanes import Lanes, spread
from mjgranular.kernel.memory import numbers_of
from mjgranular.kernel.vector import Matrix, Vector, VectorType


@dataclass(frozen=True)
class Access:
    """Kernels for values of one kind in an array of floats."""

    read: Any  # `read(array, first)` returns the value whose first number has this index
    write: Any  # `write(array, first, value)` writes it


@cache
def column(kind: Any, lanes: int) -> Access:
    """Make the kernels for one value in an array of `lanes` lanes, the distance of its numbers.

    The kind is `float`, `Vector`, `Matrix`, a named tuple of these, or a number of floats.
    """
    return _access(kind, lanes, types.float64)


@cache
def rows(kind: Any, lanes: int) -> Access:
    """Make the kernels for the values in all lanes as one, of `Lanes` (floats for one lane)."""
    return _access(kind, lanes, types.float64 if lanes == 1 else Lanes(lanes))


def size_of(kind: Any) -> int:
    """Return the number of floats in a value."""
    return len(list(_leaves_of_type(_type_of(kind, types.float64))))


def packed(records: np.ndarray, kind: Any) -> np.ndarray:
    """Return the fields of a named tuple from records, as floats, shape (n, `size_of(kind)`)."""
    columns = [np.zeros((len(records), 0))]
    for name, part in get_type_hints(kind).items():
        is_there = name in (records.dtype.names or ())
        columns.append(records[name].reshape(len(records), -1) if is_there else columns[0])
        count, found = size_of(part), columns[-1].shape[1]
        if count != found:
            raise InputError(
                f"elements of the law must have a field {name!r} of {count} numbers, as "
                f"{kind.__name__} has, got {found}"
            )
    return np.concatenate(columns, axis=1)


def _type_of(kind: Any, number: Any) -> Any:
    """Return the numba type of a value of a kind, with numbers of a type."""
    if isinstance(kind, int):
        return types.UniTuple(number, kind)
    if kind is float:
        return number
    if kind is Vector:
        return VectorType(number)
    if kind is Matrix:
        return VectorType(VectorType(number))
    if hasattr(kind, "_fields"):
        return types.BaseTuple.from_types(
            [_type_of(each, number) for each in get_type_hints(kind).values()], kind
        )
    return types.BaseTuple.from_types([_type_of(each, number) for each in get_args(kind)])


def _parts(kind: Any) -> list[Any] | None:
    """Return the types of a value's parts; None for a number."""
    if isinstance(kind, VectorType):
        return [kind.component] * 3
    parts: Any = kind
    return list(parts) if isinstance(kind, types.BaseTuple) else None


def _leaves_of_type(kind: Any) -> Iterator[Any]:
    parts = _parts(kind)
    if parts is None:
        yield kind
    for part in parts or ():
        yield from _leaves_of_type(part)


def _leaves(builder: Any, kind: Any, value: Any) -> Iterator[Any]:
    """Yield the numbers of a value, in order."""
    parts = _parts(kind)
    if parts is None:
        yield value
    for k, part in enumerate(parts or ()):
        yield from _leaves(builder, part, builder.extract_value(value, k))


def _built(context: Any, builder: Any, kind: Any, numbers: Iterator[Any]) -> Any:
    parts = _parts(kind)
    if parts is None:
        return next(numbers)
    values = [_built(context, builder, part, numbers) for part in parts]
    if isinstance(kind, VectorType):
        made = cgutils.create_struct_proxy(kind)(context, builder)
        made.x, made.y, made.z = values
        return made._getvalue()
    return context.make_tuple(builder, kind, values)


def _access(kind: Any, stride: int, number: Any) -> Access:
    result = _type_of(kind, number)
    count, lanes = size_of(kind), getattr(number, "count", 1)
    # Also part of the name of cached machine code: a class in a notebook has no other name.
    fields = str(get_type_hints(kind)) if hasattr(kind, "_fields") else str(kind)

    def places(context: Any, builder: Any, array: Any, args: Any) -> list[Any]:
        data = numbers_of(context, builder, array, args, (count - 1) * stride + lanes - 1)
        pointer = context.get_value_type(number).as_pointer()
        indices = (builder.add(args[1], args[1].type(k * stride)) for k in range(count))
        return [builder.bitcast(builder.gep(data, [index]), pointer) for index in indices]

    @intrinsic
    def read(typingctx: Any, array: Any, first: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            numbers = (
                builder.load(place, align=8) for place in places(context, builder, array, args)
            )
            return _built(context, builder, result, numbers)

        return result(array, types.int64), codegen

    @intrinsic
    def write(typingctx: Any, array: Any, first: Any, value: Any) -> Any:
        kinds = list(_leaves_of_type(value))
        if len(kinds) != count:
            raise TypingError(f"{value} is not made of {fields}")

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            targets = places(context, builder, array, args)
            numbers = _leaves(builder, sig.args[2], args[2])
            for place, one, leaf in zip(targets, kinds, numbers, strict=True):
                if isinstance(number, Lanes):
                    leaf = spread(context, builder, one, leaf, number)
                else:
                    leaf = context.cast(builder, leaf, one, number)
                builder.store(leaf, place, align=8)
            return context.get_dummy_value()

        return types.void(array, types.int64, value), codegen

    return Access(read, write)
