"""Options that commands share."""

from __future__ import annotations

import math
import re
import shlex
from dataclasses import dataclass, fields
from typing import Annotated, Any, TypeVar

import tyro

from mjgranular._util.user_modules import import_own
from mjgranular.errors import UnknownNameError
from mjgranular.experiment import Impact
from mjgranular.law import Law, laws, register_law
from mjgranular.shape.rods import CHOOSE

T = TypeVar("T")
_DEGREES = {"slope", "uphill", "tilt", "direction"}  # options that records have in radians


def record_of(kind: type[T], command: object, **others: Any) -> T:
    """Picks the options of a command that are called as the fields of an experiment are.

    Args:
        kind: a dataclass.
        command: the command.
        **others: fields that are no options, or other than these.
    """
    names = [field.name for field in fields(kind)]  # pyright: ignore[reportArgumentType]
    given = {name: getattr(command, name) for name in names if hasattr(command, name)}
    if "law" in given:
        given["law"] = law_named(given["law"])
    angles = {name: math.radians(given[name]) for name in _DEGREES & given.keys()}
    return kind(**{**given, **angles, **others})


def given_options(command: object, *names: str) -> list[str]:
    """Names of the options of a command that were given another value than their default.

    Args:
        command: a dataclass.
        names: of the options that are meant.
    """
    return [
        field.name
        for field in fields(command)  # pyright: ignore[reportArgumentType]
        if field.name in names and getattr(command, field.name) != field.default
    ]


def option(name: str) -> str:
    """A field as it is typed."""
    return f"--{name.replace('_', '-')}"


_ADVICE = re.compile(
    r"(?<![\w.-])(bodies|geoms|groups|instead_of|resolution|scheme|memory)="
    r"(\[[^\]]*\]|'[^']*'|[\w.]+)"
)


_NAMES = re.compile(r"'([^']*)'|([^\[\],\s']+)")


def in_options(command: object, text: str) -> str:
    """A message with its advice as somebody types it who calls the command.

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
    """A law as the library knows it: of `my_laws:Drag k=2` the module is imported.

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


@dataclass(frozen=True)
class LinkOptions:
    """The link, the sand and the simulation."""

    tangential_speed: Annotated[float, tyro.conf.arg(metavar="M/S")] = 0.0
    """Velocity of T along the surface at release, towards the side the link leans to [m/s]."""
    angular_velocity: Annotated[float, tyro.conf.arg(metavar="RAD/S")] = 0.0
    """Rate of change of the angle at release [rad/s]."""
    height: Annotated[float, tyro.conf.arg(metavar="M")] = 0.0
    """Height of the end T above the surface at release [m]."""
    length: Annotated[float, tyro.conf.arg(metavar="M")] = 0.2
    """Length of the link [m]."""
    diameter: Annotated[float, tyro.conf.arg(metavar="M")] = 0.01
    """Diameter of the link [m]."""
    density: Annotated[float, tyro.conf.arg(metavar="KG/M^3")] = 7700.0
    """Density of the link [kg/m^3]."""
    medium: Annotated[str, tyro.conf.arg(metavar="NAME")] = "play_sand"
    """The sand; see `mjgranular list media`."""
    law: Annotated[str | None, tyro.conf.arg(metavar="LAW")] = None
    """The force law; see `mjgranular list laws`, "rft3d scale=1.3" has other parameters
    than the medium, my_laws:Mud is one of your own. Default: the medium's own."""
    scheme: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """How forces become a step. Default: explicit, or implicit where the law needs it."""
    timestep: Annotated[float, tyro.conf.arg(metavar="S")] = 1e-5
    """Time step of the simulation [s]."""
    duration: Annotated[float, tyro.conf.arg(metavar="S")] = 2.0
    """Simulated time after which the run ends at the latest [s]."""
    memory: Annotated[str | None, tyro.conf.arg(metavar="CELL")] = None
    """Let the sand remember what has been pressed down, on cells of this side [m], or as in
    "cell=0.005 extent=1". Default: it closes behind what has passed."""

    def impact(
        self, *, speed: float, angle_deg: float, until: str = "stop", body: str = "link"
    ) -> Impact:
        """The drop with these options."""
        angle = math.radians(angle_deg)
        return record_of(Impact, self, speed=speed, angle=angle, until=until, body=body)


@dataclass(frozen=True, kw_only=True)
class LawOptions:
    """How sand resists, and how finely a law cuts what meets it."""

    law: Annotated[str | None, tyro.conf.arg(metavar="LAW")] = None
    """The force law; see `mjgranular list laws`, "rft3d scale=1.3" has other parameters
    than the medium, my_laws:Mud is one of your own. Default: the medium's own."""
    resolution: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """How finely bodies are cut into elements. Default: the law's."""


@dataclass(frozen=True, kw_only=True)
class ChoiceOptions(LawOptions):
    """The sand, and what of a model meets it."""

    medium: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """The sand, or a YAML file; see `mjgranular list media`. Default: by the law, or
    quikrete_medium."""
    bodies: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Bodies that meet the sand, by name or number. Default: all that can move."""
    geoms: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Geoms that meet the sand, by name or number, visual or not; `all` is all that collide. What
    --bodies, --geoms and --groups name is taken together."""
    groups: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N ...")] = ()
    """Geom groups whose collision geoms meet the sand; of a group of visual ones, all."""


@dataclass(frozen=True, kw_only=True)
class SandOptions(ChoiceOptions):
    """The sand under a model."""

    scheme: Annotated[str, tyro.conf.arg(metavar="NAME")] = "auto"
    """How forces become a step."""
    surface_height: Annotated[float, tyro.conf.arg(metavar="M")] = 0.0
    """Height of the surface above the world's origin [m]."""
    slope: Annotated[float, tyro.conf.arg(metavar="DEG")] = 0.0
    """Slope of the surface [degrees]."""
    uphill: Annotated[float, tyro.conf.arg(metavar="DEG")] = 0.0
    """Direction of steepest ascent from the x axis [degrees]."""
    bed: Annotated[str | None, tyro.conf.arg(metavar="GEOM")] = None
    """Box geom of the model that is the sand."""
    height_field: Annotated[str | None, tyro.conf.arg(metavar="GEOM")] = None
    """Hfield geom of the model that is the sand."""
    instead_of: Annotated[tuple[str, ...], tyro.conf.arg(metavar="GEOM ...")] = ()
    """Geoms that the sand replaces, such as a floor that would carry the model above the sand."""
    memory: Annotated[str | None, tyro.conf.arg(metavar="CELL")] = None
    """Let the sand remember what has been pressed down, on cells of this side [m], or as in
    "cell=0.01 extent=4". Default: it closes behind what has passed."""
    keep_floor: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Let the model stand on ground of its own at or above the surface of the sand."""
