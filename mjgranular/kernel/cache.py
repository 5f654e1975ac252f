"""Compiled programs on disk: numba's own cache, one folder for each program of each build.

numba serves a cached function as long as the file that defines it is as it was, whatever becomes of
the files of the functions that it calls; it takes any file that lies in its folder; and it cannot
tell apart what one factory has made of different parts. So a program's folder is named by all that
went into it (`identity`); it is filled elsewhere and then renamed, so that it is there as a whole
or not at all, also where two processes compile at once; and it is handed to numba only if each file
is as it was written, by this user or the administrator (`folder`).
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
    """Has numba load a program.

    Args:
        build: of the sources (`identity.build`).
        name: of the program.
        make: decorates it, with `cache=True`.

    Returns:
        What `make` gives, None where no whole program of that name is kept.
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
    """Has numba compile a program, and keeps it.

    Args:
        build: of the sources.
        name: of the program.
        make: decorates it, with `cache=True`.

    Returns:
        What `make` gives, None where nothing can be kept.
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
    """Tells whether there is a folder to write to."""
    return any(True for _ in folders_to_write())


@contextmanager
def _caching(folder: Path) -> Iterator[None]:
    """Has numba read and write its cache there; it looks when a function is decorated."""
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
    except OSError:  # there is one, of a process that was quicker, or damaged
        shutil.rmtree(folder, ignore_errors=True)
        staging.rename(folder)


def _sums(folder: Path) -> bytes:
    """Lists all files of a program with their checksums; one that is not trusted has none."""
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
