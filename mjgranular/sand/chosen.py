"""Resolve what a `SandSpec` names in a model: the half of `prepare` that needs no scheme."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mjgranular.law import Law
from mjgranular.medium import Medium
from mjgranular.relief.memory import as_memory
from mjgranular.sand import advice
from mjgranular.sand.material import elements_of, material_of
from mjgranular.sand.spec import SandSpec
from mjgranular.shape import select_geoms
from mjgranular.surface import Surface
from mjgranular.surface.choice import surface_of
from mjgranular.surface.place import replace_geoms


@dataclass(frozen=True, kw_only=True)
class ChosenSand:
    """The material, the surface and the elements of a sand.

    Attributes:
        medium: the medium.
        law: the law, with its constants.
        surface: the surface, without memory.
        geoms: ids of the geoms that meet the sand.
        elements: elements of the law: a structured array, sorted by body.
        replaced: ids of the geoms that the sand replaces.
    """

    medium: Medium
    law: Law
    surface: Surface
    geoms: tuple[int, ...]
    elements: np.ndarray
    replaced: tuple[int, ...]


def choose_sand(model: mujoco.MjModel, spec: SandSpec) -> ChosenSand:
    """Resolve what a sand names in a model, with all checks and warnings.

    Args:
        model: the model; contacts of geoms that the sand replaces are switched off in it.
        spec: the sand.

    Raises:
        UnknownNameError: a name or group that does not exist; lists those that do.
        InputError: geoms that the law has no elements for.
    """
    surface = surface_of(spec.surface)
    geoms = geoms_in_sand(model, spec)
    medium, law = material_of(model, spec)
    replaced = replace_geoms(model, spec.instead_of)
    case = advice.Case(model, spec, geoms, law, surface, as_memory(spec.memory))
    advice.warn(advice.CHECKS, case)
    elements = elements_of(model, geoms, law, spec.resolution)
    advice.warn(advice.CHECKS_OF_LAW, case)
    return ChosenSand(
        medium=medium,
        law=law,
        surface=surface,
        geoms=tuple(geoms),
        elements=elements,
        replaced=tuple(replaced),
    )


def geoms_in_sand(model: mujoco.MjModel, spec: SandSpec) -> list[int]:
    """Return the ids of the geoms of a model that meet a sand; see `select_geoms`."""
    return select_geoms(
        model,
        bodies=spec.bodies,
        geoms=spec.geoms,
        groups=spec.groups,
        leave_out=surface_of(spec.surface).geoms(model),
    )
