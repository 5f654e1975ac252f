"""What becomes of an index out of bounds in compiled code.

Kernels are compiled without checks. With `NUMBA_BOUNDSCHECK=1` in the environment numba checks
each index against the length of its array, and functions hand the error on to what called them.
Above a program there may be nobody to hand it to: within `mj_step` it is the engine that calls. So
the process ends there, where nothing can catch it.
"""

from __future__ import annotations

import ctypes
import faulthandler
import os
from functools import cache
from typing import Any

import llvmlite.binding as llvm

FAULT = "mjgranular_fault"
"""Name by which programs with checks find `index_out_of_bounds_in_compiled_code`."""


def index_out_of_bounds_in_compiled_code(program: bytes) -> None:
    """Ends the process.

    Args:
        program: where it was.
    """
    os.write(2, b"\nmjgranular: an index is out of bounds in the program " + program + b"\n")
    faulthandler.dump_traceback(2)
    os.abort()


@cache
def publish() -> Any:
    """Makes it known to compiled code."""
    function = ctypes.CFUNCTYPE(None, ctypes.c_char_p)(index_out_of_bounds_in_compiled_code)
    llvm.add_symbol(FAULT, ctypes.cast(function, ctypes.c_void_p).value)
    return function  # lives on in the cache of this function
