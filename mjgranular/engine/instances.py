"""The sands in a model, and the bodies they act on, read from the model."""

import ctypes
from collections.abc import Iterator

import mujoco
import numpy as np

from mjgranular._util.checks import check_kind, check_name
from mjgranular.engine.config import KEYS, NAME, read_config
from mjgranular.errors import InputError
from mjgranular.kernel.engine import library
from mjgranular.law import Law
from mjgranular.medium import Medium
from mjgranular.relief.memory import Heights, Memory, as_memory, heights_of
from mjgranular.relief.relief import place_in_plane
from mjgranular.sand.prepare import geoms_in_sand
from mjgranular.sand.spec import SandSpec, material_of
from mjgranular.surface import Surface, surface_of


def plugin_slot(name: str) -> int:
    """Return the index by which models refer to a plugin; -1 if MuJoCo has none of that name."""
    slot = ctypes.c_int(-1)
    library().mjp_getPlugin(name.encode(), ctypes.addressof(slot))
    return slot.value


def instance_name(model: int, instance: int) -> str:
    """Return the name of an instance in the model at an address, or its index if it has none."""
    name = library().mj_id2name(model, int(mujoco.mjtObj.mjOBJ_PLUGIN), instance)
    return _text_of(name) or str(instance)


def config_texts(model: int, instance: int, keys: tuple[str, ...]) -> dict[str, str]:
    """Return the configuration strings of an instance by key, "" for missing ones."""
    read = library().mj_getPluginConfig
    return {key: _text_of(read(model, instance, key.encode())) for key in keys}


def _text_of(raw: bytes | None) -> str:
    """Decode a string of MuJoCo, "" for none; a model file may contain bytes that are not UTF-8."""
    return (raw or b"").decode(errors="backslashreplace")


def sands_in(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of a model's instances of sand, which act inside `mj_step`."""
    if model.nplugin == 0:
        return ()
    slot = plugin_slot(NAME)  # -1 if it could not be registered
    ours = np.flatnonzero((model.plugin == slot) & (slot >= 0))
    return tuple(instance_name(model._address, int(instance)) for instance in ours)


def instance_of(model: mujoco.MjModel, name: str) -> int:
    """Return the index of the instance of sand of that name."""
    names = sands_in(model)
    check_name("sand of the model", name, names)
    slots = np.flatnonzero(model.plugin == plugin_slot(NAME))
    return int(slots[names.index(name)])


def bodies_of_sands(model: mujoco.MjModel) -> Iterator[tuple[str, set[int]]]:
    """Yield the name of each instance of sand, and the ids of the bodies that it acts on."""
    for name in sands_in(model):
        geoms = geoms_in_sand(model, _spec_of(model, instance_of(model, name)))
        yield name, {int(model.geom_bodyid[geom]) for geom in geoms}


def material_in(
    model: mujoco.MjModel, name: str = "sand"
) -> tuple[Medium, Law, Surface, Memory | None]:
    """Return medium, law, surface and memory of a sand inside `mj_step`, with defaults resolved."""
    sand = _spec_of(model, instance_of(model, name))
    medium, law = material_of(model, sand)
    return medium, law, surface_of(sand.surface), as_memory(sand.memory)


def relief_of(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    name: str = "sand",
    middle: tuple[float, float] | None = None,
) -> Heights:
    """Return the stored heights of a sand inside `mj_step`, as `Sand.relief` does.

    `name` is that of its instance.

    Raises:
        UnknownNameError: the model has no such sand; lists those it has.
        InputError: it has no memory.
    """
    check_kind(model, mujoco.MjModel, "relief_of")
    check_kind(data, mujoco.MjData, "relief_of")
    instance = instance_of(model, name)
    sand = _spec_of(model, instance)
    memory = as_memory(sand.memory)
    if memory is None:
        raise InputError(
            f"the sand {name!r} has no memory: make it with add_sand(..., memory=True)"
        )
    if middle is None:
        bodies = sorted({int(model.geom_bodyid[geom]) for geom in geoms_in_sand(model, sand)})
        point = data.xpos[bodies].mean(axis=0)
        middle = place_in_plane(surface_of(sand.surface), model, point)
    first = int(model.plugin_stateadr[instance])
    return heights_of(data.plugin_state[first : first + memory.state_size], memory, middle)


def _spec_of(model: mujoco.MjModel, instance: int) -> SandSpec:
    return read_config(config_texts(model._address, instance, KEYS)).sand
