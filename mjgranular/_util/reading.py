"""Safe reading of files from untrusted sources."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from mjgranular.errors import InputError, one_line

_PLAINLY = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)  # not defined on all systems
_LONGEST_PATH = 300  # characters of a path that a message shows; chosen


def check_regular(path: Path, what: str) -> None:
    """Check that a path is a regular file, before it is opened, by us or by others.

    A pipe would block the reader until there is a writer; a device may be endless. The reader
    reports a missing file.

    Raises:
        InputError: it is not regular; `what` names the expected content.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return
    if stat.S_ISDIR(mode):
        raise InputError(f"cannot read {what} {place(path)}: it is a folder, not a file")
    if not stat.S_ISREG(mode):
        raise _not_regular(path, what)


class NotRegularError(OSError):
    """Error for a path that is not a regular file."""


def beginning(path: Path, most: int) -> bytes:
    """Return the first bytes of a regular file, opened so that nothing blocks.

    Raises:
        NotRegularError: it is not a regular file.
        OSError: it cannot be read.
        ValueError: it is not a valid path.
    """
    descriptor = os.open(path, os.O_RDONLY | _PLAINLY)
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise NotRegularError
        return file.read(most) or b""


def read_file(path: Path, what: str, *, largest: int) -> bytes:
    """Return the content of a regular file; never block on others.

    Args:
        path: path of the file.
        what: expected content, for the message: "the medium".
        largest: largest accepted size [bytes].

    Raises:
        InputError: it cannot be read, is not a regular file, or is larger.
    """
    check_regular(path, what)  # opening alone can move a tape or acquire a terminal
    try:
        content = beginning(path, largest + 1)
    except NotRegularError:
        raise _not_regular(path, what) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "it is not a path"
        raise InputError(f"cannot read {what} {place(path)}: {reason}") from None
    if len(content) > largest:
        raise InputError(
            f"cannot read {what} {place(path)}: it is larger than {largest // 1000} kB"
        )
    return content


def place(path: Path) -> str:
    """Format a path for a message."""
    text = one_line(str(path))
    return text if len(text) <= _LONGEST_PATH else text[: _LONGEST_PATH - 3] + "..."


def _not_regular(path: Path, what: str) -> InputError:
    return InputError(f"cannot read {what} {place(path)}: it is not a regular file")
