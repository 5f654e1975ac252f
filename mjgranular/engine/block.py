"""The memory of one sand in one `mjData`: an image made once a model, and what loads it.

Compiled code gets nothing but `mjModel*`, `mjData*` and the number of the plugin instance. All else
that it needs lies in one *block* for each `mjData`: a header, the table of addresses that programs
read (`kernel.memory`), and the arrays that belong to one simulation. What all simulations of a
model have in common, the elements above all, lies in one *share*, which counts its users.

Which address goes where is not written down a second time here. The sand is bound to a model and
an `MjData` as `Sand` does it, and its tables are read as a linker reads an object file: the address
of one of the sand's own arrays becomes a place in the block, one in MuJoCo's structs or buffers is
fetched from there in every other simulation, and all else is a number.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjgranular.engine.layout import Struct
from mjgranular.engine.library import library, memory_at
from mjgranular.engine.tuning import STATE_SIZE
from mjgranular.kernel import memory
from mjgranular.kernel.lanes import LINE
from mjgranular.law.kernel import LawKernel
from mjgranular.sand.binding import bind
from mjgranular.scheme import Scheme
from mjgranular.scheme.status import REFUSED

# What each step reads comes first, in two cache lines.
HEADER_DTYPE = np.dtype(
    [
        ("refused", np.int64),  # not 0: the sand does nothing, and behind the header stands why
        ("refusals", np.int64),  # address, in the share: texts (`refusals`)
        ("tuning_count", np.int64),  # 0 where it has none
        ("of_model", np.int64),  # address: relocations that read the model
        ("of_model_count", np.int64),
        ("shape", np.int64),  # address: what a model has to have in common with that of the sand
        ("shape_count", np.int64),
        ("whole", np.int64),  # whether the scheme reads forces that are not there yet
        ("lead", np.float64),  # how far velocities are taken ahead, in time steps
        ("program", np.int64),  # address of machine code
        ("table", np.int64),  # address
        ("qfrc", np.int64),  # address of qfrc_passive
        ("awake", np.int64),  # address of body_awake
        ("size", np.int64),  # of the block [bytes]
        ("share", np.int64),  # address
        ("relocations", np.int64),  # address, in the share: all others
        ("relocation_count", np.int64),
        ("results", np.int64),  # address of what a step leaves behind: bodies, contacts
        ("results_size", np.int64),  # [bytes]
        ("slots", np.int64),  # address, in the share: for each element its row in `bodies`
        ("draw", np.int64),  # a bit for each of `config.DRAWINGS`
        ("arrow_scale", np.float64),  # length of an arrow [m/N]
        ("arrow_width", np.float64),  # [m]
        ("ends", np.int64),  # address of room for the ends of an arrow
        ("tunings", np.int64),  # address, in the share: what the sand's state changes
        ("tuned", np.int64),  # whether `applied` is what the block was last made to
        ("applied", np.float64, (STATE_SIZE,)),
    ]
)
RELOCATION_DTYPE = np.dtype(
    [
        ("word", np.int64),  # of the block
        ("kind", np.int64),
        ("offset", np.int64),  # in the block or the struct [bytes]
        ("delta", np.int64),  # added to a pointer [bytes]
    ]
)
SHAPE_DTYPE = np.dtype([("address", np.int64), ("value", np.int64)])  # of an int32 in mjModel
# What comes after it lies as rows of sheets should (`kernel.lanes`): MuJoCo's memory begins a line.
SHARE_DTYPE = np.dtype({"names": ["users"], "formats": [np.int64], "itemsize": LINE})
IN_BLOCK, IN_DATA, POINTER_IN_DATA, IN_MODEL, POINTER_IN_MODEL = range(5)
"""Kinds of relocation. Those that read the model are the last two."""

NOT_ASKED = (
    "with springs and dampers both disabled (opt.disableflags) MuJoCo computes no passive forces, "
    "and sand inside mj_step is one of them: enable one of the two"
)

REFUSAL_SIZE = 480
"""Bytes of a text, its end included: MuJoCo cuts at 500."""

_WORD = 8  # bytes
_MOST_RELOCATIONS = 256


@dataclass(frozen=True)
class Image:
    """A block that is not loaded yet.

    Attributes:
        content: its bytes.
        share: address of its share, which the image uses too.
    """

    content: np.ndarray
    share: int


def make_image(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    *,
    elements: np.ndarray,
    scene: np.ndarray,
    scheme: Scheme,
    kernel: LawKernel,
    tunings: np.ndarray,
    shape: Sequence[np.ndarray],
    values: dict[str, Any],
) -> Image:
    """Makes the image of a block.

    Args:
        model: the model.
        data: an `MjData` of it.
        elements: of the law.
        scene: parameters of law, medium and surface.
        scheme: how forces become a step.
        kernel: of the law.
        tunings: what the sand's state changes (`engine.tuning`).
        shape: of the surface (`Surface.shape`).
        values: those fields of the header that are no places: program, lead, drawing.

    Raises:
        LayoutError: an address is not found in MuJoCo's structs.
    """
    slots = elements["slot"].astype(np.int64)
    room = np.zeros(_MOST_RELOCATIONS, RELOCATION_DTYPE)
    texts = refusals(scheme)
    share, (_, laid, slots, tunings, room, texts) = _allocate(
        [np.ones(1, SHARE_DTYPE), kernel.pack(elements), slots, tunings, room, texts]
    )
    with _freed_if_it_fails(share):
        binding = bind(model, data, elements, laid, scene, scheme, kernel, within=True)
        head = np.zeros(1, HEADER_DTYPE)
        table, desk = binding.table, binding.desk
        # In the engine xfrc_applied is all the user's, MuJoCo itself deals with a bad state, and
        # nobody asks for the last good one.
        table[[memory.XFRC, memory.WARNINGS, memory.KEEP]] = 0
        structs = Struct.of_data(data), Struct.of_model(model)
        shapes = np.array([(one.ctypes.data, one[0]) for one in shape], SHAPE_DTYPE)
        linked = (head, table, scene, desk.table, shapes)
        # Those that read the model are needed at each step, and so lie in the block.
        count = sum(structs[1].holds(int(word)) for array in linked for word in _words(array))
        of_model = np.zeros(count, RELOCATION_DTYPE)
        own = [head, of_model, shapes, table, binding.bodies, binding.contacts, scene]
        own += [desk.table, *desk.holds, ends := np.zeros(6)]
        places = dict(zip((array.ctypes.data for array in own), _places(own), strict=True))
        for name, value in {
            **values,
            "size": sum(map(_padded, own)),
            "share": share,
            "refusals": texts.ctypes.data,
            "of_model": of_model.ctypes.data,
            "of_model_count": count,
            "shape": shapes.ctypes.data if len(shapes) else 0,
            "shape_count": len(shapes),
            "relocations": room.ctypes.data,
            "table": table.ctypes.data,
            "qfrc": data.qfrc_passive.ctypes.data,
            "awake": data.body_awake.ctypes.data,
            "results": binding.bodies.ctypes.data,
            "results_size": places[scene.ctypes.data] - places[binding.bodies.ctypes.data],
            "slots": slots.ctypes.data,
            "ends": ends.ctypes.data,
            "tunings": tunings.ctypes.data if len(tunings) else 0,
            "tuning_count": len(tunings),
        }.items():
            head[name] = value

        content = np.concatenate([_bytes(array) for array in own])
        words = content.view(np.int64)
        relocations = []
        for array in linked:
            first = places[array.ctypes.data] // _WORD
            for word in range(first, first + array.nbytes // _WORD):
                place = _resolve(int(words[word]), places, *structs)
                if place is not None:
                    relocations.append((word, *place))
        once = [relocation for relocation in relocations if relocation[1] < IN_MODEL]
        room[: len(once)] = once
        of_model[:] = [relocation for relocation in relocations if relocation[1] >= IN_MODEL]
        head["relocation_count"] = len(once)
        for array in (head, of_model):
            first = places[array.ctypes.data]
            content[first : first + array.nbytes] = _bytes(array)
        return Image(content, share)


@contextmanager
def _freed_if_it_fails(address: int) -> Iterator[None]:
    """Frees memory that is not Python's if what is to be written there cannot be."""
    try:
        yield
    except BaseException:
        library().mju_free(address)
        raise


