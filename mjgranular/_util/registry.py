"""Registries that users can extend: media, laws."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeVar

from mjgranular.errors import InputError, UnknownNameError

T = TypeVar("T")


class Registry(Mapping[str, T]):
    """A mapping from names to things whose `KeyError` lists the names that exist."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._things: dict[str, T] = {}

    def add(self, name: str, thing: T, *, replace: bool = False) -> None:
        """Register `thing` as `name`."""
        if not replace and self._things.get(name, thing) is not thing:
            raise InputError(
                f"a {self._kind} named {name!r} exists already; choose another name or replace=True"
            )
        self._things[name] = thing

    def __getitem__(self, name: str) -> T:
        try:
            return self._things[name]
        except (KeyError, TypeError):
            raise UnknownNameError(self._kind, name, sorted(self._things)) from None

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._things))

    def __len__(self) -> int:
        return len(self._things)
