"""Registry of media, and media from files."""

import re
from dataclasses import replace
from pathlib import Path

from mjgranular._util.checks import kind_of
from mjgranular._util.parse import parse_number
from mjgranular._util.registry import Registry
from mjgranular.errors import InputError, UnknownNameError, shown
from mjgranular.medium.file import read_medium
from mjgranular.medium.medium import Medium, Quantity

media: Registry[Medium] = Registry("medium")
"""Media by their names."""

_WORDS = re.compile(r"(.*?\S)((?:\s+\w+=\S*)+)\s*")


def register_medium(medium: Medium, *, replace: bool = False) -> Medium:
    """Register a medium by its name, for use wherever a medium's name is accepted.

    Raises:
        InputError: another medium has that name and `replace` is false, or it is not a medium.
    """
    if not isinstance(medium, Medium):
        raise InputError(
            f"register_medium takes a Medium, not {kind_of(medium)}; read_medium reads a YAML file"
        )
    media.add(medium.name, medium, replace=replace)
    return medium


def get_medium(medium: str | Path | Medium) -> Medium:
    """Return the medium of a name, or `medium` itself if it is one.

    A path, or a name that ends in .yaml or .yml, is that of a file (`medium.file`). `density=1500`
    after a name changes the bulk density [kg/m^3].

    Raises:
        UnknownNameError: no such name; lists those that exist.
        InputError: the file does not describe a medium.
    """
    if isinstance(medium, Medium):
        return medium
    if isinstance(medium, str) and medium in media:
        return media[medium]
    if isinstance(medium, str) and (words := _WORDS.fullmatch(medium)):
        return _with_options(get_medium(words[1]), words[2].split(), medium)
    if isinstance(medium, dict):
        raise InputError("a medium is a Medium, its name, or a YAML file, not a dict")
    if isinstance(medium, Path) or str(medium).endswith((".yaml", ".yml")):
        return read_medium(Path(medium))
    if isinstance(medium, str) and Path(medium).suffix:
        raise UnknownNameError("medium", medium, media, "a medium's file ends in .yaml or .yml")
    return media[medium]


def _with_options(medium: Medium, options: list[str], name: str) -> Medium:
    """Return a medium of another density, the only option: constants are options of laws."""
    given = dict(option.split("=", 1) for option in options)
    others = given.keys() - {"density"}
    if others or len(given) < len(options):
        raise InputError(
            f"{shown(name)}: behind a medium's name stands density=KG/M^3 and nothing else; "
            'constants of a law stand behind the law\'s name, as in "rft3d scale=1.3"'
        )
    density = parse_number(given["density"])
    if density is None:
        raise InputError(f"density must be a number, not {shown(given['density'])}")
    return replace(medium, name=name, density=Quantity(density, "kg/m^3", "given by the user"))
