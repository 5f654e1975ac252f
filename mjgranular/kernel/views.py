"""Records of numbers and addresses that kernels read as numbers and arrays: `w.nv`, `w.qvel[j]`.

Kernels pass such a record as one word, its address; each array would take seven.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, from_dtype, types
from numba.core.typing.templates import AttributeTemplate

from mjgranular.kernel.memory import emit_array

_WORD = ir.IntType(64)


class Views(types.Type):
    """A record of words: numbers of given types, then addresses of arrays; `dtype` in memory.

    `arrays` has the type of the items of each, and its shape in integers and names of numbers.
    """

    def __init__(
        self,
        name: str,
        numbers: Mapping[str, Any],
        arrays: Mapping[str, tuple[Any, tuple[int | str, ...]]],
    ) -> None:
        super().__init__(name=f"Views({name})")
        self.dtype = np.dtype([*numbers.items(), *((field, np.int64) for field in arrays)])
        self.numbers = {field: from_dtype(np.dtype(dtype)) for field, dtype in numbers.items()}
        self.arrays = dict(arrays)

    def kind(self, field: str) -> Any:
        """Return the numba type of a field, None if there is none."""
        if field in self.arrays:
            dtype, shape = self.arrays[field]
            return types.Array(from_dtype(np.dtype(dtype)), len(shape), "C")
        return self.numbers.get(field)

    def place(self, builder: Any, address: Any, field: str) -> Any:
        """Emit the pointer to a number or an address."""
        fields: Any = self.dtype.fields
        is_real = self.numbers.get(field) == types.float64
        word = ir.DoubleType() if is_real else _WORD
        return builder.inttoptr(builder.add(address, _WORD(fields[field][1])), word.as_pointer())


@extending.register_model(Views)
class _ViewsModel(extending.models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Views) -> None:
        super().__init__(dmm, fe_type, _WORD)


@extending.infer_getattr
class _Fields(AttributeTemplate):
    key = Views

    def generic_resolve(self, views: Views, field: str) -> Any:
        return views.kind(field)


@extending.lower_getattr_generic(Views)
def _read(context: Any, builder: Any, views: Views, address: Any, field: str) -> Any:
    def word(name: str) -> Any:
        return builder.load(views.place(builder, address, name))

    if field not in views.arrays:
        return word(field)
    dtype, sizes = views.arrays[field]
    shape = [word(size) if isinstance(size, str) else _WORD(size) for size in sizes]
    itemsize = np.dtype(dtype).itemsize
    return emit_array(context, builder, views.kind(field), itemsize, word(field), shape)


@extending.lower_setattr_generic(Views)
def _write(context: Any, builder: Any, sig: Any, args: Any, field: str) -> Any:
    builder.store(args[1], sig.args[0].place(builder, args[0], field))


def views_at(views: Views) -> Any:
    """Make a kernel `at(address)` that returns the record there."""

    @extending.intrinsic
    def at(typingctx: Any, address: Any) -> Any:
        return views(types.int64), lambda context, builder, sig, args: args[0]

    return at
