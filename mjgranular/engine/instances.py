"""The sands that a model has, and the bodies they act on, read from the model."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from mjgranular.engine.config import KEYS, read_config
from mjgranular.engine.library import config_texts, instance_name, plugin_slot
from mjgranular.errors import UnknownNameError
from mjgranular.sand.prepare import geoms_in_sand

NAME = "mjgranular.sand"
"""Of the plugin."""


def sands_in(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the instances of sand that a model has, which act inside `mj_step`."""
    if model.nplugin == 0:
        return ()
    try:
        slot = plugin_slot(NAME)  # -1 where it could not be registered
    except ImportError:  # nor could it without MuJoCo's library
        return ()
    ours = np.flatnonzero((model.plugin == slot) & (slot >= 0))
    return tuple(instance_name(model._address, int(instance)) for instance in ours)


def instance_of(model: mujoco.MjModel, name: str) -> int:
    """The number of the instance of sand of that name.

    Raises:
        UnknownNameError: the model has none; lists those it has.
    """
    names = sands_in(model)
    if name not in names:
        raise UnknownNameError("sand of the model", name, names)
    slots = np.flatnonzero(model.plugin == plugin_slot(NAME))
    return int(slots[names.index(name)])


def bodies_of_sands(model: mujoco.MjModel) -> Iterator[tuple[str, set[int]]]:
    """The names of a model's instances of sand, and the ids of the bodies that each acts on.

    Raises:
        InputError: what is written for one cannot be read, or does not fit the model.
    """
    for name in sands_in(model):
        texts = config_texts(model._address, instance_of(model, name), KEYS)
        geoms = geoms_in_sand(model, read_config(texts).sand)
        yield name, {int(model.geom_bodyid[geom]) for geom in geoms}
