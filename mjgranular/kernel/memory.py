"""A table of integers through which kernels read and write a simulation.

Passing a NumPy array to numba costs about 80 ns, and a kernel needs a dozen arrays of `mjData` and
four of the sand: more than the time of a bare `mj_step` on a one-link model. Their addresses are
fixed while the `MjData` lives, so one table of addresses replaces them. An engine plugin, which
gets only the `mjData*` and no NumPy arrays, fills the same table.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir
from mujoco.introspect.ast_nodes import PointerType
from numba import extending, from_dtype, types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.np.arrayobj import populate_array

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import fields_of, offset_of
from mjgranular.kernel.intrinsics import intrinsic

# The table: five numbers, then addresses. `sand.binding` fills it. LONGEST_STEP is in nanoseconds
# (`scheme.scheme`).
# Within `mj_step` (`engine.block`) XFRC, WARNINGS and SNAPSHOT are 0: there MuJoCo handles them.
# STATE to UPDATE belong to a surface with memory: the address of its state, the number of values in
# it, and the address of the program that updates it after a step; 0 without memory. SAMPLING and
# LAW are the addresses of the programs of `Scheme.sampling` and `Scheme.forces`; 0 for none.
# SURFACE is where the surface begins in a scene, after the law [bytes]. BESIDE is the table of the
# sand that acted before this one in the same step, and is solved together with it; 0 for none. OFF
# is 1 for a sand that is switched off, or whose step has ended.
NBODY, NV, ELEMENT_COUNT, BODY_COUNT, LONGEST_STEP = range(5)
OPTIONS, DOF_PARENT, XPOS, XMAT, XIPOS, SUBTREE_COM, CVEL, CDOF, WARMSTART, XFRC = range(5, 15)
WARNINGS, ELEMENTS, BODIES, SCENE, CONTACTS, SNAPSHOT, WORKSPACE = range(15, 22)
STATE, STATE_SIZE, UPDATE, SAMPLING, LAW, SURFACE, BESIDE, OFF = range(22, 30)
TABLE_SIZE = 30

_WORD = ir.IntType(64)


def emit_array(
    context: Any, builder: Any, kind: Any, itemsize: int, address: Any, shape: list[Any]
) -> Any:
    """Emit an array in C order at an address."""
    array = context.make_array(kind)(context, builder)
    strides = [_WORD(itemsize)]
    for size in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], size))
    populate_array(
        array,
        data=builder.inttoptr(address, array.data.type),
        shape=shape,
        strides=strides,
        itemsize=_WORD(itemsize),
        meminfo=None,
    )
    return array._getvalue()


def records(dtype: np.dtype) -> Any:
    """Make a kernel `read(address, size)` that returns the array of such records at an address."""

    @intrinsic
    def read(typingctx: Any, address: Any, size: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = signature.return_type
            return emit_array(context, builder, kind, dtype.itemsize, args[0], [args[1]])

        return types.Array(from_dtype(dtype), 1, "C")(types.int64, types.int64), codegen

    return read


def field(struct: str, name: str) -> Any:
    """Make a kernel `find(address)` for a field of MuJoCo's struct at an address.

    It returns the value of a pointer, and the address of anything else.
    """

    @intrinsic
    def find(typingctx: Any, address: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            place = builder.add(args[0], _WORD(offset_of(struct, name)))
            if isinstance(fields_of(struct)[name].type, PointerType):
                return builder.load(builder.inttoptr(place, _WORD.as_pointer()))
            return place

        return types.int64(types.int64), codegen

    return find


def numbers_of(context: Any, builder: Any, array: Any, args: Any, last: int) -> Any:
    """Return the address of an array's numbers; check the indices as numba's own indexing does.

    `args` are the array and the first index used, `last` the offset of the last one from it.
    """
    opened = context.make_array(array)(context, builder, args[0])
    if context.enable_boundscheck:
        size = builder.extract_value(opened.shape, 0)
        for index in (args[1], builder.add(args[1], args[1].type(last))):
            cgutils.do_boundscheck(context, builder, index, size)
    return opened.data


@cache
def scratch(count: int) -> Any:
    """Make a kernel `scratch()`: an uninitialized array of `count` numbers on the stack.

    It is valid until the calling function returns.
    """

    @intrinsic
    def make(typingctx: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            memory = cgutils.alloca_once(builder, ir.ArrayType(ir.DoubleType(), count))
            memory.align = 64  # a cache line, and the widest vector
            address = builder.ptrtoint(memory, _WORD)
            return emit_array(context, builder, signature.return_type, 8, address, [_WORD(count)])

        return types.Array(types.float64, 1, "C")(), codegen

    return make


@intrinsic
def held(typingctx: Any, record: Any) -> Any:
    """Copy a record to the stack, where nothing else can change it.

    A loop that writes elsewhere would read a record's fields again in each iteration, and could not
    be vectorized: the compiler must assume that it writes to them.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        copy = cgutils.alloca_once(builder, ir.ArrayType(ir.IntType(8), record.size))
        copy.align = 8
        cgutils.raw_memcpy(builder, copy, args[0], _WORD(record.size), 1)
        return builder.bitcast(copy, args[0].type)

    return record(record), codegen


floats = records(np.dtype(np.float64))
ints = records(np.dtype(np.int32))
longs = records(np.dtype(np.int64))


@compiled
def row_of(address, number, width):
    """Return a row of a matrix of floats at an address.

    numba checks every index but constants, such as those into a row, for a negative value.
    """
    return floats(address + 8 * width * number, width)


@compiled
def table_at(address):
    """Return the table at an address."""
    return longs(address, TABLE_SIZE)


# Records of numbers and addresses that kernels read as numbers and arrays: `w.nv`, `w.qvel[j]`.
# Kernels pass such a record as one word, its address; each array would take seven.


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
