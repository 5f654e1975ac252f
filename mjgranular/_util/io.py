"""Safe reading of files from an earlier process or an untrusted source: only as data.

A file may be missing, truncated, of the wrong kind, endless, or malicious. Each function returns
values of the documented kind, or raises an error with one sentence: `InputError` for a file of a
user, `OutputError` for one that the package wrote. Nothing in a file is executed.
"""

import errno
import json
import os
import stat
import typing
import zipfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular._util.checks import fits, is_text, kind_of
from mjgranular.errors import InputError, OutputError, cut, one_line

# Far larger than what the package writes; chosen, not measured.
_MOST_TEXT = 16 * 2**20  # bytes
_MOST_ARRAYS = 384 * 2**20  # bytes, unpacked
_LONGEST_PATH = 300  # characters of a path that a message shows; chosen
_PLAINLY = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)  # not defined on all systems


def place(path: Path) -> str:
    """Format a path for a message."""
    return cut(one_line(str(path)), _LONGEST_PATH)


def check_regular(path: Path, what: str) -> None:
    """Check that a path is a regular file, before it is opened, by us or by others.

    A pipe would block the reader until there is a writer; a device may be endless; opening alone
    can move a tape. The reader reports a missing file.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return
    if not stat.S_ISREG(mode):
        kind = "a folder, not a file" if stat.S_ISDIR(mode) else "not a regular file"
        raise InputError(f"cannot read {what} {place(path)}: it is {kind}")


def read_file(path: Path, what: str, *, largest: int) -> bytes:
    """Return the content of a user's file."""
    check_regular(path, what)
    try:
        content = _beginning(path, largest + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "it is not a path"
        raise InputError(f"cannot read {what} {place(path)}: {reason}") from None
    if len(content) > largest:
        raise InputError(
            f"cannot read {what} {place(path)}: it is larger than {largest // 1000} kB"
        )
    return content


def read_text(file: Path) -> str:
    """Return the content of a UTF-8 text file of a result."""
    try:
        content = _beginning(file, _MOST_TEXT + 1)
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"{file} cannot be read: {reason}") from None
    if len(content) > _MOST_TEXT:
        raise OutputError(f"{file} is larger than anything that belongs there")
    try:
        return content.decode()
    except UnicodeDecodeError:
        raise OutputError(f"{file} is damaged: it is not text") from None


def read_json(file: Path, *, infinite: bool = False) -> dict[str, Any]:
    """Return the object in a JSON file; with `infinite` its numbers may be infinite."""
    text = read_text(file)
    try:
        content = json.loads(text, parse_constant=partial(_constant, infinite=infinite))
        if "\\u" in text:  # lone surrogates cannot be printed
            json.dumps(content, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as error:
        reason = "" if isinstance(error, RecursionError) else f": {str(error)[:200]}"
        raise OutputError(f"{file} is damaged{reason}") from None
    return _object(content, file)


def read_arrays(
    file: Path, names: Sequence[str], *, most: int | None = _MOST_ARRAYS
) -> dict[str, np.ndarray]:
    """Read arrays of finite numbers from a `.npz` file of at most `most` bytes (None: its size)."""
    if not file.is_file():
        raise OutputError(f"{file} cannot be read: there is no such file")
    try:
        with zipfile.ZipFile(file) as archive:
            size = sum(archive.getinfo(f"{name}.npy").file_size for name in names)
        if size > (file.stat().st_size if most is None else most):
            raise OutputError(f"{file} is larger than anything that belongs there")
        with np.load(file, allow_pickle=False) as archive:
            arrays = {name: np.asarray(archive[name]) for name in names}
    except OutputError:
        raise
    except Exception as error:  # zip, zlib, headers and dtypes each fail differently
        reason = f"{error.args[0]}" if isinstance(error, KeyError) and error.args else str(error)
        raise OutputError(f"{file} is damaged: {reason[:200] or type(error).__name__}") from None
    for name, array in arrays.items():
        if array.dtype.kind not in "fiub" or not np.isfinite(array).all():
            raise OutputError(f"{file} is damaged: {name} must be finite numbers")
    return arrays


def number(content: Mapping[str, Any], name: str, where: object) -> float | None:
    """Return a finite number or None from a parsed object."""
    value = content.get(name, "")
    if not fits(value, float | None):
        raise OutputError(f"{where} is damaged: {name} must be a number, not {kind_of(value)}")
    return None if value is None else float(value)


def checked_fields(cls: type, content: object, where: object) -> dict[str, Any]:
    """Return the fields of a dataclass from a parsed object; check names and types (`fits`)."""
    fields, hints = _object(content, where), typing.get_type_hints(cls)
    for name, value in fields.items():
        if name not in hints:
            raise OutputError(f"{where} is damaged: there is no {name[:50]!r}")
        if not fits(value, hints[name]):
            raise OutputError(f"{where} is damaged: {name} cannot be {kind_of(value)}")
    return fields


def is_plain_name(name: object) -> bool:
    """Return True if a name is that of a visible file directly in the folder."""
    if not (isinstance(name, str) and is_text(name) and name == Path(name).name):
        return False
    return not name.startswith(".") and "\\" not in name


def _beginning(path: Path, most: int) -> bytes:
    """Return the first bytes of a regular file, opened so that nothing blocks."""
    descriptor = os.open(path, os.O_RDONLY | _PLAINLY)
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file")
        return file.read(most) or b""


def _object(content: object, where: object) -> dict[str, Any]:
    if not isinstance(content, dict):
        raise OutputError(f"{where} is damaged: it must be an object, not {kind_of(content)}")
    return content


def _constant(name: str, infinite: bool) -> float:
    if name == "NaN" or not infinite:
        raise ValueError(f"{name} is not a number")
    return float(name)
