"""One description of a sand, for every interface that puts sand under a model."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypedDict

from mjgranular.errors import InputError, UnknownArgumentError, shown
from mjgranular.law import Law
from mjgranular.medium import Medium
from mjgranular.relief import Memory
from mjgranular.scheme.scheme import SchemeChoice
from mjgranular.shape.select import Choice
from mjgranular.surface import Surface


@dataclass(frozen=True, kw_only=True)
class SandSpec:
    """A sand: its material, its surface, and what meets it.

    `Sand`, `add_sand` and `mjgranular.envs.on_sand` take one, or its fields as keyword arguments,
    which replace those of a spec given in addition. Whether it fits a model is checked then.

    Attributes:
        medium: a medium, its name, or a YAML file (`medium.file`); None for one that has constants
            for the law or, without a law, `quikrete_medium` with `rft3d_dynamic`, unless the model
            names a law itself (`sand.material`).
        law: how it resists: a law, its name, followed by parameters that differ from the medium's
            ("rft3d scale=1.3"), or None for the medium's default.
        surface: where it is, also as a string ("plane height=0.1"); None for the plane z = 0.
        scheme: the time stepping scheme: a scheme or its name, followed by options. "auto" takes
            `Implicit`, but `Explicit` for fine time steps if the law allows (`scheme.choice`).
        bodies: names or numbers of bodies that meet the sand, with their collision geoms, or "all".
        geoms: names or numbers of the geoms that meet the sand; or "all".
        groups: geom groups whose collision geoms meet the sand, those of bodies that can move; of a
            group in which none collides, all. The union of `bodies`, `geoms` and `groups` meets the
            sand; with none of them, as with "all", every collision geom of what can move.
        resolution: how finely geoms are cut, in the law's own measure; None for its default.
        instead_of: names or numbers of geoms that the sand replaces, such as the model's own floor.
            They must be fixed to the world; the model loses their contacts, and still draws them.
        memory: memory of what has been pressed down: a `Memory`, the side of a cell [m], a string
            such as "cell=0.01 extent=4", or True for defaults; None for sand that closes behind
            what has passed.
    """

    medium: str | Path | Medium | None = None
    law: str | Law | None = None
    surface: Surface | str | None = None
    scheme: str | SchemeChoice = "auto"
    bodies: Choice = None
    geoms: Choice = None
    groups: Sequence[int] | int | None = None
    resolution: int | None = None
    instead_of: Choice = None
    memory: Memory | float | bool | str | None = None

    def __repr__(self) -> str:
        """Return only what differs from the defaults."""
        values = ((field, getattr(self, field.name)) for field in fields(self))
        given = (f"{f.name}={value!r}" for f, value in values if not _same(value, f.default))
        return f"{type(self).__name__}({', '.join(given)})"


class SandFields(TypedDict, total=False):
    """The fields of `SandSpec` as keyword arguments, for editors and type checkers."""

    medium: str | Path | Medium | None
    law: str | Law | None
    surface: Surface | str | None
    scheme: str | SchemeChoice
    bodies: Choice
    geoms: Choice
    groups: Sequence[int] | int | None
    resolution: int | None
    instead_of: Choice
    memory: Memory | float | bool | str | None


SAND_FIELDS = tuple(field.name for field in fields(SandSpec))


def _same(value: Any, default: Any) -> bool:
    """Return True if a field has its default; an array is never equal to one."""
    return value is default or (type(value) is type(default) and value == default)


def combined(spec: SandSpec | None, given: SandFields | None = None) -> SandSpec:
    """Return a sand, or that in a record that extends `SandSpec`, with some fields replaced."""
    if spec is not None and not isinstance(spec, SandSpec):
        raise InputError(
            f"sand is described by a SandSpec, not by {shown(spec)}; fields of one are given by "
            "name, such as medium='play_sand'"
        )
    for name in given or {}:
        if name not in SAND_FIELDS:
            raise UnknownArgumentError("a sand", name, SAND_FIELDS)
    own: Any = {} if spec is None else {name: getattr(spec, name) for name in SAND_FIELDS}
    return SandSpec(**{**own, **(given or {})})
