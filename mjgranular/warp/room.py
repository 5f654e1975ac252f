"""Whether a device has room for sand in so many worlds, and for what they remember."""

from __future__ import annotations

from typing import Any

import numpy as np

from mjgranular.errors import InputError
from mjgranular.relief.memory import Memory
from mjgranular.sand.cost import coarser

_OF_A_NODE = 4 + 4 + 8 + 4
"""Bytes of a node of memory: height, tile, what skin wants, and the foot there."""


def check_room(
    device: Any, worlds: int, of_a_world: int, elements: np.ndarray, resolution: int | None
) -> None:
    """Checks that a GPU has room for a sand; a processor's memory is the system's affair.

    Args:
        device: of Warp's.
        worlds: number of them.
        of_a_world: bytes that each takes.
        elements: of a law, which all worlds share.
        resolution: that they were asked for with.

    Raises:
        InputError: says how much it takes, how much there is, and what would fit.
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
    """Checks that a GPU has room for what so many worlds remember.

    Raises:
        InputError: says how much it takes, how much there is, and which cells would fit.
    """
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
