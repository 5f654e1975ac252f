"""A sand as it is written between `<instance>` and `</instance>`.

Each `<config>` has a key that is a field of `SandSpec`, or of `Config`. Law, surface and scheme are
a name and its options, as in a shell: `link eta_d=7`, `bed geom='my tray'`. Numbers are written so
that they are read as the same numbers.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from mjgranular.errors import GranularError, InputError, UnknownNameError, shown
from mjgranular.law import Law, laws
from mjgranular.medium import Medium, get_medium, media
from mjgranular.registry import Registry
from mjgranular.relief.memory import Memory, as_memory
from mjgranular.sand.material import law_of, medium_for
from mjgranular.sand.spec import SAND_FIELDS, SandSpec
from mjgranular.scheme import schemes
from mjgranular.scheme.scheme import SchemeChoice
from mjgranular.shape.select import names_in
from mjgranular.surface import Bed, HeightField, Plane, Surface
from mjgranular.surface.choice import surface_of

KEYS = (*SAND_FIELDS, "draw", "tunable")
"""Keys of `mjgranular.sand`, in the order in which they are written."""

STATE_KEYS = ("memory", "tunable")
"""Keys that say how many numbers an instance has in MuJoCo's state."""

_CHOICES = ("bodies", "geoms", "groups")  # of what meets the sand

LONGEST = 100_000
"""Characters of a text that is read; chosen: the names of some thousand bodies."""

LARGEST = 100_000
"""Of whole numbers; chosen: more pieces than any body needs, and fewer than memory cannot hold."""

DRAWINGS = ("forces", "depth")
"""Drawings of the plugin: arrows of force, discs coloured by depth."""

surfaces: Registry[type[Surface]] = Registry("surface")
surfaces.add("plane", Plane)
surfaces.add("bed", Bed)
surfaces.add("height_field", HeightField)


@dataclass(frozen=True)
class Config:
    """Configuration of an instance, read.

    Attributes:
        sand: the sand.
        draw: names out of `DRAWINGS`.
        tunable: whether the sand has state of its own (`engine.tuning`).
    """

    sand: SandSpec
    draw: tuple[str, ...] = ()
    tunable: bool = False


def read_config(texts: Mapping[str, str]) -> Config:
    """Reads the texts of an instance by their keys; an empty text is one that was not given.

    Raises:
        InputError: a text cannot be read; names the key and what would be valid.
    """
    given = {key: text for key, text in texts.items() if text}
    for key, text in given.items():
        if len(text) > LONGEST:
            raise InputError(
                f"config {key!r}: a text of {len(text)} characters; at most {LONGEST} are read"
            )
    readers = {
        "medium": get_medium,
        "surface": _read_surface,
        "scheme": _read_scheme,
        "bodies": _words,
        "geoms": _words,
        "groups": lambda text: [_value(word, int, "a group") for word in _words(text)],
        "resolution": _read_resolution,
        "instead_of": _words,
        "memory": _read_memory,
        "draw": _read_draw,
        "tunable": lambda text: _value(text, bool, "tunable"),
    }
    read: dict[str, Any] = {}
    for key, reader in readers.items():
        if key in given:
            with named(key):
                read[key] = reader(given[key])
    if "law" in given:
        with named("law"):
            read["law"] = _read_law(given["law"], read.get("medium"))
    draw, tunable = read.pop("draw", ()), read.pop("tunable", False)
    if tunable and "memory" in read:
        raise InputError(
            "sand with memory cannot be tunable, as heights lie over a surface that stays where it "
            "is: leave one of the two out"
        )
    return Config(SandSpec(**read), draw, tunable)


def write_config(
    sand: SandSpec, *, draw: Sequence[str] | str = (), tunable: bool = False
) -> dict[str, str]:
    """The texts, by their keys, that `read_config` reads as this sand.

    Args:
        sand: the sand.
        draw: as in `Config`.
        tunable: as in `Config`.

    Raises:
        InputError: an object that has no name to be written by, or a choice of nothing.
    """
    writers = {
        "medium": _write_medium,
        "law": lambda law: _write_part(law, laws, "law", "register_law"),
        "surface": lambda surface: _write_part(surface_of(surface), surfaces, "surface", None),
        "scheme": lambda scheme: _write_part(scheme, schemes, "scheme", "schemes.add"),
        "bodies": lambda bodies: _write_words(names_in(bodies)),
        "geoms": lambda geoms: _write_words(names_in(geoms)),
        "groups": lambda groups: _write_words(np.atleast_1d(groups).tolist()),
        "resolution": str,
        "instead_of": lambda geoms: _write_words(names_in(geoms)),
        "memory": _write_memory,
        "draw": _write_words,
        "tunable": lambda _: "true",
    }
    texts = {}
    for key, value in {**vars(sand), "draw": draw, "tunable": tunable}.items():
        empty = isinstance(value, Sequence) and not value
        if empty and key in _CHOICES:
            raise InputError(f"{key}: no names are nothing that could meet the sand; None is all")
        if value is not None and value is not False and not empty:
            texts[key] = writers[key](value)
    read_config(texts)
    return texts


@contextmanager
def named(key: str) -> Iterator[None]:
    """Tells errors together with the key they belong to."""
    try:
        yield
    except GranularError as error:
        raise InputError(f"config {key!r}: {error}") from None


