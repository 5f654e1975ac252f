"""Digests of kernels that are the same in every process, and change with the kernel."""

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

import mujoco

from mjgranular.kernel.machine import processor

_PACKAGE = Path(__file__).resolve().parents[1]

_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")  # in the repr of objects that have no name

# Environment variables of numba that change what it compiles.
_SETTINGS = (
    "BOUNDSCHECK", "CPU_NAME", "CPU_FEATURES", "ENABLE_AVX", "OPT", "LOOP_VECTORIZE",
    "SLP_VECTORIZE",
)  # fmt: skip

# Modules that contain kernels, or that kernels read while they are compiled.
_OF_KERNELS = (
    "engine", "kernel", "law", "relief", "render", "sand", "scheme", "shape", "surface",
)  # fmt: skip


def digest(value: object) -> str:
    """Return a short name for a value, the same in every process."""
    return hashlib.sha256(repr(value).encode()).hexdigest()[:16]


def _of_files(paths: Iterable[Path]) -> str:
    found = hashlib.sha256()
    for path in paths:
        found.update(path.read_bytes())
    return found.hexdigest()


# Of the imported sources: files may be edited before the first program is compiled.
_SOURCES = _of_files(
    path for name in _OF_KERNELS for path in sorted(_PACKAGE.joinpath(name).glob("*.py"))
)


@cache
def build() -> str:
    """Return a digest of the sources, and of all else that compiled code depends on."""
    return digest((
        _SOURCES,
        processor(),
        *(os.environ.get(f"NUMBA_{name}") for name in _SETTINGS),
        version("numba"),
        version("llvmlite"),
        mujoco.__version__,
        sys.implementation.cache_tag,
    ))  # fmt: skip


def identity(value: Any) -> tuple[object, ...]:
    """Return a name of a kernel, or of a constant in one, that is the same in every process.

    Raises:
        TypeError: it has no such name.
    """
    kernel = getattr(value, "py_func", None)
    function = kernel or getattr(value, "__wrapped__", value)
    if isinstance(function, FunctionType):  # a kernel, an intrinsic, or part of one
        name = (function.__module__, function.__qualname__)
        path = Path(function.__code__.co_filename)
        content = () if path.is_relative_to(_PACKAGE) else _content(function, path)  # or in `build`
        # A kernel's name contains what it is made of (`compiled`).
        return (*name, *content, *(() if kernel else closure_of(function)))
    name = repr(value)
    if _ADDRESS.search(name):
        raise TypeError(f"a kernel's closure holds what every process names anew: {name}")
    return (name,)


def _content(function: FunctionType, path: Path) -> tuple[str, str]:
    """Return digests of a function outside this package: of its code and names, and of its file.

    The code, since a notebook has no file, and since a file may have been edited after import; the
    file, since code may name more than numbers and kernels.
    """
    code = function.__code__
    consts = [const for const in code.co_consts if not isinstance(const, CodeType)]
    named = (function.__globals__.get(name) for name in code.co_names)
    known = [
        identity(value)
        for value in named
        if isinstance(value, (bool, int, float, str)) or hasattr(value, "py_func")
    ]
    file = _of_files([path]) if path.is_file() else ""
    return digest((code.co_code, consts, code.co_names, known)), file


def closure_of(function: Any) -> tuple[object, ...]:
    """Return the identities of the closure of a function made by a factory."""
    return tuple(identity(cell.cell_contents) for cell in function.__closure__ or ())
