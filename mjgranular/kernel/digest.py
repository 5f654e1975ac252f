"""Digests of kernels that are the same in every process, and change with the kernel."""

import hashlib
import os
import re
import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import mujoco
import numpy as np

from mjgranular.kernel.intrinsics import processor

_PACKAGE = Path(__file__).resolve().parents[1]

_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")  # in the repr of objects that have no name

_CONSTANTS = (bool, int, float, complex, str, np.generic, np.ndarray)  # in machine code

# Environment variables of numba that change what it compiles.
_SETTINGS = (
    "BOUNDSCHECK", "CPU_NAME", "CPU_FEATURES", "ENABLE_AVX", "OPT", "LOOP_VECTORIZE",
    "SLP_VECTORIZE",
)  # fmt: skip

# Folders of modules that contain kernels, or that kernels read while they are compiled: programs
# are compiled again after a change in one of these.
FOLDERS = (
    "engine", "experiment", "kernel", "law", "relief", "render", "sand", "scheme", "shape",
    "surface",
)  # fmt: skip


def digest(value: object) -> str:
    """Return a short name for a value, the same in every process."""
    return hashlib.sha256(repr(value).encode()).hexdigest()[:16]


def digest_of_sources(package: Path = _PACKAGE) -> str:
    """Return a digest of the sources of all kernels of this package."""
    found = hashlib.sha256()
    for folder in FOLDERS:
        for path in sorted(package.joinpath(folder).glob("*.py")):
            found.update(path.read_bytes())
    return found.hexdigest()


# Of the imported sources: files may be edited before the first program is compiled.
_SOURCES = digest_of_sources()


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


def stable_name(value: Any) -> tuple[object, ...]:
    """Return a name of a kernel, or of a constant in one, that is the same in every process."""
    kernel = getattr(value, "py_func", None)
    function = kernel or getattr(value, "__wrapped__", value)
    if isinstance(function, FunctionType):  # a kernel, an intrinsic, or part of one
        name = (function.__module__, function.__qualname__)
        path = Path(function.__code__.co_filename)
        content = () if path.is_relative_to(_PACKAGE) else _content(function, path)  # or in `build`
        # A kernel's name contains what it is made of (`compiled`).
        return (*name, *content, *(() if kernel else names_in_closure(function)))
    if isinstance(value, np.ndarray):  # its repr is rounded
        return (str(value.dtype), value.shape, value.tobytes())
    if isinstance(value, tuple):
        return (type(value).__qualname__, *map(stable_name, value))
    name = repr(value)
    if _ADDRESS.search(name):
        raise TypeError(
            f"a kernel's closure contains {name}, which has another name in every process"
        )
    return (name,)


def names_in_closure(function: Any) -> tuple[object, ...]:
    """Return the names of the values in the closure of a function made by a factory."""
    return tuple(stable_name(cell.cell_contents) for cell in function.__closure__ or ())


def _content(function: FunctionType, path: Path) -> tuple[str, str]:
    """Return digests of a function outside this package: of its code and names, and of its file.

    The code, since a notebook has no file, and since a file may have been edited after import; the
    file, since code may name more than numbers and kernels.
    """
    code = function.__code__
    consts = [const for const in code.co_consts if not isinstance(const, CodeType)]
    named = [function.__globals__.get(name) for name in code.co_names]
    for module in [value for value in named if isinstance(value, ModuleType)]:
        named += [getattr(module, name, None) for name in code.co_names]
    known = [stable_name(value) for value in named if _is_compiled_in(value)]
    file = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
    return digest((code.co_code, consts, code.co_names, known)), file


def _is_compiled_in(value: Any) -> bool:
    """Return True if the value of a name becomes part of machine code."""
    if isinstance(value, tuple):
        return all(map(_is_compiled_in, value))
    return isinstance(value, _CONSTANTS) or hasattr(value, "py_func")
