"""Memory of a resolved sand: its surface, the skin that presses it down, the law's kernel there."""

from __future__ import annotations

import mujoco

from mjgranular.errors import InputError
from mjgranular.law import Law
from mjgranular.law.kernel import LawKernel
from mjgranular.relief.advice import refuse_blind, warn_of_buried, warn_of_cells, warn_of_spread
from mjgranular.relief.footprint import Footprint, footprint_of, surroundings_of
from mjgranular.relief.memory import Memory
from mjgranular.relief.relief import Relief
from mjgranular.sand.chosen import ChosenSand
from mjgranular.surface import Surface


def remembering(
    model: mujoco.MjModel, chosen: ChosenSand, memory: Memory
) -> tuple[Relief, Footprint]:
    """Return the surface of a sand with memory and the skin of its bodies; warn if needed.

    Args:
        model: the model.
        chosen: the sand without memory.
        memory: one that fits the model (`relief.footprint.fitting`).

    Raises:
        InputError: the surface cannot have memory, or the skin has more points than the capacity.
    """
    surface, geoms = chosen.surface, list(chosen.geoms)
    warn_of_cells(model, geoms, surface, memory)
    warn_of_spread(model, geoms, memory)
    warn_of_buried(model, geoms, surface, memory)
    relief = Relief(surface, memory, surroundings_of(model, geoms, memory))
    return relief, footprint_of(model, geoms, chosen.elements, memory.cell)


def kernel_under(
    model: mujoco.MjModel,
    chosen: ChosenSand,
    surface: Surface,
    footprint: Footprint | None,
    *,
    forces_alone: bool = False,
) -> LawKernel:
    """Return the kernel of a sand's law under its surface.

    Args:
        model: the model.
        chosen: the sand without memory.
        surface: the sand's, or the one with memory.
        footprint: the skin of its bodies; None without memory.
        forces_alone: whether to omit derivatives (`Law.kernel_of_forces`).

    Raises:
        InputError: the law cannot be used with memory.
    """
    law = chosen.law
    kernel = _kernel_of(law, surface, forces_alone)
    if isinstance(surface, Relief) and footprint is not None:
        reads = kernel.element._fields
        refuse_blind(model, chosen.elements, reads, footprint, surface.memory, law.name)
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
