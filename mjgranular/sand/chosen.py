"""Resolve what a `SandSpec` names in a model: the half of `prepare` that needs no scheme."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mjgranular.errors import GranularWarning, InputError
from mjgranular.law import Law
from mjgranular.law.kernel import LawKernel
from mjgranular.medium import Medium
from mjgranular.relief.footprint import Footprint, footprint_of, surroundings_of
from mjgranular.relief.memory import Memory, as_memory
from mjgranular.relief.relief import Relief
from mjgranular.sand import advice
from mjgranular.sand.material import elements_of, material_of
from mjgranular.sand.spec import SandSpec
from mjgranular.shape import select_geoms
from mjgranular.shape.sizes import geom_name
from mjgranular.surface import Surface
from mjgranular.surface.choice import surface_of
from mjgranular.surface.place import replace_geoms

_PLACES = frozenset(("center", "point", "geom", "body", "slot"))
"""Fields of elements that give their position, not their size."""


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
    elements = elements_of(model, geoms, law, spec.resolution)
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
    """Return the surface of a sand with that memory, and the skin of its bodies; warn if needed."""
    surface, geoms = chosen.surface, list(chosen.geoms)
    relief = Relief(surface, memory, surroundings_of(model, geoms, memory))
    advice.warn(advice.CHECKS_OF_MEMORY, model, geoms, surface, memory)
    return relief, footprint_of(model, geoms, chosen.elements, memory.cell)


def kernel_under(
    model: mujoco.MjModel,
    chosen: ChosenSand,
    surface: Surface,
    footprint: Footprint | None,
    *,
    forces_alone: bool = False,
) -> LawKernel:
    """Return the kernel of a sand's law under its surface, perhaps one with memory (`footprint`).

    `forces_alone` omits derivatives (`Law.kernel_of_forces`).
    """
    law = chosen.law
    try:
        kernel = law.kernel_of_forces(surface) if forces_alone else law.kernel(surface)
    except AttributeError as error:
        if not isinstance(surface, Relief):
            raise
        raise InputError(
            f"the law {law.name!r} cannot be used with memory ({error}): its `kernel` has to ask "
            "for surface.probe_kernel() in place of type(surface).probe"
        ) from error
    if isinstance(surface, Relief) and footprint is not None:
        _check_places(model, chosen, kernel.element._fields, footprint, surface.memory.cell)
    return kernel


def _check_places(
    model: mujoco.MjModel,
    chosen: ChosenSand,
    reads: Sequence[str],
    footprint: Footprint,
    cell: float,
) -> None:
    """Check that a law does not look for sand in the middle of bodies.

    The surface points of bodies press the sand down; then there is none in the middle, and the body
    would sink without limit.
    """
    if not _PLACES.issuperset(reads):
        return
    points = footprint.points[:, :3].transpose(0, 2, 1)  # tile by tile
    feet = list(dict.fromkeys(chosen.elements["geom"].tolist()))
    for element in chosen.elements:
        row = feet.index(int(element["geom"]))
        first = int(footprint.feet["end"][row - 1]) if row else 0
        skin = points[first : int(footprint.feet["end"][row])].reshape(-1, 3)
        place = element["center" if "center" in reads else "point"]
        inside = float(np.linalg.norm(skin - place, axis=1).min())
        if inside > cell:
            raise InputError(
                f"the law {chosen.law.name!r} looks for sand in the middle of geom "
                f"{geom_name(model, int(element['geom']))}, {1e3 * inside:.3g} mm inside the skin "
                "that presses it down under memory, and the body would sink without end: have the "
                "law look where the body ends (docs/architecture.md), or leave memory out"
            )
