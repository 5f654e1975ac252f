"""Several numbers as one value of the processor's vector unit, in kernels.

A loop over lanes is vectorized only if the compiler expects a gain, which it does not for short
loops. Plain arithmetic is therefore written with values of the type `Lanes`: `+`, `-`, `*`, `/`,
`abs` and comparisons, among lanes and with numbers, which are broadcast. `choose` replaces a
branch; `all_of` makes one branch for all lanes. A function of these works on numbers and on lanes.
Each lane is IEEE arithmetic, the same on every processor.
"""

import itertools
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import lower_builtin, models, register_model, type_callable

from mjgranular.kernel.intrinsics import intrinsic

LINE = 64
"""Bytes in a cache line, and in the widest vector; rows that span two lines are slower to read."""

_DOUBLE, _INT = ir.DoubleType(), ir.IntType(64)


class Lanes(types.Type):
    """A fixed number of floats as one value."""

    def __init__(self, count: int) -> None:
        super().__init__(name=f"Lanes({count})")
        self.count = count
        self.element = _DOUBLE


class Mask(types.Type):
    """A fixed number of booleans as one value."""

    def __init__(self, count: int) -> None:
        super().__init__(name=f"Mask({count})")
        self.count = count
        self.element = ir.IntType(1)


@register_model(Lanes)
@register_model(Mask)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(fe_type.element, fe_type.count))


def lanes_among(args: Any) -> Lanes | None:
    """Return the type of the result of arithmetic; None if no argument has lanes."""
    found = next((arg for arg in args if isinstance(arg, Lanes)), None)
    others = (arg for arg in args if arg != found)
    if found is None or not all(isinstance(arg, (types.Float, types.Integer)) for arg in others):
        return None
    return found


def spread(context: Any, builder: Any, kind: Any, value: Any, lanes: Lanes) -> Any:
    """Broadcast a value to lanes."""
    if isinstance(kind, Lanes):
        return value
    number = context.cast(builder, value, kind, types.float64)
    vector = ir.VectorType(_DOUBLE, lanes.count)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), number, _INT(0))
    places = ir.Constant(ir.VectorType(ir.IntType(32), lanes.count), [0] * lanes.count)
    return builder.shuffle_vector(first, first, places)


def _define(function: Any, emit: Callable[..., Any], result: type, arguments: int) -> None:
    def result_of(*args: Any) -> Any:
        lanes = lanes_among(args)
        return None if lanes is None else result(lanes.count)

    typers = {1: lambda a: result_of(a), 2: lambda a, b: result_of(a, b)}  # numba counts arguments
    type_callable(function)(lambda context: typers[arguments])

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        lanes: Any = lanes_among(sig.args)
        values = (
            spread(context, builder, kind, value, lanes)
            for kind, value in zip(sig.args, args, strict=True)
        )
        return emit(builder, *values)

    for kinds in itertools.product((Lanes, types.Number), repeat=arguments):
        if Lanes in kinds:
            lower_builtin(function, *kinds)(lower)


def _call(builder: Any, name: str, value: Any) -> Any:
    """Emit a call of LLVM's function for numbers or vectors."""
    width = f"v{value.type.count}" if isinstance(value.type, ir.VectorType) else ""
    kind = ir.FunctionType(value.type, [value.type])
    function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.{width}f64")
    return builder.call(function, [value])


for _operator, _name in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _define(_operator, lambda builder, a, b, name=_name: getattr(builder, name)(a, b), Lanes, 2)
_define(operator.neg, lambda builder, a: builder.fneg(a), Lanes, 1)
_define(abs, lambda builder, a: _call(builder, "fabs", a), Lanes, 1)
for _operator, _name in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
):
    _define(_operator, lambda builder, a, b, name=_name: builder.fcmp_ordered(name, a, b), Mask, 2)


@intrinsic
def choose(typingctx: Any, condition: Any, yes: Any, no: Any) -> Any:
    """Return `yes if condition else no` in each lane; both are evaluated. Also for numbers."""
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


@intrinsic
def root(typingctx: Any, value: Any) -> Any:
    """Return the square root in each lane. Also for numbers."""
    if not isinstance(value, (Lanes, types.Float)):
        return None
    return value(value), lambda context, builder, sig, args: _call(builder, "sqrt", args[0])


@intrinsic
def count_of(typingctx: Any, mask: Any) -> Any:
    """Count the lanes in which a mask is true."""
    if not isinstance(mask, Mask):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.bitcast(args[0], ir.IntType(mask.count))
        return builder.zext(builder.ctpop(bits), _INT)

    return types.int64(mask), codegen


@intrinsic
def total_of(typingctx: Any, numbers: Any) -> Any:
    """Sum over lanes, halving pairwise; a number is its own sum."""
    if isinstance(numbers, types.Float):
        return numbers(numbers), lambda context, builder, sig, args: args[0]
    if not isinstance(numbers, Lanes):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        (value,) = args
        size = numbers.count
        while size > 1:
            size //= 2
            kind = ir.VectorType(ir.IntType(32), size)
            halves = (ir.Constant(kind, list(range(at, at + size))) for at in (0, size))
            low, high = (builder.shuffle_vector(value, value, half) for half in halves)
            value = builder.fadd(low, high)
        return builder.extract_element(value, ir.IntType(32)(0))

    return types.float64(numbers), codegen


@intrinsic
def all_of(typingctx: Any, condition: Any) -> Any:
    """Return True if a condition holds in all lanes."""
    if isinstance(condition, types.Boolean):
        return types.boolean(condition), lambda context, builder, sig, args: args[0]
    if not isinstance(condition, Mask):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = ir.IntType(condition.count)
        return builder.icmp_unsigned("==", builder.bitcast(args[0], kind), kind(-1))

    return types.boolean(condition), codegen


def aligned(numbers: np.ndarray) -> np.ndarray:
    """Copy an array of floats to the start of a cache line."""
    room = np.empty(numbers.size + LINE // 8)
    first = -(room.ctypes.data // 8) % (LINE // 8)
    copy = room[first : first + numbers.size].reshape(numbers.shape)
    copy[...] = numbers
    return copy
