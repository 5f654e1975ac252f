"""Vectors in kernels: `+`, `-`, `*`, `/`, `dot`, `cross`; a matrix is a vector of its rows.

The components are numbers, lanes (`kernel.lanes`) or vectors themselves. A vector has no overhead:
the compiler keeps its three values in registers as it would separate variables.
"""

import math
import operator
from functools import partial
from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import make_attribute_wrapper, models, register_model

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.intrinsics import intrinsic, overload
from mjgranular.kernel.lanes import Lanes, lanes_among, spread


class Vector:
    """Three numbers, in a declaration of fields (`kernel.fields`)."""


class Matrix:
    """Three vectors, row by row, in a declaration of fields."""


class VectorType(types.Type):
    """Three components of one type."""

    def __init__(self, component: Any) -> None:
        super().__init__(name=f"Vector({component})")
        self.component = component


@register_model(VectorType)
class _VectorModel(models.StructModel):
    def __init__(self, dmm: Any, fe_type: VectorType) -> None:
        super().__init__(dmm, fe_type, [(name, fe_type.component) for name in "xyz"])


for _name in "xyz":
    make_attribute_wrapper(VectorType, _name, _name)


@intrinsic
def vector(typingctx: Any, x: Any, y: Any, z: Any) -> Any:
    """Make a vector of three numbers, of lanes and numbers, or of three vectors."""
    kinds = (x, y, z)
    if isinstance(x, VectorType):
        component: Any = x
        if not all(kind == x for kind in kinds):
            return None
    else:
        component = lanes_among(kinds) or types.float64

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        made = cgutils.create_struct_proxy(sig.return_type)(context, builder)
        for name, kind, value in zip("xyz", kinds, args, strict=True):
            if isinstance(component, Lanes):
                value = spread(context, builder, kind, value, component)
            elif component == types.float64:
                value = context.cast(builder, value, kind, component)
            setattr(made, name, value)
        return made._getvalue()

    return VectorType(component)(*kinds), codegen


def _is_scalar(kind: Any) -> bool:
    return isinstance(kind, (types.Float, types.Integer, Lanes))


_INLINE = {"forceinline": True, "error_model": "numpy"}


@overload(operator.iadd, jit_options=_INLINE)
@overload(operator.add, jit_options=_INLINE)
def _add(a, b):
    if isinstance(a, VectorType) and isinstance(b, VectorType):
        return lambda a, b: vector(a.x + b.x, a.y + b.y, a.z + b.z)


@overload(operator.sub, jit_options=_INLINE)
def _sub(a, b):
    if isinstance(a, VectorType) and isinstance(b, VectorType):
        return lambda a, b: vector(a.x - b.x, a.y - b.y, a.z - b.z)


@overload(operator.mul, jit_options=_INLINE)
def _mul(a, b):
    if _is_scalar(a) and isinstance(b, VectorType):
        return lambda a, b: vector(a * b.x, a * b.y, a * b.z)
    if isinstance(a, VectorType) and _is_scalar(b):
        return lambda a, b: vector(a.x * b, a.y * b, a.z * b)


@overload(operator.truediv, jit_options=_INLINE)
def _truediv(a, b):
    if isinstance(a, VectorType) and _is_scalar(b):
        return lambda a, b: vector(a.x / b, a.y / b, a.z / b)


@overload(operator.neg, jit_options=_INLINE)
def _neg(a):
    if isinstance(a, VectorType):
        return lambda a: vector(-a.x, -a.y, -a.z)


@overload(operator.matmul, jit_options=_INLINE)
def _matmul(a, b):
    if isinstance(a, VectorType) and isinstance(a.component, VectorType):
        return lambda a, b: vector(dot(a.x, b), dot(a.y, b), dot(a.z, b))


@partial(compiled, inline=True)
def dot(a, b):
    """Return the dot product."""
    return a.x * b.x + a.y * b.y + a.z * b.z


@partial(compiled, inline=True)
def cross(a, b):
    """Return the cross product."""
    return vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@partial(compiled, inline=True)
def norm(a):
    """Return the length of a vector of numbers."""
    return math.sqrt(dot(a, a))


@partial(compiled, inline=True)
def across(u):
    """Return a unit vector perpendicular to a unit vector."""
    other = vector(0.0, u.z, -u.y) if abs(u.x) < 0.7 else vector(-u.z, 0.0, u.x)
    return other / norm(other)


@partial(compiled, inline=True)
def outer(a, b):
    """Return the outer product: the matrix a b^T."""
    return vector(a.x * b, a.y * b, a.z * b)


@partial(compiled, inline=True)
def diagonal(a):
    """Return the matrix with a number on its diagonal."""
    return vector(vector(a, 0.0, 0.0), vector(0.0, a, 0.0), vector(0.0, 0.0, a))


@partial(compiled, inline=True)
def transposed(m):
    """Return the transpose of a matrix."""
    return vector(
        vector(m.x.x, m.y.x, m.z.x), vector(m.x.y, m.y.y, m.z.y), vector(m.x.z, m.y.z, m.z.z)
    )


@partial(compiled, inline=True)
def read_vector(array, first):
    """Return the vector of three numbers of an array, from index `first` on."""
    return vector(array[first], array[first + 1], array[first + 2])


@partial(compiled, inline=True)
def write_vector(array, first, v):
    """Write the components of a vector to an array, from index `first` on."""
    array[first], array[first + 1], array[first + 2] = v.x, v.y, v.z


@partial(compiled, inline=True)
def read_matrix(array, first):
    """Return the matrix of nine numbers of an array, row by row, from index `first` on."""
    return vector(
        read_vector(array, first), read_vector(array, first + 3), read_vector(array, first + 6)
    )
