"""Compiles kernels with numba and keeps the machine code on disk."""

from __future__ import annotations

import hashlib
import logging
import pickle
import sys
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from types import FunctionType
from typing import Any

import mujoco
import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache

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


def _identity(value: Any) -> tuple[object, ...]:
    """Names a kernel, or a constant in one, in a way that is the same in every process."""
    # A kernel, one of numba's intrinsics, or a function that an intrinsic is made with.
    function = getattr(value, "py_func", None) or getattr(value, "_defn", value)
    if isinstance(function, FunctionType):
        path = Path(function.__code__.co_filename)
        name = (function.__module__, function.__qualname__)
        return (*name, _stamp([path]) if path.is_file() else None, *_parts(function))
    return (repr(value),)


def _parts(function: Any) -> tuple[object, ...]:
    """What a kernel made by a factory was made of: the identities of its closure."""
    return tuple(_identity(cell.cell_contents) for cell in function.__closure__ or ())


def _digest(value: object) -> str:
    """A short name for a value, the same in every process."""
    return hashlib.sha256(repr(value).encode()).hexdigest()[:16]


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


def compiled(function: Callable[..., Any], *, inline: bool = False) -> Any:
    """Compiles `function` in nopython mode on first call; later processes load it from disk.

    The machine code lies in `__pycache__` beside the source or, where that cannot be written, in
    numba's folder for the user (`NUMBA_CACHE_DIR` overrides both). Where neither can be written
    the kernel is compiled once a process.

    Args:
        function: scalar arithmetic and loops over arrays, without Python objects. It may be made
            by a factory, with other kernels in its closure.
        inline: put its code where it is called. For small functions in loops over elements, and for
            those that hand on many numbers; more of it costs compile time.

    Returns:
        numba's dispatcher, called like `function`.
    """
    parts = _parts(function)
    if parts:
        # numba names machine code by this and by a counter that begins anew in every process: code
        # of two kernels from one factory, loaded from the cache, would be taken for the same.
        function.__qualname__ = f"{function.__qualname__}_{_digest(parts)}"
    # IEEE arithmetic (no fastmath): both doors and all platforms are to give the same numbers.
    dispatcher: Any = numba.njit(error_model="numpy", forceinline=inline)(function)
    try:
        dispatcher._cache = _PackageCache(function)
    except RuntimeError:  # numba: "no locator available"
        dispatcher._cache = _NoCache(function)
    return dispatcher


def entry(dispatcher: Any, *types: Any) -> Callable[..., Any]:
    """The compiled function for exactly these argument types, compiled now if it was not yet.

    Calling it skips numba's choice among signatures, half of what a call from Python costs.
    """
    dispatcher.compile(types)
    return dispatcher.get_overload(types)
