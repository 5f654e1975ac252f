"""From the configuration in MJCF to a block in memory: what Python does when an `mjData` is made.

MuJoCo calls `init` for each plugin instance of each new `mjData`, with two C pointers. The sand is
prepared by the same Python code as for `Sand`, on a copy of the model, and cached by its inputs:
the next `mjData` of a model that is the same in them costs a hash and a copy of a block.
"""

import ctypes
import hashlib
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco.introspect.ast_nodes import PointerType

from mjgranular.engine import config, sensor
from mjgranular.engine.block import HEADER_DTYPE, NO_PASSIVE, NO_RELOCATIONS, Image, make_image
from mjgranular.engine.handles import HandleTable
from mjgranular.engine.instances import config_texts, instance_name, plugin_slot
from mjgranular.engine.looks import look_of_plane, look_of_tracks
from mjgranular.engine.tuning import NO_TUNINGS, STATE_SIZE, make_tunings
from mjgranular.errors import InputError
from mjgranular.kernel.engine import (
    array_size,
    check_layout,
    fields_of,
    library,
    offset_of,
    read_struct,
)
from mjgranular.kernel.records import NO_PASSIVE_FORCES
from mjgranular.kernel.threads import LOADER, prepare_in_worker
from mjgranular.law import laws
from mjgranular.medium import media
from mjgranular.relief.relief import Relief
from mjgranular.render.material import NOT_SHOWN, radius_of
from mjgranular.render.skin import skin_of
from mjgranular.sand.prepare import PreparedSand, prepare
from mjgranular.sand.report import Names
from mjgranular.scheme import Auto, schemes
from mjgranular.surface import Plane, Surface, surfaces

_KEPT = 32  # images of past models: they cost memory, and save another preparation
# Inputs of elements, selection, surfaces and prints. Heights of a height field are read live.
_PREFIXES = (
    "body_", "geom_", "jnt_", "dof_", "hfield_", "mesh_vert", "mesh_face", "mesh_pos", "mesh_quat",
)  # fmt: skip
_SWITCHES = list(fields_of("mjOption"))
_SWITCHES = _SWITCHES[_SWITCHES.index("integrator") :]  # solver, Jacobian, flags
_NO_CONTACTS = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
_SENSORS = (
    "sensor_plugin", "sensor_objtype", "sensor_objid", "sensor_reftype", "sensor_adr",
    "site_bodyid",
)  # fmt: skip
_NAMES = (
    "qpos0", "plugin", *_SENSORS, "sensor_type", "sensor_needstage", "names",
    "skin_matid", "skin_rgba",
)  # fmt: skip
_NO_MATTER = (
    "hfield_data", "geom_rgba", "geom_user", "geom_matid", "body_user", "plugin", *_SENSORS,
)  # fmt: skip


@dataclass(frozen=True)
class Prepared:
    """The sand of one instance in a model."""

    image: Image  # of its block
    bodies: dict[int, str]  # names of the bodies that meet it by their ids, in its order
    geoms: dict[int, str]  # names of the geoms that have elements, by their ids
    disabled: tuple[int, ...]  # geoms whose contacts are off (`sand.prepare`)
    hidden: tuple[int, ...]  # geoms that are sand, and replaced by its tracks in drawings
    place: str | None  # in words, if fixed; None for sand that can be switched off (`tunable`)
    draws: bool  # whether anything is drawn
    origin: object  # medium and `_registered`: kept alive, as the cache key has their identities


