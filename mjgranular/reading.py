"""Files that somebody else may have written, read without trust."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from mjgranular.errors import InputError, one_line

_LONGEST_PATH = 300  # characters of it that a message shows; chosen


def check_regular(path: Path, what: str) -> None:
    """Makes sure that a path leads to a regular file, before somebody else's code opens it.

    A pipe would have the reader wait for a writer, a device never end.

    Raises:
        InputError: there is no such file, or it is something else; `what` says what it was to be.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        raise _unreadable(path, what, error) from None
    if not stat.S_ISREG(mode):
        raise InputError(f"cannot read {what} {place(path)}: it is not a regular file")


def read_file(path: Path, what: str, *, largest: int) -> bytes:
    """The content of a regular file; others are not waited for.

    Args:
        path: to the file.
        what: it was to be, for the message: "the medium".
        largest: size that is read [bytes].

    Raises:
        InputError: it cannot be read, is no regular file, or is larger.
    """
    check_regular(path, what)  # opening alone can move a tape or take a terminal
    try:
        # Another may stand in its place by now: opened so that nothing blocks, and asked again.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with os.fdopen(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise InputError(f"cannot read {what} {place(path)}: it is not a regular file")
            content = file.read(largest + 1) or b""
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise _unreadable(path, what, error) from None
    if len(content) > largest:
        raise InputError(
            f"cannot read {what} {place(path)}: it is larger than {largest // 1000} kB"
        )
    return content


def place(path: Path) -> str:
    """A path as a message shows it."""
    text = one_line(str(path))
    return text if len(text) <= _LONGEST_PATH else text[: _LONGEST_PATH - 3] + "..."


def _unreadable(path: Path, what: str, error: OSError | ValueError) -> InputError:
    reason = getattr(error, "strerror", None) or "it is not a path"
    return InputError(f"cannot read {what} {place(path)}: {reason}")
