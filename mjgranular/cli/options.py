"""Options of commands: made from dataclasses of experiments, parsed, named in messages, shared."""

import inspect
import math
import re
import shlex
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, make_dataclass
from functools import partial, partialmethod
from pathlib import Path
from typing import Annotated, Any, Union

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from mjgranular._util.checks import check_name
from mjgranular._util.parse import parse_number
from mjgranular._util.result_folder import ResultFolder
from mjgranular._util.user_modules import import_own
from mjgranular.cli.console import out, progress_bar, show_error
from mjgranular.errors import GranularError, InputError, MissingExtraError, RenderError
from mjgranular.experiment.ground import PlainSand
from mjgranular.experiment.study import ANGLES
from mjgranular.experiment.trajectory import degrees
from mjgranular.law import Law, laws, register_law
from mjgranular.picture.video import Film, Frames, write_video
from mjgranular.shape.single import CHOOSE

_METAVARS = {str: "NAME", int: "N", float: "X", Path: "FILE"}
_EXACT = 2**53  # up to which a float holds integers exactly


def parse_command(
    commands: Mapping[str, Any], arguments: Sequence[str], *, program: str, description: str = ""
) -> Any:
    """Return the command that the arguments name, a dataclass."""
    registry = ConstructorRegistry()
    registry.primitive_rule(_number_rule)
    return tyro.extras.subcommand_cli_from_dict(
        dict(commands),
        prog=program,
        description=description,
        args=arguments,
        config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes),
        registry=registry,
    )


def parse_integer(text: str) -> int:
    """Return an integer, which may be written as 1e6."""
    try:
        return int(text)
    except ValueError:
        number = parse_number(text)
    if number is None or not number.is_integer() or abs(number) > _EXACT:
        raise ValueError(f"must be an integer, got {text!r}")
    return int(number)


def _checked_number(text: str) -> float:
    number = parse_number(text)
    if number is None:
        raise ValueError(f"must be a number without its unit, such as 0.1 or 2e-3, got {text!r}")
    return number


def _number_rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Parse options that are numbers, or numbers or None, with our messages."""
    kinds = set(typing.get_args(info.type) or (info.type,)) - {type(None)}
    parsers: dict[Any, Callable[[str], Any]] = {int: parse_integer, float: _checked_number}
    kind = kinds.pop() if len(kinds) == 1 else None
    if kind not in parsers or typing.get_origin(info.type) not in (None, Union, types.UnionType):
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=_METAVARS[kind],
        instance_from_str=lambda words: parsers[kind](words[0]),
        is_instance=lambda value: value is None or isinstance(value, (int, float)),
        str_from_instance=lambda value: [str(value)],
    )


def options_of(kind: type, *names: str, without: tuple[str, ...] = ()) -> Any:
    """Make a dataclass of options from fields, defaults and docstring of another; all or `names`.

    Its section `Attributes:` has units in brackets at the end; angles become degrees. Its method
    `experiment` makes the other dataclass, with further arguments.
    """
    hints = typing.get_type_hints(kind)
    texts, made = _documented(PlainSand) | _documented(kind), []
    for each in fields(kind):  # pyright: ignore[reportArgumentType]
        if each.name in without or (names and each.name not in names):
            continue
        text, hint = texts[each.name], hints[each.name]
        default: Any = each.default
        if each.name in ANGLES:
            text, default = text.replace("[rad]", "[degrees]"), degrees(default)
        made.append((each.name, _annotated(hint, text), field(default=default, kw_only=True)))
    methods = {"experiment": partialmethod(_record_of, kind)}
    return make_dataclass(f"{kind.__name__}Options", made, frozen=True, namespace=methods)


def _documented(kind: type) -> dict[str, str]:
    """Return the descriptions of attributes in the docstrings of a dataclass and its bases."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        section = (inspect.cleandoc(base.__doc__ or "")).partition("Attributes:\n")[2]
        for name, text in re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", section, re.MULTILINE):
            found[name] = " ".join(text.split())
    return found


def _annotated(hint: Any, text: str) -> Any:
    """Return the type of an option with its help text and metavar for tyro."""
    text = f"{text[0].upper()}{text[1:].rstrip('.')}."
    if hint is bool:
        return Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help=text)]
    kinds = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    if float in kinds and str in kinds:  # strings, which may contain a number
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


