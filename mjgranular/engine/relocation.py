"""Blocks of memory that are copied for each `mjData`, relocated as a linker relocates a file.

The words of a block are numbers and addresses. An address of an array of the block becomes an
offset in the block. An address in MuJoCo's structs or buffers is looked up again in every other
simulation. Everything else is a number.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mujoco.introspect.ast_nodes import PointerType

from mjgranular.kernel.lanes import aligned
from mjgranular.kernel.structs import fields_of, offset_of, read_struct

RELOCATION_DTYPE = np.dtype(
    [
        ("word", np.int64),  # of the block
        ("kind", np.int64),
        ("offset", np.int64),  # in the block or the struct [bytes]
        ("delta", np.int64),  # added to a pointer [bytes]
    ]
)
NO_RELOCATIONS = np.zeros(0, RELOCATION_DTYPE)
IN_BLOCK, IN_DATA, POINTER_IN_DATA, IN_MODEL, POINTER_IN_MODEL = range(5)
"""Kinds of relocation. The last two read the model."""

_WORD = 8  # bytes


@dataclass(frozen=True)
class Image:
    """A block without an `mjData`: its words, as `content`.

    `relocations` are rows of `RELOCATION_DTYPE` that do not read the model; `shared` has the arrays
    whose addresses are in the content.
    """

    content: np.ndarray
    relocations: np.ndarray
    shared: tuple[np.ndarray, ...] = ()

    def copy_for(self, data: int) -> np.ndarray:
        """Make the block of the `mjData` at an address; what reads the model is linked later.

        The words must not move as long as the `mjData` lives.
        """
        block = aligned(self.content)
        words = block.view(np.int64)
        for word, kind, offset, delta in self.relocations.tolist():
            if kind == IN_BLOCK:
                words[word] = block.ctypes.data + offset
            elif kind == IN_DATA:
                words[word] = data + offset
            else:
                words[word] = ctypes.c_int64.from_address(data + offset).value + delta
        return block


class Struct:
    """An `mjModel` or `mjData` in memory, and the buffer that holds its arrays.

    `inside` is the kind of a relocation in the struct; the next one is by a pointer in it.
    """

    def __init__(self, owner: Any, inside: int) -> None:
        name = type(owner).__name__.replace("Mj", "mj")
        struct = read_struct(name, owner._address)
        self._inside = inside
        self._struct = range(owner._address, owner._address + struct.nbytes)
        start = int(struct["buffer"][0])
        self._buffer = range(start, start + int(struct["nbuffer"][0]))
        pointers = (
            (int(struct[field][0]), offset_of(name, field))
            for field, described in fields_of(name).items()
            if isinstance(described.type, PointerType) and field != "buffer"
        )
        self._pointers = [(to, offset) for to, offset in pointers if to in self._buffer]

    def __contains__(self, address: int) -> bool:
        return address in self._struct or address in self._buffer

    def find(self, address: int) -> tuple[int, int, int]:
        """Return kind, offset and delta of the relocation to an address in it."""
        if address in self._struct:
            return self._inside, address - self._struct.start, 0
        # An empty array has the address of the next nonempty one, which is the last of them.
        begin, offset = max(pointer for pointer in self._pointers if pointer[0] <= address)
        return self._inside + 1, offset, address - begin


def places_of(arrays: Sequence[np.ndarray]) -> tuple[dict[int, int], int]:
    """Return the offset of each array stored one after the other by its address, and the size.

    Both are in bytes.
    """
    places, size = {}, 0
    for array in arrays:
        places[array.ctypes.data] = size
        size += -(-array.nbytes // _WORD) * _WORD
    return places, size


def joined(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Return arrays one after the other, as bytes; each starts at a word."""
    parts = [np.frombuffer(array.tobytes(), np.uint8) for array in arrays]
    return np.concatenate([np.pad(part, (0, -part.size % _WORD)) for part in parts])


def find_relocations(
    arrays: Sequence[np.ndarray], places: dict[int, int], structs: Sequence[Struct]
) -> np.ndarray:
    """Return the relocations of the addresses among the words of arrays.

    Numbers among addresses are always smaller than any address.
    """
    rows = []
    for array in arrays:
        first = places[array.ctypes.data] // _WORD
        for number, word in enumerate(words_of(array).tolist(), start=first):
            if word in places:
                rows.append((number, IN_BLOCK, places[word], 0))
                continue
            rows += [(number, *struct.find(word)) for struct in structs if word in struct]
    return np.array(rows, RELOCATION_DTYPE)


def words_of(array: np.ndarray) -> np.ndarray:
    """Return the words of an array."""
    return array.view(np.uint8).view(np.int64)
