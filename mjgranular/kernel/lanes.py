"""Several numbers as one, in kernels: a value of the processor's vector unit.

A loop over lanes becomes vector instructions only if the compiler finds it worth its while, and
short ones it does not. What is plain arithmetic is therefore written with values of the type
`Lanes`: `+`, `-`, `*`, `/`, `abs` and comparisons of them, and with numbers, which stand for as
many alike. Where a branch would be there is `choose`. A function without branches serves both,
numbers and lanes. Each lane is IEEE arithmetic, the same on every processor.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from mjgranular.kernel.foreign import Intrinsic
from mjgranular.kernel.memory import numbers_of

LINE = 64
"""Bytes in a line of the cache, and in the widest vector. Rows that lie across two lines take up to
twice as long to read."""


def _choose(typingctx: Any, condition: Any, yes: Any, no: Any) -> Any:
    """`yes if condition else no`, in each lane; both are worked out. Of numbers, too."""
    from numba import types

    from mjgranular.kernel.lane_types import Lanes, Mask, lanes_among, spread

    result = lanes_among((yes, no))
    if isinstance(condition, Mask):
        result = Lanes(condition.count)
    elif result is None:
        result = types.float64

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        values = (
            spread(context, builder, kind, value, result)
            if isinstance(result, Lanes)
            else context.cast(builder, value, kind, result)
            for kind, value in zip(sig.args[1:], args[1:], strict=True)
        )
        return builder.select(args[0], *values)

    return result(condition, yes, no), codegen


def _count(typingctx: Any, mask: Any) -> Any:
    """In how many lanes it is so."""
    from llvmlite import ir
    from numba import types

    from mjgranular.kernel.lane_types import Mask

    if not isinstance(mask, Mask):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.bitcast(args[0], ir.IntType(mask.count))
        return builder.zext(builder.ctpop(bits), ir.IntType(64))

    return types.int64(mask), codegen


choose: Any = Intrinsic(_choose)
count_of: Any = Intrinsic(_count)


@dataclass(frozen=True)
class Rows:
    """Rows of numbers, one for each lane, that lie one behind the other in an array of floats.

    Attributes:
        read: kernel `read(array, first)`: a tuple of so many rows, from index `first` on.
        write: kernel `write(array, first, rows)`.
    """

    read: Any
    write: Any


@cache
def rows(count: int, lanes: int) -> Rows:
    """Makes the kernels for so many rows of so many lanes."""

    def places(context: Any, builder: Any, array: Any, args: Any) -> list[Any]:
        from llvmlite import ir

        vector = ir.VectorType(ir.DoubleType(), lanes)
        data = numbers_of(context, builder, array, args, count * lanes - 1)
        indices = (builder.add(args[1], args[1].type(k * lanes)) for k in range(count))
        return [
            builder.bitcast(builder.gep(data, [index]), vector.as_pointer()) for index in indices
        ]

    def read(typingctx: Any, array: Any, first: Any) -> Any:
        from numba import types

        from mjgranular.kernel.lane_types import Lanes

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            numbers = [
                builder.load(place, align=8) for place in places(context, builder, array, args)
            ]
            return context.make_tuple(builder, sig.return_type, numbers)

        return types.UniTuple(Lanes(lanes), count)(array, types.int64), codegen

    def write(typingctx: Any, array: Any, first: Any, numbers: Any) -> Any:
        from numba import types

        from mjgranular.kernel.lane_types import Lanes, spread

        if len(numbers) != count:
            return None

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            for k, place in enumerate(places(context, builder, array, args)):
                value = builder.extract_value(args[2], k)
                value = spread(context, builder, sig.args[2][k], value, Lanes(lanes))
                builder.store(value, place, align=8)
            return context.get_dummy_value()

        return types.void(array, types.int64, numbers), codegen

    return Rows(Intrinsic(read), Intrinsic(write))


def aligned(numbers: np.ndarray) -> np.ndarray:
    """A copy of an array of floats that begins with a line of the cache."""
    room = np.empty(numbers.size + LINE // 8)
    first = -(room.ctypes.data // 8) % (LINE // 8)
    copy = room[first : first + numbers.size].reshape(numbers.shape)
    copy[...] = numbers
    return copy