class Loader:
    """Make blocks for each new `mjData`."""

    def __init__(self, draw: Callable[[], None]) -> None:
        self._handles = HandleTable()
        self._prepared: OrderedDict[bytes, Prepared] = OrderedDict()
        self._draw = draw
        self._draws = False

    def load(self, model: int, data: int, instance: int) -> None:
        """Assign a block to an instance in a new `mjData`."""
        with LOADER:
            self._handles.clear(data, instance)
            sands = _sands(model)
            if instance in sands.values():
                if instance in _array(model, "sensor_plugin"):
                    raise InputError(
                        "a sensor refers to the sand itself, which measures nothing: use an "
                        f"instance of the plugin {config.SENSOR}"
                    )
                self._check_overlap(model, instance, sands)
                content = self._prepare(model, instance).image
            else:
                content = self._sensor(model, instance, sands)
            self._handles.put(data, instance, content.copy_for(data), content)

    def refuse(self, model: int, data: int, instance: int, text: bytes) -> None:
        """Assign a block that raises an error of MuJoCo at its first use."""
        head = np.zeros(1, HEADER_DTYPE)
        head["refused"] = 1
        with LOADER:
            self._handles.clear(data, instance)
            message = np.frombuffer(text.ljust(len(text) // 8 * 8 + 8, b"\0"), np.float64)
            self._handles.put(data, instance, np.concatenate([head.view(np.float64), message]))

    def clear_slot(self, data: int, instance: int) -> None:
        """Assign a block that does nothing to an instance of the model that prepares the sand.

        No lock is taken: the thread that waits for the preparation holds it.
        """
        self._handles.clear(data, instance)
        self._handles.put(data, instance, np.zeros(1, HEADER_DTYPE))

    def release(self, data: int) -> None:
        """Drop all blocks of an `mjData` that MuJoCo is about to discard."""
        with LOADER:
            self._handles.release(data)

    def _check_overlap(self, model: int, instance: int, sands: dict[str, int]) -> None:
        """Check that two sands in one place do not act on the same body."""
        if len(sands) < 2:
            return
        mine = self._prepare(model, instance)
        for name, other in sands.items():
            theirs = self._prepare(model, other)
            common = mine.bodies.keys() & theirs.bodies.keys()
            together = mine.place is not None and mine.place == theirs.place
            if other != instance and common and together:
                raise InputError(
                    f"the sand {name!r} acts on body {mine.bodies[min(common)]!r} too, in the "
                    f"same place ({mine.place}): the body would be resisted twice; keep one of "
                    "them, select what meets each with bodies=... or geoms=..., or use tunable=true"
                )

    def _sensor(self, model: int, instance: int, sands: dict[str, int]) -> Image:
        texts = config_texts(model, instance, config.SENSOR_KEYS)
        sand = sensor.find_sand(texts["sand"], sands)
        prepared = self._prepare(model, sand)
        array = partial(_array, model)
        readings = sensor.make_readings(
            instance, sand, texts["measure"], array, prepared.bodies, prepared.geoms
        )
        head = np.zeros(1, HEADER_DTYPE)
        head["size"] = head.nbytes + readings.nbytes
        content = np.concatenate([head.view(np.float64), readings.view(np.float64)])
        return Image(content, NO_RELOCATIONS)

    def _prepare(self, model: int, instance: int) -> Prepared:
        texts = config_texts(model, instance, config.KEYS)
        key = _key(model, instance, texts)
        prepared = self._prepared.get(key)
        if prepared is None:
            prepared = prepare_in_worker(lambda: self._make(key, model, instance, texts))
        else:
            self._prepared.move_to_end(key)
        changed = [_write(model, "geom_group", prepared.hidden, NOT_SHOWN)]
        for name in ("geom_contype", "geom_conaffinity"):
            changed.append(_write(model, name, prepared.disabled, 0))
        if any(changed):
            self._keep(_key(model, instance, texts), prepared)
        return prepared

    def _make(self, key: bytes, model: int, instance: int, texts: dict[str, str]) -> Prepared:
        copy = mujoco.MjModel._from_model_ptr(library().mj_copyModel(None, model))
        prepared = _prepare(copy, instance, texts)
        if prepared.draws and not self._draws:
            self._draw()
            self._draws = True
        self._keep(key, prepared)
        return prepared

    def _keep(self, key: bytes, prepared: Prepared) -> None:
        self._prepared[key] = prepared
        self._prepared.move_to_end(key)
        while len(self._prepared) > _KEPT:
            self._prepared.popitem(last=False)


def _key(model: int, instance: int, texts: dict[str, str]) -> bytes:
    """Return a digest of everything that the sand is made of.

    Preparing sand does not use contacts, and MuJoCo's compiler makes an `mjData` with the flag set
    that disables them before the user's first one. So this flag is ignored.
    """
    options = read_struct("mjOption", model + offset_of("mjModel", "opt")).copy()
    options["disableflags"] &= ~_NO_CONTACTS
    digest = hashlib.blake2b(_sizes(model), digest_size=16)
    for name in _SWITCHES:
        digest.update(options[name].tobytes())
    parts = [id(part) for part in _registered()]
    sands = list(_sands(model).values())  # a block has the number of the next
    digest.update(repr((instance, sands, texts, _medium_now(texts["medium"]), parts)).encode())
    if texts["scheme"].split()[:1] in ([], [Auto.name]):  # it depends on the time step
        digest.update(options["timestep"].tobytes())
    for name, (offset, size) in _arrays(_sizes(model)).items():
        if not name.startswith(_NO_MATTER):
            digest.update(ctypes.string_at(_pointer(model + offset), size))
    return digest.digest()


def _sizes(model: int) -> bytes:
    """Return the sizes of a model: everything in the struct before its options."""
    return ctypes.string_at(model, offset_of("mjModel", "opt"))


@lru_cache(_KEPT)
def _arrays(sizes: bytes) -> dict[str, tuple[int, int]]:
    """Return the arrays of a model that sand is made of: offset of the pointer, size [bytes]."""
    return {
        name: (offset_of("mjModel", name), array_size("mjModel", name, sizes))
        for name, field in fields_of("mjModel").items()
        if isinstance(field.type, PointerType) and (name.startswith(_PREFIXES) or name in _NAMES)
    }


def _array(model: int, name: str) -> np.ndarray:
    """Return a copy of an array of integers of a model."""
    offset, size = _arrays(_sizes(model))[name]
    return np.frombuffer(ctypes.string_at(_pointer(model + offset), size), np.int32)


def _write(model: int, name: str, places: Sequence[int], value: int) -> bool:
    """Write to some integers of an array of a model; return whether any was different."""
    begin, changed = _pointer(model + offset_of("mjModel", name)), False
    for place in places:
        number = ctypes.c_int32.from_address(begin + 4 * place)
        changed = changed or number.value != value
        number.value = value
    return changed


def _sands(model: int) -> dict[str, int]:
    """Return the instances of sand in a model by name."""
    ours = np.flatnonzero(_array(model, "plugin") == plugin_slot(config.NAME))
    return {instance_name(model, int(i)): int(i) for i in ours}


def _pointer(address: int) -> int:
    return ctypes.c_int64.from_address(address).value


def _medium_now(text: str) -> object:
    """Return an identity of the medium that a name or file means at present."""
    if text.endswith((".yaml", ".yml")):
        try:
            found = Path(text).stat()
        except OSError:
            return None
        return found.st_mtime_ns, found.st_size
    if not text:  # it follows from law and bodies
        return [id(medium) for medium in media.values()]
    return id(media.get(text))


def _registered() -> list[type]:
    """Return the classes that names mean at present."""
    return [cls for register in (laws, schemes, surfaces) for cls in register.values()]


def _prepare(model: mujoco.MjModel, instance: int, texts: dict[str, str]) -> Prepared:
    """Prepare the sand of an instance from its configuration, for a model, which is modified."""
    if model.opt.disableflags & NO_PASSIVE_FORCES == NO_PASSIVE_FORCES:
        raise InputError(NO_PASSIVE)
    parsed = config.read_config(texts)
    sand = prepare(model, parsed.sand, within=True)
    tunings = NO_TUNINGS
    if parsed.tunable:
        with config.named("tunable"):
            tunings = make_tunings(sand, model)
    size = sand.surface.state_size + (STATE_SIZE if parsed.tunable else 0)
    if model.plugin_statenum[instance] != size:
        raise InputError(
            f"the model has {model.plugin_statenum[instance]} numbers for the sand's state, which "
            f"has {size}: compile the model again"
        )
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_PLUGIN, instance) or ""
    drawing, canvas = _drawing(model, parsed.draw, sand, name)
    names = Names.of(model, sand.elements)
    return Prepared(
        make_image(model, mujoco.MjData(model), instance, sand, tunings, drawing, canvas),
        bodies=names.bodies,
        geoms=names.geoms,
        disabled=sand.disabled,
        hidden=sand.surface.geoms(model) if canvas else (),
        place=None if parsed.tunable else _place_of(sand.surface),
        draws=bool(drawing["draw"]),
        origin=(sand.medium, *_registered()),
    )


def _place_of(surface: Surface) -> str:
    """Return the same words for surfaces under which a body would always meet both sands."""
    if isinstance(surface, Relief):
        surface = surface.base
    return "an endless plane" if isinstance(surface, Plane) else repr(surface)


def _drawing(
    model: mujoco.MjModel, drawings: Sequence[str], sand: PreparedSand, name: str
) -> tuple[dict[str, Any], tuple[np.ndarray, ...]]:
    """Return what is drawn, and how: fields of a block's header, and arrays for tracks.

    Without memory a bed is drawn as its geom.
    """
    look, arrays, chosen = None, (), set(drawings)
    surface, record = sand.surface, sand.scene["surface"]
    if "surface" in chosen:
        if isinstance(surface, Relief) and (skin := skin_of(model, name)) >= 0:
            look, arrays = look_of_tracks(model, surface, record, skin, 2 * radius_of(model))
        else:
            plane = surface.base if isinstance(surface, Relief) else surface
            look = look_of_plane(model, plane, radius_of(model))
    if look is None:
        chosen -= {"surface"}
    if not chosen:
        return {"draw": 0}, ()
    check_layout("mjvGeom")
    fields: Any = sand.scene.dtype.fields
    return {
        "draw": sum(1 << config.DRAWINGS.index(drawing) for drawing in chosen),
        "plane": fields["surface"][1],
        **(look or {}),
    }, arrays
