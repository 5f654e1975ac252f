"""Registries that users can extend: media, laws."""

from collections.abc import Iterator, Mapping
from typing import TypeVar

from mjgranular.errors import InputError, UnknownNameError, similar_names

T = TypeVar("T")


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
