"""Machine code beside numba's: C functions that kernels call, and functions written for LLVM.

Compiled code that is kept on disk must not hold addresses, which differ in every process: it holds
names, which LLVM looks up when the code is loaded. This is the one module that uses llvmlite by
itself.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from functools import cache
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import extending, types

# numba's types for these are those of Python functions that would be called as they are written.
intrinsic: Any = extending.intrinsic
overload: Any = extending.overload


def publish(name: str, address: int) -> None:
    """Makes an address known to compiled code under a name."""
    llvm.add_symbol(name, address)


def publish_functions(library: ctypes.CDLL, names: Iterable[str]) -> None:
    """Makes functions of a library known to compiled code under their own names."""
    for name in names:
        publish(name, ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0)


def c_function(name: str, result: str, *arguments: str) -> Any:
    """Declares a published C function for kernels.

    Args:
        name: that it is published under.
        result: numba's name of the type of its result, `void` for none.
        arguments: the same of its arguments; a pointer is an `int64`.
    """
    returned, *taken = (getattr(types, name) for name in (result, *arguments))
    return types.ExternalFunction(name, returned(*taken))


def address_of(name: str) -> Any:
    """Makes a kernel `address()` of what is published under that name."""

    @intrinsic
    def address(typingctx: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            found = builder.module.globals.get(name)
            if found is None:
                found = ir.GlobalVariable(builder.module, ir.IntType(8), name)
                found.linkage = "external"
            return builder.ptrtoint(found, ir.IntType(64))

        return types.int64(), codegen

    return address


@intrinsic
def call_step(typingctx: Any, function: Any, table: Any, lead: Any) -> Any:
    """Calls the program at an address, which takes a table's address and a time [s]."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        long, double = ir.IntType(64), ir.DoubleType()
        program = ir.FunctionType(long, (long, double)).as_pointer()
        return builder.call(builder.inttoptr(args[0], program), args[1:])

    return types.int64(types.int64, types.int64, types.float64), codegen


def load_functions(code: str, names: Iterable[str]) -> dict[str, int]:
    """Compiles functions written in LLVM's language, which live as long as the process.

    Args:
        code: a module.
        names: of the functions that are asked for.

    Returns:
        Their addresses.
    """
    engine = _engine()
    engine.add_module(llvm.parse_assembly(code))
    engine.finalize_object()
    return {name: engine.get_function_address(name) for name in names}


@cache
def _engine() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(jit=True)
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)


@cache
def processor() -> tuple[str, str, str]:
    """System, name and features of the processor that code is compiled for."""
    try:
        features = llvm.get_host_cpu_features().flatten()
    except RuntimeError:  # not known for this kind of processor
        features = ""
    return llvm.get_process_triple(), llvm.get_host_cpu_name(), features
