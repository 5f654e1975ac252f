"""Parse a user's choice of a surface."""

from dataclasses import MISSING, fields
from typing import Any

from mjgranular._util.checks import kind_of
from mjgranular._util.parse import read_part
from mjgranular._util.registry import Registry
from mjgranular.errors import InputError
from mjgranular.surface.surface import Bed, HeightField, Plane, Surface

surfaces: Registry[type[Surface]] = Registry("surface")
"""Classes of surfaces by the names that MJCF and strings use; `surfaces.add` adds a custom one."""

surfaces.add("plane", Plane)
surfaces.add("bed", Bed)
surfaces.add("height_field", HeightField)


def surface_of(surface: Any) -> Surface:
    """Return a surface, one parsed from words, or z = 0 for None.

    Words are `plane height= slope= uphill=`, `bed geom=`, `height_field geom=`.
    """
    if surface is None:
        return Plane()
    if isinstance(surface, Surface):
        return surface
    if not isinstance(surface, str):
        meant = "Plane(height=...), Bed('geom') or HeightField('geom')"
        raise InputError(f"a surface is needed, not {kind_of(surface)}; use {meant}")
    cls, given = read_part(surface, surfaces, "surface")
    options: Any = fields(cls)  # pyright: ignore[reportArgumentType]
    missing = [f.name for f in options if f.default is MISSING and f.name not in given]
    if missing:
        name = surface.split(maxsplit=1)[0]
        raise InputError(
            f"the surface {name!r} needs {missing[0]}=..., such as '{name} {missing[0]}=NAME'"
        )
    return cls(**given)
