"""The memory of one sand in one `mjData`: an image per model, and a copy for each `mjData`.

Compiled code gets only `mjModel*`, `mjData*` and the index of the plugin instance. Everything else
that it needs is in one *block* per `mjData`: a header, the table of addresses that programs read
(`kernel.memory`), and the arrays of one simulation. What all simulations share is not copied.

The assignment of addresses is not repeated here. The sand is bound to a model and an `MjData` as by
`Sand`, and its tables are relocated, as a linker relocates a file: the words of a block are numbers
and addresses. An address of an array of the block becomes an offset in the block. An address in
MuJoCo's structs or buffers is looked up again in every other simulation. All else is a number.
"""

import ctypes
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import mujoco
import numpy as np
from mujoco.introspect.ast_nodes import PointerType

from mjgranular.engine.config import SENSOR
from mjgranular.engine.instances import plugin_slot
from mjgranular.engine.tuning import STATE_SIZE
from mjgranular.kernel import memory
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import fields_of, offset_of, read_struct
from mjgranular.kernel.lanes import aligned
from mjgranular.sand.binding import bind
from mjgranular.sand.prepare import PreparedSand
from mjgranular.scheme import Scheme
from mjgranular.scheme.scheme import REFUSED

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
    """A block without an `mjData`."""

    content: np.ndarray  # its words
    relocations: np.ndarray  # rows of `RELOCATION_DTYPE` that do not read the model
    shared: tuple[np.ndarray, ...] = ()  # arrays whose addresses are in the content

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
    """Return offsets of arrays stored one after the other, by address, and their size [bytes]."""
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


# What each step reads comes first, in two cache lines.
HEADER_DTYPE = np.dtype(
    [
        ("refused", np.int64),  # not 0: the sand does nothing; the reason follows the header
        ("refusals", np.int64),  # address: messages (`refusals`)
        ("tuning_count", np.int64),  # 0 without tunings
        ("of_model", np.int64),  # address: relocations that read the model
        ("of_model_count", np.int64),
        ("shape", np.int64),  # address: sizes that a model must share with that of the sand
        ("shape_count", np.int64),
        ("whole", np.int64),  # whether the scheme reads forces that are not yet computed
        ("lead", np.float64),  # time by which velocities are ahead, in time steps
        ("program", np.int64),  # address of machine code
        ("table", np.int64),  # address
        ("qfrc", np.int64),  # address of qfrc_passive
        ("xfrc", np.int64),  # address of xfrc_applied
        ("awake", np.int64),  # address of body_awake
        ("instances", np.int64),  # of all plugins in the model
        ("later", np.int64),  # the next instance of sand in the model; 0 for none
        ("senses", np.int64),  # whether the model has sensors that may read forces on bodies
        # Not 0 if forces are those of the step that MuJoCo computes, or unknown: what is unpickled
        # may have them in `qfrc_passive`.
        ("current", np.int64),
        ("updating", np.int64),  # whether those are being recomputed (`external`)
        ("size", np.int64),  # of the block [bytes]
        ("image", np.int64),  # number of the image that it copies
        ("results", np.int64),  # address of a step's results: bodies, contacts
        ("results_size", np.int64),  # [bytes]
        ("slots", np.int64),  # address: for each element its row in `bodies`
        ("geoms", np.int64),  # address: for each element its geom
        ("draw", np.int64),  # a bit for each of `config.DRAWINGS`
        ("ends", np.int64),  # address of memory for the ends of an arrow
        ("plane", np.int64),  # offset of the surface's record in the scene [bytes]
        ("frame", np.int64),  # offset of a relief's axes in that record [bytes]
        ("tiles", np.int64),  # address: rectangles that it is drawn with (`look.TILES`)
        ("tile_count", np.int64),
        ("material", np.int64),  # how sand looks (`looks`)
        ("picture", np.int64),
        ("unit", np.float64),
        ("lowered", np.float64),
        ("shape_program", np.int64),  # address of machine code that shapes a skin; 0 without tracks
        ("canvas", np.int64),  # address: what that fills (`render.track_kernel`)
        ("skin", np.int64),  # id of the skin
        ("skin_pointer", np.int64),  # offset in mjModel of the pointer to vertices [bytes]
        ("skin_offset", np.int64),  # offset of the skin's first vertex from there [bytes]
        ("ground", np.int64),  # id of a height field that is drawn under it; -1 for none
        ("ground_data", np.int64),  # number of its data
        ("rgb", np.float64, (3,)),  # color that the picture is multiplied by
        ("tunings", np.int64),  # address: what the sand's state changes
        ("tuned", np.int64),  # whether `applied` is the block's present state
        ("applied", np.float64, (STATE_SIZE,)),
    ]
)
SHAPE_DTYPE = np.dtype([("address", np.int64), ("value", np.int64)])  # of an int32 in mjModel
NO_PASSIVE = (
    "with springs and dampers both disabled (opt.disableflags) MuJoCo computes no passive forces, "
    "and sand inside mj_step is one of them: enable one of the two"
)
OTHER_SHAPE = (
    "the height field that is the sand has other rows or columns in this model than in that of the "
    "mjData: make an mjData for each model"
)

