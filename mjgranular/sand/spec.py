"""One description of a sand, for every interface that puts sand under a model."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypedDict

import mujoco

from mjgranular.errors import InputError, UnknownArgumentError, UnknownNameError, shown
from mjgranular.law import Law, get_law, law_in
from mjgranular.medium import Medium, get_medium, media
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
            names a law itself (`material_of`).
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


DEFAULT_MEDIUM = "quikrete_medium"
"""The medium where neither medium nor law is given: its law, `rft3d_dynamic`, takes every shape."""

LAW_TEXT = "mjgranular.law"
"""Name of the custom text in which a model names the law that it is made for."""

_FIRST_MEDIA = ("play_sand", DEFAULT_MEDIUM)
"""Media that are searched first for a law's constants if only a law is given."""


def material_of(model: mujoco.MjModel, spec: SandSpec) -> tuple[Medium, Law]:
    """Return the medium and the law of a sand.

    With a medium alone the law is the medium's default; with a law alone the medium is one that has
    constants for it. With neither, the law is the one that the model names in its custom text
    `LAW_TEXT`, as the package's link does, else that of `DEFAULT_MEDIUM`.

    Raises:
        InputError: a density follows the medium's name, and the law does not depend on it.
    """
    law = spec.law
    if spec.medium is None and law is None:
        law = law_named_in(model)
    if spec.medium is not None:
        medium = get_medium(spec.medium)
    else:
        medium = media[DEFAULT_MEDIUM] if law is None else medium_for(law)
    found = get_law(law, medium)
    if medium.name == spec.medium and "density=" in medium.name:
        value = 1000.0 if medium.density.value != 1000.0 else 2000.0  # any other
        other = replace(medium, density=replace(medium.density, value=value))
        numbers = get_law(law, other).parameters(other)
        if numbers.tobytes() == found.parameters(medium).tobytes():
            raise InputError(
                f"{spec.medium!r}: the density of the medium has no effect under the law "
                f'{found.name}; constants of a law follow its name, as in "rft3d density=1500"'
            )
    return medium, found


def law_named_in(model: mujoco.MjModel) -> str | None:
    """Return the content of the model's custom text `LAW_TEXT`; None if it has none."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, LAW_TEXT)
    if number < 0:
        return None
    start, size = model.text_adr[number], model.text_size[number]
    return bytes(model.text_data[start : start + size]).rstrip(b"\0").decode(errors="replace")


def medium_for(law: str | Law) -> Medium:
    """Return the default medium of a law."""
    kind = type(law) if isinstance(law, Law) else law_in(law)[0]
    for name in (*_FIRST_MEDIA, *(name for name in media if name not in _FIRST_MEDIA)):
        if has_constants(media[name], kind):
            return media[name]
    return media[_FIRST_MEDIA[0]]


def has_constants(medium: Medium, law: type[Law]) -> bool:
    """Return True if a medium has the constants of a law."""
    try:
        law.from_medium(medium)
    except (InputError, UnknownNameError):
        return False
    return True
