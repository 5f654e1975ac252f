"""Resolve what a `SandSpec` names in a model: the half of `prepare` that needs no scheme."""

from dataclasses import dataclass

import mujoco
import numpy as np

from mjgranular.errors import GranularWarning
from mjgranular.law import Law
from mjgranular.medium import Medium
from mjgranular.relief.footprint import Footprint, footprint_of, surroundings_of
from mjgranular.relief.memory import Memory, as_memory
from mjgranular.relief.relief import Relief
from mjgranular.sand import advice
from mjgranular.sand.material import material_of
from mjgranular.sand.spec import SandSpec
from mjgranular.shape import select_geoms
from mjgranular.surface import Surface
from mjgranular.surface.choice import surface_of
from mjgranular.surface.place import replace_geoms


@dataclass(frozen=True, kw_only=True)
class ChosenSand:
    """The material, the surface and the elements of a sand."""

    medium: Medium
    law: Law  # with its constants
    surface: Surface  # here without memory
    geoms: tuple[int, ...]  # ids of those that meet the sand
    elements: np.ndarray  # of the law, structured, sorted by body
    replaced: tuple[int, ...]  # ids of the geoms that the sand replaces


def choose_sand(model: mujoco.MjModel, spec: SandSpec) -> ChosenSand:
    """Resolve what a sand names in a model, with all checks and warnings.

    Contacts of geoms that the sand replaces are switched off in the model.
    """
    surface = surface_of(spec.surface)
    geoms = geoms_in_sand(model, spec)
    medium, law = material_of(model, spec)
    replaced = replace_geoms(model, spec.instead_of)
    case = advice.Case(model, spec, geoms, law, surface, as_memory(spec.memory))
    advice.warn(advice.CHECKS, case)
    elements = law.elements(model, geoms, spec.resolution)
    advice.warn([(advice.link_law, GranularWarning)], case)
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


def remembering(
    model: mujoco.MjModel, chosen: ChosenSand, memory: Memory
) -> tuple[Relief, Footprint]:
    """Return the surface of a sand with that memory, and the skin of its bodies."""
    surface, geoms = chosen.surface, list(chosen.geoms)
    relief = Relief(surface, memory, surroundings_of(model, geoms, memory))
    return relief, footprint_of(model, geoms, chosen.elements, memory.cell)
