"""Registries of what has a name; a name and its options, as in a shell: `bed geom='my tray'`.

MJCF, the command line and Python have laws, surfaces and schemes in this form; none is evaluated.
"""

import shlex
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from typing import Any, TypeVar, get_type_hints

from mjgranular.errors import InputError, UnknownNameError, listed, shown, similar_names

T = TypeVar("T")

LARGEST = 100_000
"""Largest integer; chosen: more pieces than any body needs, and few enough for memory."""


class Registry(Mapping[str, T]):
    """A mapping from names to things whose `KeyError` lists the names that exist."""

    def __init__(self, kind: str, hint: str = "") -> None:
        self._kind = kind
        self._hint = hint  # how to add one, for names that resemble none
        self._things: dict[str, T] = {}

    def add(self, name: str, thing: T, *, replace: bool = False) -> None:
        """Register `thing` as `name`; a class that is defined again replaces the old one."""
        before = self._things.get(name, thing)
        if not replace and before is not thing and _origin(before) != _origin(thing):
            raise InputError(
                f"the {self._kind} {name!r} exists already; choose another name or replace=True"
            )
        self._things[name] = thing

    def __getitem__(self, name: str) -> T:
        try:
            return self._things[name]
        except (KeyError, TypeError):
            known = sorted(self._things)
            hint = "" if similar_names(name, known) else self._hint
            raise UnknownNameError(self._kind, name, known, hint) from None

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._things))

    def __len__(self) -> int:
        return len(self._things)


def _origin(thing: object) -> tuple[object, ...]:
    """Return where a class was defined; of anything else, which of all things it is."""
    return (thing.__module__, thing.__qualname__) if isinstance(thing, type) else (id(thing),)


def read_part(text: str, register: Registry[type[T]], kind: str) -> tuple[type[T], dict[str, Any]]:
    """Parse `name option=value ...`: return the class of that name, and the options by name.

    The classes are dataclasses of their options; `kind` says what they are, in one word.
    """
    words = split_words(text)
    if not words:
        raise InputError(f"a {kind} is needed; there are: {', '.join(register)}")
    cls = register[words[0]]
    return cls, read_options(words[1:], cls, f"{kind} {words[0]!r}")


def split_words(text: str) -> list[str]:
    """Split a string into words as a shell does, where quotes keep words together."""
    try:
        return shlex.split(text)
    except ValueError as error:
        raise InputError(
            f"{shown(text)} cannot be split into words: {str(error).lower()}"
        ) from None


def parse_number(text: str) -> float | None:
    """Return a number, or None for other text."""
    try:
        return float(text)
    except ValueError:
        return None


def read_value(text: str, kind: Any, name: str) -> Any:
    """Parse a value of type bool, int, float, str or `float | None`."""
    if kind is bool:
        if text not in ("true", "false"):
            raise InputError(f"{name} must be true or false, not {shown(text)}")
        return text == "true"
    if kind in (int, float, float | None):
        try:
            value = int(text) if kind is int else float(text)
        except ValueError:
            word = "an integer" if kind is int else "a number"
            raise InputError(f"{name} must be {word}, not {shown(text)}") from None
        if kind is int and abs(value) > LARGEST:
            raise InputError(f"{name} must be at most {LARGEST} in size, not {shown(value)}")
        return value
    if kind is str:
        return text
    raise InputError(f"{name} cannot be given in words: it is not a number, switch or name")


def read_options(words: Iterable[str], cls: Any, what: str) -> dict[str, Any]:
    """Parse `name=value` words as fields of a dataclass."""
    hints = get_type_hints(cls)
    kinds = {field.name: hints[field.name] for field in fields(cls)}
    options = {}
    for word in words:
        name, equals, text = word.partition("=")
        if name not in kinds:
            raise InputError(f"the {what} has no option {shown(name)}; it has: {listed(kinds)}")
        if not equals:
            raise InputError(f"the option {name!r} of the {what} needs a value: {name}=...")
        if name in options:
            raise InputError(f"the option {name!r} of the {what} is given twice")
        options[name] = read_value(text, kinds[name], name)
    return options


T = TypeVar("T")
