"""Safe reading of files from an earlier, perhaps untrusted, process: only as data.

A file may be missing, truncated, of the wrong kind, endless, or malicious. In every case each
function here returns values of the documented kind, or raises `OutputError` with one sentence.
Nothing in a file is executed.
"""

from __future__ import annotations

import json
import math
import types
import typing
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Union

import numpy as np

from mjgranular._util.io import NotRegularError, beginning
from mjgranular.errors import OutputError

# Far larger than what the package writes; chosen, not measured.
_MOST_TEXT = 16 * 2**20  # bytes
_MOST_ARRAYS = 384 * 2**20  # bytes, unpacked
_LONGEST = 4096  # characters of a name


def read_bytes(file: Path, *, most: int = _MOST_TEXT) -> bytes:
    """Return the content of a regular file.

    Args:
        file: the file.
        most: largest accepted size [bytes].

    Raises:
        OutputError: it does not exist, cannot be read, or is larger.
    """
    try:
        content = beginning(file, most + 1)
    except NotRegularError:
        raise OutputError(f"{file} is not a file") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        reason = error.strerror if isinstance(error, OSError) else None
        raise OutputError(f"{file} cannot be read: {reason or error}") from None
    if len(content) > most:
        raise OutputError(f"{file} is larger than anything that belongs there")
    return content


def read_text(file: Path) -> str:
    """Return the content of a UTF-8 text file.

    Raises:
        OutputError: it cannot be read, or is not UTF-8.
    """
    try:
        return read_bytes(file).decode()
    except UnicodeDecodeError:
        raise OutputError(f"{file} is damaged: it is no text") from None


def read_json(file: Path) -> dict[str, Any]:
    """Return the object in a JSON file.

    Raises:
        OutputError: it cannot be read, is not JSON, or not an object; says where.
    """
    return parse_json(read_text(file), str(file))


def parse_json(text: str, where: str) -> dict[str, Any]:
    """Parse the object in a JSON string.

    Args:
        text: the string.
        where: its source, for the message.

    Raises:
        OutputError: not JSON, or not an object.
    """
    try:
        content = json.loads(text, parse_constant=_refuse_constant)
        if "\\u" in text:  # lone surrogates cannot be printed
            json.dumps(content, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as error:
        reason = "" if isinstance(error, RecursionError) else f": {str(error)[:200]}"
        raise OutputError(f"{where} is damaged{reason}") from None
    if not isinstance(content, dict):
        raise OutputError(f"{where} is damaged: it must be an object, not {_kind(content)}")
    return content


def read_arrays(
    file: Path, names: Sequence[str], *, most: int | None = _MOST_ARRAYS
) -> dict[str, np.ndarray]:
    """Read arrays of finite numbers from an `.npz` file.

    Args:
        file: the file.
        names: names of the arrays.
        most: largest accepted size of the arrays [bytes]; None for the size of the file.

    Raises:
        OutputError: it cannot be read, or lacks one of the names; says which.
    """
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
    """Return a finite number or None from a parsed object.

    Raises:
        OutputError: it is missing, or neither of these.
    """
    value = content.get(name, "")
    if value is not None and not fits(value, float):
        raise OutputError(f"{where} is damaged: {name} must be a number, not {_kind(value)}")
    return None if value is None else float(value)


def checked_fields(cls: type, content: object, where: object) -> dict[str, Any]:
    """Return the fields of a dataclass from a parsed object; check names and types.

    Args:
        cls: the dataclass; annotated with plain types, their unions, tuples and literals.
        content: the parsed object.
        where: its source, for the message.

    Raises:
        OutputError: says which field is wrong, and what it must be.
    """
    if not isinstance(content, dict):
        raise OutputError(f"{where} is damaged: it must be an object, not {_kind(content)}")
    hints = typing.get_type_hints(cls)
    for name, value in content.items():
        if name not in hints:
            raise OutputError(f"{where} is damaged: there is no {name[:50]!r}")
        if not fits(value, hints[name]):
            raise OutputError(f"{where} is damaged: {name} cannot be {_kind(value)}")
    return content


def fits(value: object, kind: Any) -> bool:
    """Return True if a value read from a file is of a type.

    Args:
        value: value from JSON or TOML; numbers must be finite, strings printable.
        kind: a plain type, None, or a union, tuple or literal of these; no other types are
            supported.
    """
    origin = typing.get_origin(kind)
    if origin in (Union, types.UnionType):
        return any(fits(value, member) for member in typing.get_args(kind))
    if origin is Literal:
        return isinstance(value, str) and value in typing.get_args(kind)
    if origin is tuple:
        if not isinstance(value, (list, tuple)):
            return False
        kinds = typing.get_args(kind)
        kinds = kinds[:1] * len(value) if kinds[-1] is Ellipsis else kinds
        return len(kinds) == len(value) and all(map(fits, value, kinds))
    if kind is None or kind is type(None):
        return value is None
    if isinstance(value, bool):
        return kind is bool
    if kind is float:
        return isinstance(value, (int, float)) and abs(value) < 1e300 and not math.isnan(value)
    if kind is int:
        return isinstance(value, int) and abs(value) < 2**63
    if kind in (str, Path):
        return is_text(value)
    return False


def is_plain_name(name: object) -> bool:
    """Return True if a name is that of a visible file directly in the folder."""
    return (
        isinstance(name, str)
        and is_text(name)
        and name == Path(name).name
        and not name.startswith(".")
        and "\\" not in name
    )


def is_text(value: object) -> bool:
    """Return True if a string can be shown: not too long, without control codes."""
    return isinstance(value, str) and 0 < len(value) <= _LONGEST and value.isprintable()


def _kind(value: object) -> str:
    """Describe the kind of a value for a message."""
    if isinstance(value, (dict, list)):
        return "an object" if isinstance(value, dict) else "a list"
    if value is None or isinstance(value, (bool, int, float)):
        return json.dumps(value)[:40]
    return f"the text {str(value)[:40]!r}"


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no number")
