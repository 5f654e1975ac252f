"""Cache directories for machine code that no other user can write to.

Cached machine code runs when it is loaded. So each user has a private directory, and reads only
what they or the administrator have written. Files and directories of other users, or that others
can write to, are neither read nor written.
"""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from mjgranular.errors import warn_user

_ROOT = 0
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_MOST = 1 << 28  # maximum bytes of a file; that of a program has some hundred thousand
_READ = os.O_RDONLY | sum(
    getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY")
)

_reported: set[Path] = set()


def folders_to_read() -> Iterator[Path]:
    """Yield the directories that this user or the administrator has written, the best first."""
    for base in _bases():
        for user in dict.fromkeys((_user(), None if _user() is None else _ROOT)):
            folder = base / _name(user)
            with suppress(OSError):
                if _is_trusted(folder, folder.lstat()):
                    yield folder


def folders_to_write() -> Iterator[Path]:
    """Find or make directories that this user can write to, the best first."""
    for base in _bases():
        folder = base / _name(_user())
        with suppress(OSError):
            base.mkdir(parents=True, exist_ok=True)
            if not folder.exists():
                folder.mkdir(mode=0o700, exist_ok=True)
                restrict(folder)
            if _is_trusted(folder, folder.lstat()):
                with tempfile.TemporaryFile(dir=folder):
                    pass
                yield folder


def read(path: Path) -> bytes | None:
    """Return the content of a file; None if the file is not trusted.

    Raises:
        OSError: it does not exist, or cannot be read.
    """
    file = os.open(path, _READ)  # neither follows a link nor blocks on a pipe
    with os.fdopen(file, "rb") as opened:
        found = os.fstat(file)
        if stat.S_ISREG(found.st_mode) and found.st_size <= _MOST and _is_trusted(path, found):
            return opened.read(_MOST)
    return None


def restrict(path: Path) -> None:
    """Remove other users' write access to a file or directory of this user; root's stay readable.

    Raises:
        OSError: it belongs to another user.
    """
    for_all = _user() == _ROOT
    if path.is_dir():
        path.chmod(0o755 if for_all else 0o700)
    else:
        path.chmod(0o644 if for_all else 0o600)


def _bases() -> Iterator[Path]:
    """Yield directories in which every user may have a subdirectory."""
    told = os.environ.get("NUMBA_CACHE_DIR")
    if told:
        yield Path(told)
        return
    yield Path(__file__).resolve().parents[1] / "__pycache__"
    with suppress(RuntimeError):  # a user without a home directory
        home = Path.home()
        caches = {"win32": "AppData/Local", "darwin": "Library/Caches"}.get(sys.platform, ".cache")
        yield Path(os.environ.get("XDG_CACHE_HOME") or home / caches) / "mjgranular"


def _name(user: int | None) -> str:
    return "mjgranular" if user is None else f"mjgranular-{user}"


def _user() -> int | None:
    """Return the id of this user; None on systems where files have no owner."""
    return os.geteuid() if hasattr(os, "geteuid") else None


def _is_trusted(path: Path, found: os.stat_result) -> bool:
    """Return True if only this user or the administrator can have written it; warn if not."""
    user = _user()
    if user is None:
        return True
    if found.st_uid not in (user, _ROOT):
        why = f"belongs to another user (number {found.st_uid})"
    elif stat.S_ISLNK(found.st_mode):
        why = "is a link"
    elif found.st_mode & _OTHERS_WRITE:
        why = "may be written by others than its owner"
    else:
        return stat.S_ISDIR(found.st_mode) or stat.S_ISREG(found.st_mode)
    if path not in _reported:
        _reported.add(path)
        warn_user(
            f"{path} {why}: machine code is neither read from it nor kept in it; remove it, or "
            "set NUMBA_CACHE_DIR to a folder that is yours alone"
        )
    return False