REFUSAL_SIZE = 480
"""Bytes of a message, including its end: MuJoCo cuts at 500."""

_numbers = itertools.count(1)
_headers = memory.records(HEADER_DTYPE)


@partial(compiled, inline=True)
def header_at(block):
    """Return the header of the block at an address."""
    return _headers(block, 1)[0]


def make_image(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    instance: int,
    sand: PreparedSand,
    tunings: np.ndarray,
    drawing: dict[str, Any],
    canvas: Sequence[np.ndarray] = (),
) -> Image:
    """Make the image of a block."""
    slots, geoms = (sand.elements[key].astype(np.int64) for key in ("slot", "geom"))
    texts = refusals(sand.scheme)
    ours = np.flatnonzero(model.plugin == model.plugin[instance])
    shape = sand.surface.shape(model)
    first = int(model.plugin_stateadr[instance])
    state = data.plugin_state[first : first + sand.surface.state_size]
    binding = bind(model, data, sand, within=True, state=state)
    head = np.zeros(1, HEADER_DTYPE)
    table, workspace = binding.table, binding.workspace
    # In the engine forces do not use xfrc_applied, and MuJoCo itself handles a bad state.
    table[[memory.XFRC, memory.WARNINGS, memory.SNAPSHOT]] = 0
    of_data, of_model = Struct(data, IN_DATA), Struct(model, IN_MODEL)
    shapes = np.array([(one.ctypes.data, one[0]) for one in shape], SHAPE_DTYPE)
    linked = (head, table, binding.scene, workspace.record, shapes, *canvas[:1])
    # Those that read the model are needed at each step, and are part of the block.
    count = sum(int(word) in of_model for array in linked for word in words_of(array))
    live = np.zeros(count, RELOCATION_DTYPE)
    own = [head, live, shapes, table, binding.bodies, binding.contacts, binding.scene]
    own += [workspace.record, *workspace.arrays.values(), ends := np.zeros(6), *canvas]
    places, size = places_of(own)
    for name, value in {
        **drawing,
        "program": sand.program,
        "whole": sand.scheme.whole_state,
        "lead": sand.scheme.lead,
        "size": size,
        "image": next(_numbers),
        "refusals": texts.ctypes.data,
        "of_model": live.ctypes.data,
        "of_model_count": count,
        "shape": shapes.ctypes.data if len(shapes) else 0,
        "shape_count": len(shapes),
        "current": 1,
        "table": table.ctypes.data,
        "qfrc": data.qfrc_passive.ctypes.data,
        "xfrc": data.xfrc_applied.ctypes.data,
        "awake": data.body_awake.ctypes.data,
        "instances": model.nplugin,
        "later": next(iter(ours[ours > instance].tolist()), 0),
        "senses": senses_forces(model),
        "results": binding.bodies.ctypes.data,
        "results_size": places[binding.scene.ctypes.data] - places[binding.bodies.ctypes.data],
        "slots": slots.ctypes.data,
        "geoms": geoms.ctypes.data,
        "ends": ends.ctypes.data,
        "canvas": canvas[0].ctypes.data if canvas else 0,
        "tunings": tunings.ctypes.data if len(tunings) else 0,
        "tuning_count": len(tunings),
    }.items():
        head[name] = value

    relocations = find_relocations(linked, places, (of_data, of_model))
    reads_model = relocations["kind"] >= IN_MODEL
    live[:] = relocations[reads_model]
    content = joined(own)
    shared = [sand.packed, slots, geoms, tunings, texts]
    if sand.footprint is not None:
        shared += [sand.footprint.points, sand.footprint.spheres, sand.footprint.feet]
    return Image(content.view(np.float64), relocations[~reads_model], tuple(shared))


def senses_forces(model: mujoco.MjModel) -> bool:
    """Return True if a model has sensors that may read the external forces on bodies."""
    kinds = mujoco.mjtSensor
    readers = (kinds.mjSENS_FORCE, kinds.mjSENS_TORQUE, kinds.mjSENS_USER, kinds.mjSENS_PLUGIN)
    late = model.sensor_needstage == int(mujoco.mjtStage.mjSTAGE_ACC)
    late &= (model.sensor_plugin < 0) | (model.plugin[model.sensor_plugin] != plugin_slot(SENSOR))
    return bool((late & np.isin(model.sensor_type, [int(kind) for kind in readers])).any())


def refusals(scheme: Scheme) -> np.ndarray:
    """Return messages of `REFUSAL_SIZE` bytes: of `REFUSED`, then `NO_PASSIVE`, `OTHER_SHAPE`."""
    texts = [*(scheme.refusal(status) for status in REFUSED), NO_PASSIVE, OTHER_SHAPE]
    return np.array([f"mjgranular: {text}".encode() for text in texts], f"S{REFUSAL_SIZE}")
