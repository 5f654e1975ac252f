"""Machine code in addition to numba's: C functions that kernels call, and LLVM functions.

Cached code must not contain addresses, which differ in every process. It contains names, which LLVM
resolves when the code is loaded. Only this module uses llvmlite directly.
"""

import ctypes
from collections.abc import Iterable
from functools import cache
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import extending, types

# numba annotates these as the Python functions that they are written as.
intrinsic: Any = extending.intrinsic
overload: Any = extending.overload


def publish(name: str, address: int) -> None:
    """Register an address under a name for compiled code."""
    llvm.add_symbol(name, address)


def publish_functions(library: ctypes.CDLL, names: Iterable[str]) -> None:
    """Register functions of a library under their own names for compiled code."""
    for name in names:
        publish(name, ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0)


def c_function(name: str, result: str, *arguments: str) -> Any:
    """Declare a registered C function for kernels, with numba's names of its types.

    A pointer is an `int64`; the result of a function without one is `void`.
    """
    returned, *taken = (getattr(types, name) for name in (result, *arguments))
    return types.ExternalFunction(name, returned(*taken))


def address_of(name: str) -> Any:
    """Make a kernel `address()` that returns what is registered under that name."""

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
    """Call the program at an address, with a table's address and a time [s]."""
    return types.int64(types.int64, types.int64, types.float64), _call_at


@intrinsic
def call_forces(
    typingctx: Any,
    function: Any,
    table: Any,
    work: Any,
    task: Any,
    eps: Any,
    update: Any,
    loose: Any,
) -> Any:
    """Call a program with the signature `scheme.scheme.FORCES` at an address."""
    long, double = types.int64, types.float64
    return double(long, long, long, long, double, long, double), _call_at


def _call_at(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    """Emit a call of the function at the address that is the first argument."""
    result, *kinds = map(context.get_value_type, (signature.return_type, *signature.args[1:]))
    function = ir.FunctionType(result, kinds).as_pointer()
    return builder.call(builder.inttoptr(args[0], function), args[1:])


def load_functions(code: str, names: Iterable[str]) -> dict[str, int]:
    """Compile functions in LLVM IR that live as long as the process; return their addresses."""
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
    """Return system, name and features of the processor that code is compiled for."""
    try:
        features = llvm.get_host_cpu_features().flatten()
    except RuntimeError:  # unknown for this kind of processor
        features = ""
    return llvm.get_process_triple(), llvm.get_host_cpu_name(), features
