"""Compiled programs on disk: numba's own cache, one directory per program and build.

numba serves a cached function as long as the file that defines it is unchanged, even if files of
functions that it calls have changed; it accepts any file in its directory; and it cannot
distinguish functions that one factory made from different parts. So a program's directory is named
by everything that went into it (`digest`). It is written elsewhere and then renamed, so that it
exists completely or not at all; checksums find one that was damaged later.

Cached machine code runs when it is loaded. So each user has a private directory. It is neither read
nor written if others can write to it; only that of the administrator is read too.
"""

import errno
import hashlib
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Any, TypeVar

from numba.core import config

from mjgranular.errors import warn_user
from mjgranular.kernel.threads import cancellation_point

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

HAS_LOCKS = fcntl is not None
T = TypeVar("T")

_settings: Any = config

_SUMS = "sums"
_OLD = 30 * 24 * 3600.0  # s after which programs of other builds are removed; chosen
_ROOT = 0
_PATIENCE = 300.0  # s for which to wait for another process that compiles a program; chosen

_reported: set[Path] = set()


def load(build: str, name: str, make: Callable[[], T]) -> T | None:
    """Have numba load a program by `make`, and return it; None if no complete one is cached."""
    for root in _folders_to_read():
        folder = root / build / name
        if _is_complete(folder):
            with suppress(OSError), _caching(folder):
                return make()
    return None


def save(build: str, name: str, make: Callable[[], T]) -> T | None:
    """Have numba compile and cache a program by `make`, and return it; None if it cannot cache."""
    for root in _folders_to_write():
        with suppress(OSError):  # of a full disk too: compiled, but not written
            for old in root.iterdir():
                if old.name != build and time.time() - old.lstat().st_mtime > _OLD:
                    shutil.rmtree(old, ignore_errors=True)
            folder = _folder_of(root, build)
            with tempfile.TemporaryDirectory(
                prefix=f"{name}.", dir=folder, ignore_cleanup_errors=True
            ) as temporary:
                staging = Path(temporary, name)
                staging.mkdir()
                with _caching(staging):
                    made = make()
                with suppress(OSError):
                    _publish(staging, folder / name)
                return made
    return None


def can_save() -> bool:
    """Return True if there is a writable cache directory."""
    return any(True for _ in _folders_to_write())


def has(build: str, name: str) -> bool:
    """Return True if a complete program is cached."""
    return any(_is_complete(root / build / name) for root in _folders_to_read())


@contextmanager
def alone(build: str, name: str) -> Iterator[None]:
    """Let one process at a time compile a program; others wait, to find it cached afterwards.

    Without locks of files, on Windows (`HAS_LOCKS`) and some file systems, they do not wait.
    """
    with ExitStack() as opened:
        with suppress(OSError, StopIteration):
            folder = _folder_of(next(_folders_to_write()), build)
            _wait_for(opened.enter_context((folder / f"{name}.lock").open("w")))
        yield


def _wait_for(file: IO[str]) -> None:
    """Lock a file until it is closed, or this process ends.

    Not by `flock`, which a forked process would hold too.
    """
    until = time.monotonic() + _PATIENCE
    while fcntl is not None and time.monotonic() < until:
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except OSError as error:
            if error.errno not in (errno.EACCES, errno.EAGAIN):
                raise
        cancellation_point()
        time.sleep(0.05)


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
    (staging / _SUMS).write_text(_sums(staging), encoding="utf-8")
    for path in (staging, *staging.rglob("*")):
        _restrict(path)
    try:
        staging.rename(folder)
    except OSError:
        # It exists. That of a faster process may be in use and stays; a damaged one is replaced.
        if not _is_complete(folder):
            shutil.rmtree(folder, ignore_errors=True)
            staging.rename(folder)


def _is_complete(folder: Path) -> bool:
    """Return True if each file of a program is as it was written."""
    with suppress(OSError, UnicodeDecodeError):
        return (folder / _SUMS).read_text(encoding="utf-8") == _sums(folder)
    return False


def _sums(folder: Path) -> str:
    """List all files of a program with their checksums."""
    files = [path for path in folder.rglob("*") if path.is_file() and path != folder / _SUMS]
    return "".join(
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder).as_posix()}\n"
        for path in sorted(files)
    )


def _folders() -> Iterator[Path]:
    """Yield the directories in which every user may have one, the best first."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(chosen)
        return
    yield Path(__file__).resolve().parents[1] / "__pycache__"
    with suppress(RuntimeError):  # a user without a home directory
        home = Path.home()
        caches = {"win32": "AppData/Local", "darwin": "Library/Caches"}.get(sys.platform, ".cache")
        yield Path(os.environ.get("XDG_CACHE_HOME") or home / caches) / "mjgranular"


def _folders_to_read() -> Iterator[Path]:
    """Yield the directories that this user or the administrator has written."""
    users = [None] if _user() is None else dict.fromkeys((_user(), _ROOT))
    for folder in (base / _name(user) for base in _folders() for user in users):
        with suppress(OSError):
            if _is_trusted(folder):
                yield folder


def _folders_to_write() -> Iterator[Path]:
    """Find or make directories that this user can write to."""
    for base in _folders():
        with suppress(OSError):
            base.mkdir(parents=True, exist_ok=True)
            folder = base / _name(_user())
            if not folder.exists():
                _folder_of(base, folder.name)
            if _is_trusted(folder):
                with tempfile.TemporaryFile(dir=folder):
                    pass
                yield folder


def _folder_of(parent: Path, name: str) -> Path:
    """Return a directory, made for this user if it does not exist."""
    folder = parent / name
    folder.mkdir(mode=0o700, exist_ok=True)
    _restrict(folder)
    return folder


def _name(user: int | None) -> str:
    return "mjgranular" if user is None else f"mjgranular-{user}"


def _user() -> int | None:
    """Return the id of this user; None on systems where files have no owner."""
    return os.geteuid() if hasattr(os, "geteuid") else None


def _restrict(path: Path) -> None:
    """Remove other users' access to a file or directory; they may read root's."""
    mode = 0o755 if path.is_dir() else 0o644
    path.chmod(mode if _user() == _ROOT else mode & 0o700)


def _is_trusted(folder: Path) -> bool:
    """Return True if only this user or the administrator can write to a directory; else warn."""
    user, found = _user(), folder.lstat()
    if user is None:
        return True
    if found.st_uid not in (user, _ROOT):
        why = f"belongs to another user (number {found.st_uid})"
    elif stat.S_ISLNK(found.st_mode):
        why = "is a link"
    elif found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        why = "can be written by other users"
    else:
        return stat.S_ISDIR(found.st_mode)
    if folder not in _reported:
        _reported.add(folder)
        warn_user(
            f"{folder} {why}: machine code is neither read from it nor written to it; remove it, "
            "or set NUMBA_CACHE_DIR to a folder that only you can write to"
        )
    return False