def _words(text: str) -> list[str]:
    try:
        return shlex.split(text)
    except ValueError as error:
        raise InputError(
            f"{shown(text)} cannot be split into words: {str(error).lower()}"
        ) from None


def _options(words: Iterable[str], cls: Any, what: str) -> dict[str, Any]:
    """Reads `name=value` words as fields of a dataclass."""
    kinds = {field.name: get_type_hints(cls)[field.name] for field in fields(cls)}
    options = {}
    for word in words:
        name, equals, text = word.partition("=")
        if name not in kinds:
            raise InputError(
                f"the {what} has no option {shown(name)}; it has: {', '.join(kinds) or 'none'}"
            )
        if not equals:
            raise InputError(f"the option {name!r} of the {what} needs a value: {name}=...")
        if name in options:
            raise InputError(f"the option {name!r} of the {what} is given twice")
        options[name] = _value(text, kinds[name], name)
    return options


def _value(text: str, kind: Any, name: str) -> Any:
    if kind is bool:
        if text not in ("true", "false"):
            raise InputError(f"{name} must be true or false, not {shown(text)}")
        return text == "true"
    if kind in (int, float, float | None):
        try:
            value = int(text) if kind is int else float(text)
        except ValueError:
            word = "a whole number" if kind is int else "a number"
            raise InputError(f"{name} must be {word}, not {shown(text)}") from None
        if kind is int and abs(value) > LARGEST:
            raise InputError(f"{name} must be at most {LARGEST} in size, not {shown(value)}")
        return value
    if kind is str:
        return text
    raise InputError(f"{name} cannot be written in MJCF: it is neither number, switch nor name")


def _part(text: str, register: Registry[Any], kind: str) -> tuple[str, Any, dict[str, Any]]:
    """Reads a name and its options: the name, its class, the options."""
    words = _words(text)
    if not words:
        raise InputError(f"a {kind} is needed; there are: {', '.join(register)}")
    cls = register[words[0]]
    return words[0], cls, _options(words[1:], cls, f"{kind} {words[0]!r}")


def _read_law(text: str, medium: Medium | None) -> Law:
    _, cls, given = _part(text, laws, "law")
    needed = {field.name for field in fields(cls) if field.default is MISSING}
    if needed <= given.keys():
        return cls(**given)
    law = law_of(cls, medium or medium_for(cls))
    return cls(**{**{field.name: getattr(law, field.name) for field in fields(cls)}, **given})


def _read_surface(text: str) -> Surface:
    name, cls, given = _part(text, surfaces, "surface")
    missing = [f.name for f in fields(cls) if f.default is MISSING and f.name not in given]
    if missing:
        raise InputError(f"the surface {name!r} needs {missing[0]}=...")
    return cls(**given)


def _read_scheme(text: str) -> SchemeChoice:
    _, cls, given = _part(text, schemes, "scheme")
    return cls(**given)


def _read_resolution(text: str) -> int:
    resolution = _value(text, int, "resolution")
    if resolution < 1:
        raise InputError(f"resolution must be at least 1, not {shown(resolution)}")
    return resolution


def _read_memory(text: str) -> Memory:
    words = _words(text)
    if len(words) == 1 and "=" not in words[0]:
        return Memory() if words[0] == "true" else Memory(cell=_value(words[0], float, "the cell"))
    return Memory(**_options(words, Memory, "memory"))


def _write_memory(memory: Memory | float | bool) -> str:
    read = as_memory(memory)
    default = Memory()
    given = [f.name for f in fields(Memory) if getattr(read, f.name) != getattr(default, f.name)]
    return " ".join(_write_field(read, name) for name in given) or "true"


def _read_draw(text: str) -> tuple[str, ...]:
    words = tuple(_words(text))
    for word in words:
        if word not in DRAWINGS:
            raise UnknownNameError("drawing", word, DRAWINGS)
    return words


def _write_medium(medium: str | Path | Medium) -> str:
    if not isinstance(medium, Medium):
        get_medium(medium)
        return str(medium)
    if media.get(medium.name) is not medium:
        raise InputError(
            f"the medium {medium.name!r} has to be known by its name to be written in MJCF: "
            "call register_medium with it before, or give the path of a YAML file"
        )
    return medium.name


def _write_words(names: Sequence[Any] | str | int) -> str:
    return shlex.join([str(names)] if isinstance(names, (str, int)) else map(str, names))


def _write_part(part: Any, register: Registry[Any], kind: str, how: str | None) -> str:
    """A name as it is; an object as its name and all of its fields."""
    if isinstance(part, str):
        return part
    for name, cls in register.items():
        if part is cls:
            return name
        if type(part) is cls:
            return " ".join([name, *(_write_field(part, field.name) for field in fields(part))])
    hint = f"make it known with {how}" if how else f"there are: {', '.join(register)}"
    raise InputError(
        f"{type(part).__name__} is not a {kind} that can be written in MJCF by name; {hint}"
    )


def _write_field(part: Any, name: str) -> str:
    value = getattr(part, name)
    if isinstance(value, bool):
        text = "true" if value else "false"
    elif isinstance(value, (int, float)):
        if not math.isfinite(value):
            raise InputError(f"{name} must be finite to be written in MJCF, not {value}")
        text = repr(value if isinstance(value, int) else float(value))
    else:
        text = shlex.quote(str(value))
    return f"{name}={text}"
