"""Media by their names, and those that are found by a path."""

from __future__ import annotations

from pathlib import Path

from mjgranular.errors import InputError, UnknownNameError
from mjgranular.given import kind_of
from mjgranular.medium.file import read_medium
from mjgranular.medium.medium import Medium
from mjgranular.registry import Registry

media: Registry[Medium] = Registry("medium")
"""Media by their names."""


def register_medium(medium: Medium, *, replace: bool = False) -> Medium:
    """Makes a medium known by its name, everywhere a name of a medium is taken.

    Raises:
        InputError: another medium has that name and `replace` is false, or it is no medium.
    """
    if not isinstance(medium, Medium):
        raise InputError(
            f"register_medium takes a Medium, not {kind_of(medium)}; read_medium makes one of a "
            "YAML file"
        )
    media.add(medium.name, medium, replace=replace)
    return medium


def get_medium(medium: str | Path | Medium) -> Medium:
    """The medium of that name, or `medium` itself if it is one.

    A path, or a name that ends in .yaml or .yml, is that of a file (`medium.file`).

    Raises:
        UnknownNameError: no such name; lists those that exist.
        InputError: a file that does not describe a medium.
    """
    if isinstance(medium, Medium):
        return medium
    if isinstance(medium, Path) or str(medium).endswith((".yaml", ".yml")):
        return read_medium(Path(medium))
    if isinstance(medium, str) and medium not in media and Path(medium).suffix:
        raise UnknownNameError("medium", medium, media, "a medium's file ends in .yaml or .yml")
    return media[medium]
