"""Ties compiled code to addresses: of MuJoCo's functions, of memory, of Python's functions.

Machine code that is kept on disk must not hold addresses, which differ in every process: it holds
names, which are looked up when the code is loaded.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from typing import Any

import llvmlite.binding as llvm

from mjgranular.kernel.foreign import Intrinsic


def publish(name: str, address: int) -> None:
    """Makes an address known to compiled code under a name."""
    llvm.add_symbol(name, address)


def publish_functions(lib: ctypes.CDLL, names: Iterable[str]) -> None:
    """Makes functions of a library known to compiled code under their own names."""
    for name in names:
        publish(name, ctypes.cast(getattr(lib, name), ctypes.c_void_p).value or 0)


def symbol(name: str) -> Any:
    """A compiled function `address()` of what is published under that name."""

    def look_up(typingctx: Any) -> Any:
        from llvmlite import ir
        from numba import types

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            found = builder.module.globals.get(name)
            if found is None:
                found = ir.GlobalVariable(builder.module, ir.IntType(8), name)
                found.linkage = "external"
            return builder.ptrtoint(found, ir.IntType(64))

        return types.int64(), codegen

    return Intrinsic(look_up)


def _call_program(typingctx: Any, function: Any, table: Any, lead: Any) -> Any:
    """Calls the program at an address, which takes a table's address and a time [s]."""
    from llvmlite import ir
    from numba import types

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        long, double = ir.IntType(64), ir.DoubleType()
        program = ir.FunctionType(long, (long, double)).as_pointer()
        return builder.call(builder.inttoptr(args[0], program), args[1:])

    return types.int64(types.int64, types.int64, types.float64), codegen


def _add_atomically(typingctx: Any, address: Any, change: Any) -> Any:
    """Adds to the int64 at an address, one thread at a time; gives what was there before."""
    from llvmlite import ir
    from numba import types

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = builder.inttoptr(args[0], ir.IntType(64).as_pointer())
        return builder.atomic_rmw("add", pointer, args[1], "seq_cst")

    return types.int64(types.int64, types.int64), codegen


call_program: Any = Intrinsic(_call_program)
add_atomically: Any = Intrinsic(_add_atomically)
