"""Kernels as Python calls them, one by one, kept on disk by numba's own means."""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.registry import CPUDispatcher

from mjgranular.kernel.announcement import ALWAYS, ONCE, announcement, log
from mjgranular.kernel.folder import folders_to_write, read, write
from mjgranular.kernel.identity import PACKAGE_STAMP, digest, machine, parts_of
from mjgranular.kernel.parts import OPTIONS


class Whole(CPUDispatcher):
    """A kernel as Python sees it: compiled when it is called, for the types of its arguments."""

    def __init__(self, function: Callable[..., Any], *, inline: bool) -> None:
        options = {**OPTIONS, "forceinline": inline, "_nrt": False}
        super().__init__(function, targetoptions=options)
        try:
            self._cache: Any = _PackageCache(function)
        except RuntimeError:  # numba: "no locator available"
            self._cache = _NoCache(function)


class _NamedFiles(IndexDataCacheFile):
    """Code files named by what they hold, and written before the index that points to them.

    numba numbers them by what it found in the index: two processes that compile at once choose the
    same number for different code. And numba unpickles, which can execute anything, whatever lies
    there: here only what nobody else can have written (`folder`).
    """

    def save(self, key: Any, data: Any) -> None:
        name = f"{Path(self._index_name).stem}.{digest(key)}.nbc"
        self._save_data(name, data)
        self._save_index({**self._load_index(), key: name})

    def _load_index(self) -> Any:
        content = self._read(self._index_path)
        if content is None:
            return {}
        opened = io.BytesIO(content)
        if pickle.load(opened) != self._version:
            return {}
        stamp, overloads = pickle.load(opened)
        return overloads if stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> Any:
        content = self._read(self._data_path(name))
        return None if content is None else pickle.loads(content)

    def _read(self, path: str) -> bytes | None:
        try:
            return read(Path(path))
        except FileNotFoundError:
            return None

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[Any]:
        content = io.BytesIO()
        yield content
        write(Path(filepath), content.getvalue())


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
        self._made_of = parts_of(py_func)
        folder = next(folders_to_write(Path(py_func.__code__.co_filename)), None)
        if folder is None:
            raise RuntimeError("no folder to keep machine code in")
        self._cache_path = str(folder)
        self._cache_file = _NamedFiles(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=PACKAGE_STAMP,
        )

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, machine(), self._made_of

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            found = super().load_overload(sig, target_context)
        except (OSError, EOFError, pickle.UnpicklingError):
            found = None
        if found is None:
            log(self._function)
            announcement.tell(ONCE)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):
            super().save_overload(sig, data)


class _NoCache(NullCache):
    """Where there is no folder to write to."""

    def __init__(self, py_func: Callable[..., Any]) -> None:
        self._function = py_func

    def load_overload(self, sig: Any, target_context: Any) -> None:
        log(self._function)
        announcement.tell(ALWAYS)
