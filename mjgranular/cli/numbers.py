"""Numbers on the command line: one sentence for what is not a number; 1e6 is an integer."""

from __future__ import annotations

import types
import typing
from collections.abc import Callable
from typing import Any

from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

_EXACT = 2**53  # up to which a float holds integers exactly


def whole_number(text: str) -> int:
    """An integer, also as 1e6.

    Raises:
        ValueError: it is none.
    """
    try:
        return int(text)
    except ValueError:
        try:
            number = float(text)
        except ValueError:
            number = 0.5
        if not number.is_integer() or abs(number) > _EXACT:
            raise ValueError(f"a whole number is needed, not {text!r}") from None
        return int(number)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(
            f"a number is needed, without its unit, such as 0.1 or 2e-3, not {text!r}"
        ) from None


_READERS: dict[type, Callable[[str], Any]] = {float: _number, int: whole_number}


def number_rules() -> ConstructorRegistry:
    """Rules by which tyro reads options that are numbers, or numbers or nothing."""
    registry = ConstructorRegistry()
    registry.primitive_rule(_rule)
    return registry


def _rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    kinds = {info.type}
    if typing.get_origin(info.type) in (typing.Union, types.UnionType):
        kinds = set(typing.get_args(info.type)) - {type(None)}
    kind = kinds.pop() if len(kinds) == 1 else None
    if kind not in _READERS:
        return None
    read = _READERS[kind]
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="N" if kind is int else "X",
        instance_from_str=lambda words: read(words[0]),
        is_instance=lambda value: value is None or isinstance(value, (int, float)),
        str_from_instance=lambda value: [str(value)],
    )
