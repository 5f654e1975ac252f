"""Check that a device has enough memory for the sand of all worlds and its stored heights."""

from __future__ import annotations

from typing import Any

import numpy as np

from mjgranular.errors import InputError
from mjgranular.relief.memory import Memory
from mjgranular.sand.cost import coarser

_OF_A_NODE = 4 + 4 + 8 + 4
"""Bytes per node of memory: height, tile, requested height, and contact geom."""


def check_room(
    device: Any, worlds: int, of_a_world: int, elements: np.ndarray, resolution: int | None
) -> None:
    """Check that a GPU has enough memory for a sand; on a CPU the operating system manages it.

    `of_a_world` are bytes per world, `elements` are shared by all worlds; `resolution` is as the
    user set it. The error says the need, what is free, and what would fit.
    """
    if not device.is_cuda:
        return
    of_all, free = worlds * of_a_world, device.free_memory
    needed = of_all + elements.nbytes
    if needed <= free:
        return
    advice = f"take at most {max(1, (free - elements.nbytes) // of_a_world):,} worlds"
    if of_all < free:
        advice = coarser(elements, resolution, (free - of_all) // elements.itemsize)
    raise InputError(
        f"{len(elements):,} elements of sand in {worlds:,} worlds take {_gib(needed)}, and "
        f"{device.alias} has {_gib(free)} left: {advice}"
    )


def check_room_to_remember(device: Any, worlds: int, memory: Memory) -> None:
    """Check that a GPU has enough memory for the stored heights of all worlds."""
    if not device.is_cuda:
        return
    needed, free = _OF_A_NODE * worlds * memory.size**2, device.free_memory
    if needed <= free:
        return
    fits = 1.05 * memory.cell * (needed / max(free, 1)) ** 0.5
    raise InputError(
        f"a memory of {memory.size} by {memory.size} cells in {worlds:,} worlds takes "
        f"{_gib(needed)}, and {device.alias} has {_gib(free)} left: take cells of {fits:.2g} m, a "
        "smaller extent, or fewer worlds"
    )


def _gib(size: int) -> str:
    return f"{size / 2**30:.2g} GiB"
