"""A sand as it is written between `<instance>` and `</instance>`.

Each `<config>` has a key that is a field of `SandSpec`, or of `Config`. Law, surface and scheme are
a name and its options, as in a shell: `link eta_d=7`, `bed geom='my tray'`. Numbers stay exact.
"""

import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular._util.checks import check_count, check_name
from mjgranular._util.parse import Registry, read_value, split_words
from mjgranular.errors import GranularError, InputError
from mjgranular.law import get_law, laws
from mjgranular.medium import Medium, get_medium, media
from mjgranular.relief.memory import Memory, as_memory
from mjgranular.sand.spec import SAND_FIELDS, SandSpec, medium_for
from mjgranular.scheme import get_scheme, schemes
from mjgranular.shape.select import names_in
from mjgranular.surface import surface_of, surfaces

KEYS = (*SAND_FIELDS, "draw", "tunable")
"""Keys of `mjgranular.sand`, in the order in which they are written."""

STATE_KEYS = ("memory", "tunable")
"""Keys that determine the size of an instance's state in MuJoCo."""

NAME, SENSOR = "mjgranular.sand", "mjgranular.sensor"
"""Names of the plugins."""

SENSOR_KEYS = ("measure", "sand")
"""Keys of `mjgranular.sensor`."""

MEASURES = {"force": 3, "moment": 3, "depth": 1, "power": 1, "speed": 1, "touch": 1}
"""Its measures, with the number of their values."""

_CHOICES = ("bodies", "geoms", "groups")  # of what meets the sand
_NAMES = ("bodies", "geoms", "instead_of")  # names of what is in the model

LONGEST = 100_000
"""Maximum length of a value in characters; chosen: the names of some thousand bodies."""

DRAWINGS = ("forces", "depth", "surface")
"""Drawings of the plugin: arrows of force, dots colored by depth, an infinite plane of sand."""


@dataclass(frozen=True)
class Config:
    """Configuration of an instance, parsed."""

    sand: SandSpec
    draw: tuple[str, ...] = ()  # names from `DRAWINGS`
    tunable: bool = False  # whether it has its own state (`engine.tuning`)


def read_config(texts: Mapping[str, str]) -> Config:
    """Parse the strings of an instance by key; an empty string counts as missing."""
    given = {key: text for key, text in texts.items() if text}
    for key, text in given.items():
        if len(text) > LONGEST:
            raise InputError(
                f"config {key!r}: a string of {len(text)} characters; at most {LONGEST} are read"
            )
    readers = {
        "medium": get_medium,
        "surface": surface_of,
        "scheme": get_scheme,
        **dict.fromkeys(_NAMES, split_words),
        "groups": lambda text: [read_value(word, int, "a group") for word in split_words(text)],
        "resolution": _read_resolution,
        "memory": as_memory,
        "draw": _read_draw,
        "tunable": lambda text: read_value(text, bool, "tunable"),
    }
    read: dict[str, Any] = {}
    for key, reader in readers.items():
        if key in given:
            with named(key):
                read[key] = reader(given[key])
    if "law" in given:
        with named("law"):
            law = given["law"]
            read["law"] = get_law(law, read.get("medium") or medium_for(law))
    draw, tunable = read.pop("draw", ()), read.pop("tunable", False)
    if tunable and "memory" in read:
        raise InputError(
            "sand with memory cannot be tunable, as heights lie over a surface that does not move: "
            "omit one of the two"
        )
    return Config(SandSpec(**read), draw, tunable)


def write_config(
    sand: SandSpec, *, draw: Sequence[str] | str = (), tunable: bool = False
) -> dict[str, str]:
    """Return the strings, by key, that `read_config` parses as this sand (`Config`)."""
    writers = {
        "medium": _write_medium,
        "law": lambda law: _write_part(law, laws, "law", "register_law"),
        "surface": lambda surface: _write_part(
            surface_of(surface), surfaces, "surface", "surfaces.add"
        ),
        "scheme": lambda scheme: _write_part(scheme, schemes, "scheme", "schemes.add"),
        **dict.fromkeys(_NAMES, lambda names: _write_words(names_in(names))),
        "groups": lambda groups: _write_words(np.atleast_1d(groups).tolist()),
        "resolution": str,
        "memory": _write_memory,
        "draw": lambda draw: _write_words(split_words(draw) if isinstance(draw, str) else draw),
        "tunable": lambda _: "true",
    }
    texts = {}
    for key, value in {**vars(sand), "draw": draw, "tunable": tunable}.items():
        empty = isinstance(value, Sequence) and not value
        if empty and key in _CHOICES:
            raise InputError(
                f"{key}: no names select nothing that could meet the sand; use None for all"
            )
        if value is not None and value is not False and not empty:
            texts[key] = writers[key](value)
    read_config(texts)
    return texts


@contextmanager
def named(key: str) -> Iterator[None]:
    """Add the key to errors raised in the context."""
    try:
        yield
    except GranularError as error:
        raise type(error)(f"config {key!r}: {error}") from None


def _read_resolution(text: str) -> int:
    resolution = read_value(text, int, "resolution")
    check_count("resolution", resolution)
    return resolution


def _write_memory(memory: Memory | float | bool) -> str:
    read, default = as_memory(memory), Memory()
    given = [f.name for f in fields(Memory) if getattr(read, f.name) != getattr(default, f.name)]
    return " ".join(_write_field(read, name) for name in given) or "true"


def _read_draw(text: str) -> tuple[str, ...]:
    words = tuple(split_words(text))
    for word in words:
        check_name("drawing", word, DRAWINGS)
    return words


def _write_medium(medium: str | Path | Medium) -> str:
    if not isinstance(medium, Medium):
        get_medium(medium)
        return str(medium)
    if media.get(medium.name) is not medium:
        raise InputError(
            f"the medium {medium.name!r} must be registered to be written in MJCF: call "
            "register_medium with it before, or give the path of a YAML file"
        )
    return medium.name


def _write_words(names: Sequence[Any] | str | int) -> str:
    return shlex.join([str(names)] if isinstance(names, (str, int)) else map(str, names))


def _write_part(part: Any, register: Registry[Any], kind: str, how: str) -> str:
    """Write a name as it is, and an object as its name and all of its fields."""
    if isinstance(part, str):
        return part
    for name, cls in register.items():
        if type(part) is cls:
            return " ".join([name, *(_write_field(part, field.name) for field in fields(part))])
    raise InputError(
        f"{type(part).__name__} is not a {kind} that can be written in MJCF by name: register it "
        f"with {how}, or use one of {', '.join(register)}"
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
