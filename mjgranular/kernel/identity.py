"""Names for kernels that are the same in every process, and change with what they name."""

from __future__ import annotations

import hashlib
import os
import re
import sys
from collections.abc import Iterable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import llvmlite.binding as llvm
import mujoco

_PACKAGE = Path(__file__).resolve().parents[1]

_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")  # in what objects are called that have no name

# Settings of numba's that change what it compiles, as variables of the environment.
_SETTINGS = (
    "BOUNDSCHECK", "CPU_NAME", "CPU_FEATURES", "ENABLE_AVX", "OPT", "LOOP_VECTORIZE",
    "SLP_VECTORIZE",
)  # fmt: skip


def _stamp(paths: Iterable[Path]) -> tuple[int, int]:
    """Changes when any of the files does: newest time [ns], summed size [bytes]."""
    stats = [path.stat() for path in paths]
    return max(s.st_mtime_ns for s in stats), sum(s.st_size for s in stats)


# Where kernels are written, and what they read while they are compiled.
_OF_KERNELS = ("engine", "kernel", "law", "sand", "scheme", "shape", "surface")
PACKAGE_STAMP = _stamp(
    path for name in _OF_KERNELS for path in _PACKAGE.joinpath(name).glob("*.py")
)
"""Changes with any file that kernels are made of."""


def identity(value: Any) -> tuple[object, ...]:
    """Names a kernel, or a constant in one, in a way that is the same in every process."""
    kernel = getattr(value, "py_func", None)
    function = kernel or getattr(value, "_defn", None) or value
    if isinstance(function, FunctionType):  # a kernel, an intrinsic, or part of one
        path = Path(function.__code__.co_filename)
        name = (function.__module__, function.__qualname__)
        # What a kernel is made of is in its name (`compiled`).
        parts = () if kernel else parts_of(function)
        return (*name, _stamp([path]) if path.is_file() else _content(function), *parts)
    name = repr(value)
    if _ADDRESS.search(name):
        raise TypeError(f"a kernel's closure holds what every process names anew: {name}")
    return (name,)


def _content(function: FunctionType) -> str:
    """What is written in a function that no file has, as in a notebook: code, and what it names."""
    code = function.__code__
    consts = [const for const in code.co_consts if not isinstance(const, CodeType)]
    named = (function.__globals__.get(name) for name in code.co_names)
    known = [
        identity(value)
        for value in named
        if isinstance(value, (bool, int, float, str))
        or getattr(value, "py_func", function) is not function
    ]
    return digest((code.co_code, consts, code.co_names, known))


def parts_of(function: Any) -> tuple[object, ...]:
    """What a kernel made by a factory was made of: the identities of its closure."""
    return tuple(identity(cell.cell_contents) for cell in function.__closure__ or ())


def digest(value: object) -> str:
    """A short name for a value, the same in every process."""
    return hashlib.sha256(repr(value).encode()).hexdigest()[:16]


@cache
def machine() -> tuple[object, ...]:
    """What machine code depends on beside its source."""
    try:
        features = llvm.get_host_cpu_features().flatten()
    except RuntimeError:  # not known for this kind of processor
        features = ""
    return (
        llvm.get_process_triple(),
        llvm.get_host_cpu_name(),
        features,
        *(os.environ.get(f"NUMBA_{name}") for name in _SETTINGS),
        version("numba"),
        version("llvmlite"),
        mujoco.__version__,
        sys.implementation.cache_tag,
    )
