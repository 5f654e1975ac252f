"""Compiles kernels with numba and keeps the machine code on disk."""

from __future__ import annotations

import functools
import hashlib
import logging
import os
import pickle
import re
import sys
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache, cached_property
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any

import llvmlite.binding as llvm
import mujoco
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache

from mjgranular.kernel.program import Program, can_be_kept, load, save

_logger = logging.getLogger(__name__)

ONCE = "once on a machine, up to half a minute"
ALWAYS = "in every process, as no folder to keep them in can be written (see NUMBA_CACHE_DIR)"

_PACKAGE = Path(__file__).resolve().parents[1]


def _stamp(paths: Iterable[Path]) -> tuple[int, int]:
    """Changes when any of the files does: newest time [ns], summed size [bytes]."""
    stats = [path.stat() for path in paths]
    return max(s.st_mtime_ns for s in stats), sum(s.st_size for s in stats)


# Where kernels are written, and what they read while they are compiled.
_OF_KERNELS = ("engine", "kernel", "law", "sand", "scheme", "shape", "surface")
_PACKAGE_STAMP = _stamp(
    path for name in _OF_KERNELS for path in _PACKAGE.joinpath(name).glob("*.py")
)


_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")  # in what objects are called that have no name


def _identity(value: Any) -> tuple[object, ...]:
    """Names a kernel, or a constant in one, in a way that is the same in every process."""
    function = getattr(value, "py_func", None) or getattr(value, "_defn", None) or value
    if isinstance(function, FunctionType):  # a kernel, one of numba's intrinsics, or part of one
        path = Path(function.__code__.co_filename)
        name = (function.__module__, function.__qualname__)
        # What a kernel is made of is in its name.
        parts = () if isinstance(value, Kernel) else _parts(function)
        return (*name, _stamp([path]) if path.is_file() else None, *parts)
    name = repr(value)
    if _ADDRESS.search(name):
        raise TypeError(f"a kernel's closure holds what every process names anew: {name}")
    return (name,)


def _parts(function: Any) -> tuple[object, ...]:
    """What a kernel made by a factory was made of: the identities of its closure."""
    return tuple(_identity(cell.cell_contents) for cell in function.__closure__ or ())


def _digest(value: object) -> str:
    """A short name for a value, the same in every process."""
    return hashlib.sha256(repr(value).encode()).hexdigest()[:16]


@cache
def _machine() -> tuple[object, ...]:
    """What machine code depends on beside its source."""
    try:
        features = llvm.get_host_cpu_features().flatten()
    except RuntimeError:  # not known for this kind of processor
        features = ""
    told = ("CPU_NAME", "CPU_FEATURES", "ENABLE_AVX", "OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE")
    return (
        llvm.get_process_triple(),
        llvm.get_host_cpu_name(),
        features,
        *(os.environ.get(f"NUMBA_{name}") for name in told),
        version("numba"),
        version("llvmlite"),
        sys.implementation.cache_tag,
    )