def refusals(scheme: Scheme) -> np.ndarray:
    """What MuJoCo is to say: for each of `REFUSED`, then where nobody asks for the sand's forces.

    Returns:
        Texts of `REFUSAL_SIZE` bytes.
    """
    texts = [*(scheme.refusal(status) for status in REFUSED), NOT_ASKED]
    return np.array([f"mjgranular: {text}".encode() for text in texts], f"S{REFUSAL_SIZE}")


def load(content: np.ndarray) -> int:
    """Puts a block into memory of its own; gives its address. It is not linked yet."""
    address = library().mju_malloc(content.nbytes)
    ctypes.memmove(address, content.ctypes.data, content.nbytes)
    return address


def _words(array: np.ndarray) -> np.ndarray:
    return array.view(np.uint8).view(np.int64)


def _resolve(
    word: int, places: dict[int, int], of_data: Struct, of_model: Struct
) -> tuple[int, int, int] | None:
    """Kind, offset and delta of the place that a word is the address of; None for a number.

    No number that stands among addresses is as large as an address.
    """
    if word in places:
        return IN_BLOCK, places[word], 0
    for struct, inside in ((of_data, IN_DATA), (of_model, IN_MODEL)):
        if struct.encloses(word):
            return inside, word - struct.address, 0
        if word in struct.buffer:
            # POINTER_IN_DATA, POINTER_IN_MODEL
            return inside + 1, *struct.pointer(word, "an array that a program reads")
    return None


def _allocate(arrays: Sequence[np.ndarray]) -> tuple[int, list[np.ndarray]]:
    """Copies arrays into memory that is not Python's; gives its address, and them there."""
    size = sum(_padded(array) for array in arrays)
    address = library().mju_malloc(size)
    raw = memory_at(address, size)
    raw[:] = np.concatenate([_bytes(array) for array in arrays])
    there = [
        raw[place : place + array.nbytes].view(array.dtype)
        for place, array in zip(_places(arrays), arrays, strict=True)
    ]
    return address, there


def _padded(array: np.ndarray) -> int:
    return -(-array.nbytes // _WORD) * _WORD


def _places(arrays: Sequence[np.ndarray]) -> list[int]:
    """Where each begins when they lie one behind the other [bytes]."""
    return [sum(map(_padded, arrays[:index])) for index in range(len(arrays))]


def _bytes(array: np.ndarray) -> np.ndarray:
    raw = np.frombuffer(array.tobytes(), np.uint8)
    return np.pad(raw, (0, _padded(array) - raw.size))
