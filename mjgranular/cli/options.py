"""Options made from the records of experiments, and what commands share about options."""

from __future__ import annotations

import inspect
import math
import re
import shlex
import types
import typing
from dataclasses import dataclass, field, fields, make_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro

from mjgranular._util.user_modules import import_own
from mjgranular.errors import UnknownNameError
from mjgranular.experiment.ground import PlainSand
from mjgranular.experiment.study import ANGLES
from mjgranular.experiment.trajectory import degrees
from mjgranular.law import Law, laws, register_law
from mjgranular.shape.rods import CHOOSE

T = TypeVar("T")
_METAVARS = {str: "NAME", int: "N", float: "X", Path: "FILE"}


def options_of(kind: type, *names: str, without: tuple[str, ...] = ()) -> Any:
    """Make a dataclass of options from a record: its fields, defaults and documentation.

    Angles are in degrees. A field that the record does not document is one of `PlainSand`.

    Args:
        kind: a dataclass with a section `Attributes:`, where units stand in brackets at the end.
        *names: of the fields; none for all.
        without: names of fields that are not options.
    """
    hints = typing.get_type_hints(kind)
    texts = _documented(PlainSand) | _documented(kind)
    made = []
    for each in fields(kind):  # pyright: ignore[reportArgumentType]
        if each.name in without or (names and each.name not in names):
            continue
        text, hint = texts[each.name], hints[each.name]
        default: Any = each.default
        if each.name in ANGLES:
            text, default = text.replace("[rad]", "[degrees]"), degrees(default)
        made.append((each.name, _annotated(hint, text), field(default=default, kw_only=True)))
    return make_dataclass(f"{kind.__name__}Options", made, frozen=True)


def _documented(kind: type) -> dict[str, str]:
    """Return what the docstrings of a dataclass and its bases say of its attributes."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        section = (inspect.cleandoc(base.__doc__ or "")).partition("Attributes:\n")[2]
        for name, text in re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", section, re.MULTILINE):
            found[name] = " ".join(text.split())
    return found


def _annotated(hint: Any, text: str) -> Any:
    """Return the type of an option with what tyro shows of it."""
    text = f"{text[0].upper()}{text[1:].rstrip('.')}."
    if hint is bool:
        return Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help=text)]
    kinds = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    if float in kinds and str in kinds:  # a number or words: words, which hold numbers too
        kinds = tuple(kind for kind in kinds if kind is not float)
        hint = str | None if type(None) in kinds else str
    plain = next(kind for kind in kinds if kind is not type(None))
    if typing.get_origin(plain) is typing.Literal:
        return Annotated[hint, tyro.conf.arg(help=text)]
    unit = re.search(r"\[([^\]]+)\]\.?$|\[([^\]]+)\][;,.]", text)
    if typing.get_origin(plain) is tuple:
        metavar = f"{_METAVARS[typing.get_args(plain)[0]]} ..."
    elif unit:
        metavar = (unit[1] or unit[2]).upper().replace("DEGREES", "DEG")
    else:
        metavar = _METAVARS[plain]
    return Annotated[hint, tyro.conf.arg(metavar=metavar, help=text)]


def record_of(kind: type[T], command: object, **others: Any) -> T:
    """Make a record from the options of a command that are called as its fields are.

    Args:
        kind: a dataclass.
        command: the command.
        **others: fields that are not options, or other than these.
    """
    names = [each.name for each in fields(kind)]  # pyright: ignore[reportArgumentType]
    given = {name: getattr(command, name) for name in names if hasattr(command, name)}
    if "law" in given:
        given["law"] = law_named(given["law"])
    angles = {name: math.radians(given[name]) for name in given.keys() & set(ANGLES)}
    return kind(**{**given, **angles, **others})


def given_options(command: object, *names: str) -> list[str]:
    """Return the names of the options that were given another value than their default.

    Args:
        command: a dataclass.
        names: of the options that are meant.
    """
    return [
        each.name
        for each in fields(command)  # pyright: ignore[reportArgumentType]
        if each.name in names and getattr(command, each.name) != each.default
    ]


def option(name: str) -> str:
    """Return a field as it is typed."""
    return f"--{name.replace('_', '-')}"


_ADVICE = re.compile(
    r"(?<![\w.-])(bodies|geoms|groups|instead_of|resolution|scheme|memory)="
    r"(\[[^\]]*\]|'[^']*'|[\w.]+)"
)


_NAMES = re.compile(r"'([^']*)'|([^\[\],\s']+)")


def in_options(command: object, text: str) -> str:
    """Return a message with its advice as a user of the command types it.

    The library says `geoms=['left', 'right']`, which is `--geoms left right` here.

    Args:
        command: what was called; advice on options that it has not stays as it is.
        text: of the message.
    """

    def typed(found: re.Match[str]) -> str:
        name, value = found.groups()
        if not hasattr(command, name):
            return found[0]
        names = [quoted or plain for quoted, plain in _NAMES.findall(value)]
        words = "NAME" if value == "[...]" else shlex.join(names)
        return f"{option(name)} {words}"

    if not hasattr(command, "geoms"):
        text = text.replace(f"{CHOOSE}; or ", "")
    return (
        text if "(--" in text else _ADVICE.sub(typed, text)
    )  # where it says both there is no need


def law_named(text: str | None) -> str | None:
    """Return a law as the library knows it: of `my_laws:Drag k=2` the module is imported.

    Raises:
        UnknownNameError: no such module, or no such law in it; lists those there are.
        InputError: the module cannot be imported.
    """
    named, _, options = (text or "").strip().partition(" ")
    module, colon, name = named.partition(":")
    if not colon:
        return text
    things = vars(import_own(module, f"the law {named}"))
    found = {key: one for key, one in things.items() if isinstance(one, type)}
    found = {key: one for key, one in found.items() if issubclass(one, Law) and one is not Law}
    if name not in found and name in laws:
        return f"{name} {options}".strip()
    if name not in found:
        raise UnknownNameError(f"law in the module {module}", name, sorted(found))
    return f"{register_law(found[name]).name} {options}".strip()


@dataclass(frozen=True, kw_only=True)
class ModelOptions(options_of(PlainSand)):
    """A model, and the sand under it."""

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL.xml")]
    """The MJCF file."""