class _Announcement:
    """Tells that kernels are being compiled: each in the log, the first to who waits for it.

    Who waits looks at a terminal. Where the log is read, and the command line reads it, that is
    enough.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._told = False

    def tell(self, function: Callable[..., Any], how_often: str) -> None:
        """Tells that a kernel is compiled now.

        Args:
            function: of the kernel.
            how_often: that will happen, in words.
        """
        _logger.info("compiling %s.%s", function.__module__, function.__qualname__)
        with self._lock:
            first, self._told = not self._told, True
        if first and not (_logger.isEnabledFor(logging.INFO) and _logger.hasHandlers()):
            # There is no stderr in a program without a console, and a closed one cannot be asked.
            with suppress(AttributeError, OSError, ValueError):
                if sys.stderr.isatty():
                    print(f"mjgranular: compiling kernels: {how_often}", file=sys.stderr)


_announcement = _Announcement()


class _NamedFiles(IndexDataCacheFile):
    """Code files named by what they hold, and written before the index that points to them.

    numba numbers them by what it found in the index: two processes that compile at once choose the
    same number for different code.
    """

    def save(self, key: Any, data: Any) -> None:
        name = f"{Path(self._index_name).stem}.{_digest(key)}.nbc"
        self._save_data(name, data)
        self._save_index({**self._load_index(), key: name})


class _PackageCache(FunctionCache):
    """numba's cache on disk, made safe for a package of kernels that are made of each other.

    Four things differ. numba drops a cached kernel when the file that defines it changes, but
    not when a file of a kernel that it *calls* does: after an update the old physics would go
    on running; here the stamp covers all folders with kernels. numba tells kernels from one
    factory apart by pickling their closures, which differ in every process, so that they are
    compiled anew each time; here by the names of the kernels in the closure. MuJoCo's structs and
    enumerations are constants of the code, which is compiled anew for another version of it. And a
    cache that cannot be read or written (full disk, read-only folder) costs a compilation, never an
    exception.
    """

    def __init__(self, py_func: Callable[..., Any]) -> None:
        super().__init__(py_func)
        self._function = py_func
        self._made_of = _parts(py_func)
        self._cache_file = _NamedFiles(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=_PACKAGE_STAMP,
        )

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, codegen.magic_tuple(), mujoco.__version__, self._made_of

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            found = super().load_overload(sig, target_context)
        except (OSError, EOFError, pickle.UnpicklingError):
            found = None
        if found is None:
            _announcement.tell(self._function, ONCE)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):
            super().save_overload(sig, data)


class _NoCache(NullCache):
    """Where there is no folder to write to."""

    def __init__(self, py_func: Callable[..., Any]) -> None:
        self._function = py_func

    def load_overload(self, sig: Any, target_context: Any) -> None:
        _announcement.tell(self._function, ALWAYS)


class Kernel:
    """A function that is compiled where it is used: see `compiled`.

    Called from Python it is compiled as it is, for the types of its arguments. What calls it in a
    kernel has it compiled as a part; what is compiled as a whole is a program (`program_of`).
    """

    def __init__(self, function: Callable[..., Any], *, inline: bool) -> None:
        self.py_func = function
        self._inline = inline
        functools.update_wrapper(self, function)

    @cached_property
    def part(self) -> Any:
        """As other kernels see it (`parts.Part`)."""
        from mjgranular.kernel.parts import Part

        return Part(self.py_func, inline=self._inline, tell=_log)

    @property
    def _numba_type_(self) -> Any:
        return self.part._numba_type_

    @cached_property
    def _whole(self) -> Any:
        from mjgranular.kernel.parts import Whole

        whole: Any = Whole(self.py_func, inline=self._inline)
        try:
            whole._cache = _PackageCache(self.py_func)
        except RuntimeError:  # numba: "no locator available"
            whole._cache = _NoCache(self.py_func)
        return whole

    @property
    def stats(self) -> Any:
        """What was compiled, and what loaded, of what Python called."""
        return self._whole.stats

    def __call__(self, *arguments: Any) -> Any:
        return self._whole(*arguments)


def _log(function: Callable[..., Any]) -> None:
    _logger.info("compiling %s.%s", function.__module__, function.__qualname__)


def compiled(function: Callable[..., Any], *, inline: bool = False) -> Kernel:
    """Compiles `function` in nopython mode on first call; later processes load it from disk.

    The machine code lies in `__pycache__` beside the source or, where that cannot be written, in
    numba's folder for the user (`NUMBA_CACHE_DIR` overrides both). Where neither can be written
    the kernel is compiled once a process.

    Args:
        function: scalar arithmetic and loops over arrays, without Python objects, exceptions or
            arrays of its own. It may be made by a factory, with other kernels in its closure.
        inline: put its code where it is called. For small functions in loops over elements, and for
            those that hand on many numbers; more of it costs compile time.

    Returns:
        A kernel, called like `function`.
    """
    parts = _parts(function)
    if parts:
        # numba names machine code by this and by a counter that begins anew in every process: code
        # of two kernels from one factory, loaded from the cache, would be taken for the same.
        function.__qualname__ = f"{function.__qualname__}_{_digest(parts)}"
    return Kernel(function, inline=inline)


_programs: dict[tuple[Kernel, tuple[str, ...]], Program] = {}
_compiling = threading.RLock()


def program_of(kernel: Kernel, *types: str) -> Program:
    """A kernel and all that it calls as a program, compiled now if it was not yet.

    Args:
        kernel: of numbers, which gives a number or nothing.
        types: of its arguments, by numba's names: `int64`, `int32`, `float64`.
    """
    with _compiling:
        found = _programs.get((kernel, types))
        if found is None:
            found = _programs[kernel, types] = _kept_or_made(kernel, types)
        return found


def _kept_or_made(kernel: Kernel, types: tuple[str, ...]) -> Program:
    function = kernel.py_func
    made_for = (types, _machine(), mujoco.__version__, _identity(kernel))
    name = f"{function.__module__}.{function.__qualname__}".replace("<", "").replace(">", "")
    name = f"{name.removeprefix('mjgranular.')}.{_digest(made_for)}"
    kept = load(function, name, _PACKAGE_STAMP)
    if kept is None:
        from mjgranular.kernel import parts

        keeps = can_be_kept(function)
        _announcement.tell(function, ONCE if keeps else ALWAYS)
        kept = parts.build(kernel.part, tuple(getattr(parts.types, t) for t in types), name)
        if keeps:
            save(function, name, _PACKAGE_STAMP, kept)
    return Program(name, kept)


def entry(kernel: Kernel, *types: str) -> Callable[..., Any]:
    """The compiled function for exactly these argument types, compiled now if it was not yet.

    Calling it skips numba's choice among signatures, half of what a call from Python costs.
    """
    return program_of(kernel, *types).function
