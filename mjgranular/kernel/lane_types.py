"""What numba has to know of lanes (`kernel.lanes`): their types, and arithmetic with them."""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model

_DOUBLE, _INT = ir.DoubleType(), ir.IntType(64)


class Lanes(types.Type):
    """So many numbers as one."""

    def __init__(self, count: int) -> None:
        super().__init__(name=f"Lanes({count})")
        self.count = count


class Mask(types.Type):
    """So many yes or no."""

    def __init__(self, count: int) -> None:
        super().__init__(name=f"Mask({count})")
        self.count = count


@register_model(Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Mask) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(ir.IntType(1), fe_type.count))


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Lanes) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(_DOUBLE, fe_type.count))


def lanes_among(args: Any) -> Lanes | None:
    """The type of the result of arithmetic, None if that is no business of ours."""
    found = next((arg for arg in args if isinstance(arg, Lanes)), None)
    others = (arg for arg in args if arg != found)
    if found is None or not all(isinstance(arg, (types.Float, types.Integer)) for arg in others):
        return None
    return found


def spread(context: Any, builder: Any, kind: Any, value: Any, lanes: Lanes) -> Any:
    """A value as lanes: a number stands for as many alike."""
    if isinstance(kind, Lanes):
        return value
    number = context.cast(builder, value, kind, types.float64)
    vector = ir.VectorType(_DOUBLE, lanes.count)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), number, _INT(0))
    places = ir.Constant(ir.VectorType(ir.IntType(32), lanes.count), [0] * lanes.count)
    return builder.shuffle_vector(first, first, places)


def _define(
    function: Any, emit: Callable[..., Any], result: Callable[[Lanes], Any], arguments: int
) -> None:
    """Makes an operator known for lanes."""

    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            lanes = lanes_among(args)
            return None if lanes is None else signature(result(lanes), *args)

    known: Any = infer_global(function)
    known(Template)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        lanes: Any = lanes_among(sig.args)
        values = (
            spread(context, builder, kind, value, lanes)
            for kind, value in zip(sig.args, args, strict=True)
        )
        return emit(builder, *values)

    kinds = (Lanes, types.Number)
    for pair in itertools.product(kinds, repeat=arguments):
        if Lanes in pair:
            lower_builtin(function, *pair)(lower)


def _size(builder: Any, value: Any) -> Any:
    kind = ir.FunctionType(value.type, [value.type])
    name = f"llvm.fabs.v{value.type.count}f64"
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), [value])


def _same(lanes: Lanes) -> Lanes:
    return lanes


for _operator, _name in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _define(_operator, lambda builder, a, b, name=_name: getattr(builder, name)(a, b), _same, 2)
_define(operator.neg, lambda builder, a: builder.fneg(a), _same, 1)
_define(abs, _size, _same, 1)
for _operator, _sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
):
    _define(
        _operator,
        lambda builder, a, b, sign=_sign: builder.fcmp_ordered(sign, a, b),
        lambda lanes: Mask(lanes.count),
        2,
    )