def _record_of(command: object, kind: type, **others: Any) -> Any:
    names = [each.name for each in fields(kind)]  # pyright: ignore[reportArgumentType]
    given = {name: getattr(command, name) for name in names if hasattr(command, name)}
    if "law" in given:
        given["law"] = law_named(given["law"])
    angles = {name: math.radians(given[name]) for name in given.keys() & set(ANGLES)}
    return kind(**{**given, **angles, **others})


def given_options(command: object, *names: str) -> list[str]:
    """Return which of the named options of a command differ from their defaults."""
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


def in_options(command: object, text: str) -> str:
    """Return a message with advice for Python, `geoms=['a', 'b']`, as options, `--geoms a b`."""

    def as_option(found: re.Match[str]) -> str:
        name, value = found.groups()
        if not hasattr(command, name):
            return found[0]
        names = [quoted or word for quoted, word in re.findall(r"'([^']*)'|([^\[\],\s']+)", value)]
        return f"{option(name)} {'NAME' if value == '[...]' else shlex.join(names)}"

    if not hasattr(command, "geoms"):
        text = text.replace(f"{CHOOSE}; or ", "")
    return text if "(--" in text else _ADVICE.sub(as_option, text)  # "(--": it names both


def law_named(text: str | None) -> str | None:
    """Return a registered law; import the module of a custom one, `my_laws:Drag k=2`."""
    named, _, options = (text or "").strip().partition(" ")
    module, colon, name = named.partition(":")
    if not colon:
        return text
    content = vars(import_own(module, f"the law {named}"))
    found = {
        key: one
        for key, one in content.items()
        if isinstance(one, type) and issubclass(one, Law) and one is not Law
    }
    if name not in found and name in laws:
        return f"{name} {options}".strip()
    check_name(f"law in the module {module}", name, sorted(found))
    return f"{register_law(found[name]).name} {options}".strip()


Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Where results go."""

    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the results; nothing is written without it."""
    overwrite: Flag = False
    """Replace a result that the folder contains."""
    json: Flag = False
    """Print JSON instead of a table."""

    @contextmanager
    def claimed(
        self, *names: str, command: str = "", config: dict[str, Any] | None = None
    ) -> Iterator[ResultFolder | None]:
        """Claim the folder of `--out`; yield None without one.

        A command that was interrupted may go on there, if it has the same `config`.
        """
        if self.out is None:
            yield None
            return
        folder = ResultFolder(self.out, names)
        goes_on = None if config is None else partial(folder.lacks_figures, command, config)
        with folder.claimed(overwrite=self.overwrite, goes_on=goes_on):
            yield folder

    def finish(self, problems: Sequence[GranularError] = ()) -> int:
        """Print where the result is and what could not be drawn; return the exit status."""
        if self.out is not None and not self.json:
            out.print(f"written to {self.out}")
        for problem in problems:
            show_error(f"{problem} (the numbers are in {self.out})")
        return 2 if problems else 0


@dataclass(frozen=True, kw_only=True)
class FilmOptions(OutputOptions):
    """Where results go, and whether a film is one of them."""

    video: Flag = False
    """Write a film into the folder."""
    camera: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Camera of the film: side, close or corner of the link; one of a model's, or free."""

    def check_film(self) -> None:
        """Raise if options of a film are given and no film can be written."""
        if self.video and self.out is None:
            raise InputError("--video needs a folder to write to: add --out DIR")
        if self.camera is not None and not self.video:
            raise InputError("--camera is for a film: add --video")


@contextmanager
def collected(problems: list[GranularError]) -> Iterator[None]:
    """Append the error to a list if something cannot be drawn, and continue after the block."""
    try:
        yield
    except (MissingExtraError, RenderError) as error:
        problems.append(error)


def write_film(folder: ResultFolder, name: str, film: Film, frames: Frames) -> None:
    """Write a film with a progress bar."""
    with progress_bar("filming", 1.0, remaining=True) as show:
        options: Any = {"progress": lambda done, count: show(done / count)}
        folder.write(name, lambda path: write_video(path, film, *frames, **options))
