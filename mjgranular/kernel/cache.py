"""Compiled programs on disk: numba's own cache, one directory per program and build.

numba serves a cached function as long as the file that defines it is unchanged, even if files of
functions that it calls have changed; it accepts any file in its directory; and it cannot
distinguish functions that one factory made from different parts. So a program's directory is named
by everything that went into it (`identity`). It is written elsewhere and then renamed, so that it
exists completely or not at all, even if two processes compile at once. It is passed to numba only
if each file is as it was written, by this user or the administrator (`folder`).
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from numba.core import config

from mjgranular.kernel.folder import folders_to_read, folders_to_write, read, restrict

T = TypeVar("T")

_settings: Any = config

_SUMS = "sums"
_OLD = 30 * 24 * 3600.0  # s after which programs of other builds are removed; chosen


def load(build: str, name: str, make: Callable[[], T]) -> T | None:
    """Have numba load a program.

    Args:
        build: digest of the sources (`identity.build`).
        name: name of the program.
        make: decorates it, with `cache=True`.

    Returns:
        The result of `make`; None if no complete program of that name is cached.
    """
    for root in folders_to_read():
        folder = root / build / name
        with suppress(OSError):
            sums = read(folder / _SUMS)
            if sums and sums == _sums(folder):
                with _caching(folder):
                    return make()
    return None


def save(build: str, name: str, make: Callable[[], T]) -> T | None:
    """Have numba compile a program, and cache it.

    Args:
        build: digest of the sources.
        name: name of the program.
        make: decorates it, with `cache=True`.

    Returns:
        The result of `make`; None if nothing can be cached.
    """
    for root in folders_to_write():
        try:
            _remove_old(root, build)
            (root / build).mkdir(exist_ok=True)
            restrict(root / build)
            staging = Path(tempfile.mkdtemp(prefix=f"{name}.", dir=root / build))
        except OSError:
            continue
        try:
            try:
                with _caching(staging):
                    made = make()
            except OSError:  # a full disk: compiled, but not written
                continue
            with suppress(OSError):
                _publish(staging, root / build / name)
            return made
        finally:
            shutil.rmtree(staging, ignore_errors=True)
    return None


def can_save() -> bool:
    """Return True if there is a writable cache directory."""
    return any(True for _ in folders_to_write())


@contextmanager
def _caching(folder: Path) -> Iterator[None]:
    """Have numba use this cache directory; numba reads it when a function is decorated."""
    before = _settings.CACHE_DIR
    _settings.CACHE_DIR = str(folder)
    try:
        yield
    finally:
        _settings.CACHE_DIR = before


def _publish(staging: Path, folder: Path) -> None:
    for path in staging.rglob("*"):
        restrict(path)
    (staging / _SUMS).write_bytes(_sums(staging))
    restrict(staging / _SUMS)
    restrict(staging)
    try:
        staging.rename(folder)
    except OSError:  # it exists, from a faster process, or damaged
        shutil.rmtree(folder, ignore_errors=True)
        staging.rename(folder)


def _sums(folder: Path) -> bytes:
    """List all files of a program with their checksums; an untrusted file has none."""
    lines = []
    for base, _, names in os.walk(folder):
        for name in names:
            path = Path(base, name)
            if path != folder / _SUMS:
                content = read(path)
                checksum = "-" if content is None else hashlib.sha256(content).hexdigest()
                lines.append(f"{checksum}  {path.relative_to(folder).as_posix()}\n")
    return "".join(sorted(lines)).encode()


def _remove_old(root: Path, build: str) -> None:
    for folder in root.iterdir():
        if folder.name != build and time.time() - folder.lstat().st_mtime > _OLD:
            shutil.rmtree(folder, ignore_errors=True)
