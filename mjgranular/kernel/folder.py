"""Folders for machine code, in which nobody else may write.

What is kept is executed by who loads it. So each user has a folder of his own, and reads what he
has written there himself, or the administrator, whom he trusts with Python as well. What belongs to
anybody else, or others may write to, is neither read nor written to.
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
_MOST = 1 << 28  # bytes of a file: that of a program has some hundred thousand
_READ = os.O_RDONLY | sum(
    getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY")
)

_reported: set[Path] = set()


def folders_to_read() -> Iterator[Path]:
    """Finds what this user or the administrator has kept, the best place first."""
    for base in _bases():
        for user in dict.fromkeys((_user(), None if _user() is None else _ROOT)):
            folder = base / _name(user)
            with suppress(OSError):
                if _is_trusted(folder, folder.lstat()):
                    yield folder


def folders_to_write() -> Iterator[Path]:
    """Finds or makes folders in which this user can keep something, the best place first."""
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
    """The content of a file, None if it is not one that may be trusted.

    Raises:
        OSError: it is not there, or cannot be read.
    """
    file = os.open(path, _READ)  # neither follows a link nor waits for the other end of a pipe
    with os.fdopen(file, "rb") as opened:
        found = os.fstat(file)
        if stat.S_ISREG(found.st_mode) and found.st_size <= _MOST and _is_trusted(path, found):
            return opened.read(_MOST)
    return None


def restrict(path: Path) -> None:
    """Lets nobody else write to a file or folder of this user; what is root's is for all to read.

    Raises:
        OSError: it is not ours.
    """
    for_all = _user() == _ROOT
    if path.is_dir():
        path.chmod(0o755 if for_all else 0o700)
    else:
        path.chmod(0o644 if for_all else 0o600)


def _bases() -> Iterator[Path]:
    """Folders in which every user may have one."""
    told = os.environ.get("NUMBA_CACHE_DIR")
    if told:
        yield Path(told)
        return
    yield Path(__file__).resolve().parents[1] / "__pycache__"
    with suppress(RuntimeError):  # who has no home
        home = Path.home()
        caches = {"win32": "AppData/Local", "darwin": "Library/Caches"}.get(sys.platform, ".cache")
        yield Path(os.environ.get("XDG_CACHE_HOME") or home / caches) / "mjgranular"


def _name(user: int | None) -> str:
    return "mjgranular" if user is None else f"mjgranular-{user}"


def _user() -> int | None:
    """The number of this user, None where files do not say whose they are."""
    return os.geteuid() if hasattr(os, "geteuid") else None


def _is_trusted(path: Path, found: os.stat_result) -> bool:
    """Tells whether only this user or the administrator can have written it; warns if not."""
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
