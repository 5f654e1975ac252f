"""Choices that users have for a surface."""

from __future__ import annotations

from typing import Any

from mjgranular.errors import InputError, shown
from mjgranular.given import kind_of
from mjgranular.surface.plane import Plane
from mjgranular.surface.surface import Surface


def surface_of(surface: Any) -> Surface:
    """A surface, the plane z = 0 for None.

    Raises:
        InputError: it is something else; says what a number or a name may have meant.
    """
    if surface is None:
        return Plane()
    if isinstance(surface, Surface):
        return surface
    meant = "Plane(height=...), Bed('geom') or HeightField('geom')"
    if isinstance(surface, (int, float)):
        meant = f"Plane(height={surface:g}) for a level surface at that height"
    elif isinstance(surface, str):
        meant = f"Bed({shown(surface)}) or HeightField({shown(surface)}) for a geom of that name"
    raise InputError(f"a surface is needed, not {kind_of(surface)}; use {meant}")
