"""Memory of a resolved sand: its surface, the skin that presses it down, the law's kernel there."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.law import Law
from mjgranular.law.kernel import LawKernel
from mjgranular.relief.footprint import Footprint, footprint_of, surroundings_of
from mjgranular.relief.memory import Memory
from mjgranular.relief.relief import Relief
from mjgranular.sand import advice
from mjgranular.sand.chosen import ChosenSand
from mjgranular.shape.sizes import geom_name
from mjgranular.surface import Surface

_PLACES = frozenset(("center", "point", "geom", "body", "slot"))
"""Fields of elements that give their position, not their size."""


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
    kernel = _kernel_of(law, surface, forces_alone)
    if isinstance(surface, Relief) and footprint is not None:
        reads = kernel.element._fields
        _check_places(model, chosen.elements, reads, footprint, surface.memory, law.name)
    return kernel


def _kernel_of(law: Law, surface: Surface, forces_alone: bool) -> LawKernel:
    try:
        return law.kernel_of_forces(surface) if forces_alone else law.kernel(surface)
    except AttributeError as error:
        if not isinstance(surface, Relief):
            raise
        raise InputError(
            f"the law {law.name!r} cannot be used with memory ({error}): its `kernel` has to ask "
            "for surface.probe_kernel() in place of type(surface).probe"
        ) from error


def _check_places(
    model: mujoco.MjModel,
    elements: np.ndarray,
    reads: Sequence[str],
    footprint: Footprint,
    memory: Memory,
    law: str,
) -> None:
    """Check that a law does not look for sand in the middle of bodies.

    The surface points of bodies press the sand down; then there is none in the middle, and the body
    would sink without limit.
    """
    if not _PLACES.issuperset(reads):
        return
    points = footprint.points[:, :3].transpose(0, 2, 1)  # tile by tile
    feet = list(dict.fromkeys(elements["geom"].tolist()))
    for element in elements:
        row = feet.index(int(element["geom"]))
        first = int(footprint.feet["end"][row - 1]) if row else 0
        skin = points[first : int(footprint.feet["end"][row])].reshape(-1, 3)
        place = element["center" if "center" in reads else "point"]
        inside = float(np.linalg.norm(skin - place, axis=1).min())
        if inside > memory.cell:
            raise InputError(
                f"the law {law!r} looks for sand in the middle of geom "
                f"{geom_name(model, int(element['geom']))}, {1e3 * inside:.3g} mm inside the skin "
                "that presses it down under memory, and the body would sink without end: have the "
                "law look where the body ends (docs/architecture.md), or leave memory out"
            )
