"""Checks of arguments, and of optional dependencies; errors say what is expected."""

import importlib
import math
import types
import typing
from collections.abc import Collection
from pathlib import Path
from typing import Any, Literal, Union

import mujoco
import numpy as np

from mjgranular.errors import InputError, MissingExtraError, UnknownNameError, shown

_LONGEST = 4096  # characters of a string
_MEANT = {
    mujoco.MjModel: "MjModel.from_xml_path(...), spec.compile() or data.model",
    mujoco.MjSpec: "MjSpec.from_file(...), or Sand for a compiled model",
    mujoco.MjData: "MjData(model)",
}


def check_kind(value: Any, kind: type, who: str, meant: str = "") -> None:
    """Check that a value is an instance of a class; `meant` says how to make one."""
    if not isinstance(value, kind):
        meant = meant or _MEANT.get(kind, "")
        how = f"; use {meant}" if meant else ""
        raise InputError(f"{who} takes {_one(kind.__name__)}, not {kind_of(value)}{how}")


def check_name(kind: str, name: object, known: Collection[Any]) -> None:
    """Check that a name is one of the known ones; `kind` is that of `UnknownNameError`."""
    if name not in known:
        raise UnknownNameError(kind, name, known)


def check_switch(name: str, value: Any) -> None:
    """Check that a value is True or False: any string, even "no", would count as True."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"{name} must be True or False, not {kind_of(value)}")


def check_count(name: str, value: Any, least: int = 1, most: int | None = None) -> None:
    """Check that a value is an integer of at least `least` and at most `most`."""
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool):
        raise InputError(f"{name} must be an integer, not {kind_of(value)}")
    if value < least:
        raise InputError(f"{name} must be at least {least}, not {shown(value)}")
    if most is not None and value > most:
        raise InputError(f"{name} must be at most {most}, not {shown(value)}")


def check_finite(what: str, value: Any, unit: str = "", *, positive: bool = False) -> None:
    """Check that a value is a finite number, or a positive one; messages have its unit."""
    if not is_finite(value) or (positive and value <= 0):
        rule = "positive and finite" if positive else "finite"
        raise InputError(f"{what} must be {rule}, got {shown(value)} {unit}".rstrip())


def check_records(method: str, value: Any, *fields: str) -> None:
    """Check that a method returned records, with certain fields of shape (n,), else of (1,)."""
    names = (value.dtype.names or ()) if isinstance(value, np.ndarray) else ()
    shape = np.shape(value) if names else ()
    is_right = shape == (1,) or (fields and len(shape) == 1 and shape[0] > 0)
    if not (is_right and {*fields} <= {*names}):
        rule = f"(n,) with fields {', '.join(fields)}" if fields else "(1,)"
        got = f"{shape}, fields {', '.join(names)}" if names else kind_of(value)
        raise InputError(f"{method} must return a structured array of shape {rule}, got {got}")


def is_finite(value: Any) -> bool:
    """Return True if a value is a finite number."""
    return isinstance(value, (int, float, np.number)) and math.isfinite(value)


def is_text(value: object) -> bool:
    """Return True if a string can be shown: not too long, without control codes."""
    return isinstance(value, str) and 0 < len(value) <= _LONGEST and value.isprintable()


def fits(value: object, kind: Any) -> bool:
    """Return True if a value fits a field of a type.

    Types are plain, None, or unions, tuples or literals. Numbers must be finite, strings printable.
    """
    origin, members = typing.get_origin(kind), typing.get_args(kind)
    if origin in (Union, types.UnionType):
        return any(fits(value, member) for member in members)
    if origin is Literal:
        return isinstance(value, str) and value in members
    if origin is tuple:
        if not isinstance(value, (list, tuple)):
            return False
        kinds = members[:1] * len(value) if members[-1] is Ellipsis else members
        return len(kinds) == len(value) and all(map(fits, value, kinds))
    if kind is None or kind is type(None):
        return value is None
    if isinstance(value, bool):
        return kind is bool
    if kind is float:
        return isinstance(value, (int, float)) and abs(value) < 1e300 and not math.isnan(value)
    if kind is int:
        return isinstance(value, int) and abs(value) < 2**63
    return kind in (str, Path) and is_text(value)


def kind_of(value: Any) -> str:
    """Return the kind of a value in a word or two."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if value is None or isinstance(value, (str, int, float)):
        return shown(value)
    return _one(type(value).__name__)


def _one(name: str) -> str:
    """Return a name with its article; "Mj" is pronounced letter by letter."""
    return f"{'an' if name[0] in 'AEIOU' or name.startswith('Mj') else 'a'} {name}"


def require(package: str, *, extra: str, purpose: str) -> Any:
    """Import a module of an optional dependency, or raise an error with the install line."""
    try:
        return importlib.import_module(package)
    except ModuleNotFoundError as error:
        missing = (error.name or package).partition(".")[0]
        raise MissingExtraError(missing, extra, purpose) from None
