"""Geoms that are sand, or that sand replaces: fixed in the world, without contacts."""

import math

import mujoco
import numpy as np

from mjgranular.errors import InputError, UnknownNameError, shown
from mjgranular.shape.select import Choice, find_all
from mjgranular.shape.sizes import data_at_start, geom_type, name_of


def check_geom(name: object, word: str) -> None:
    """Check that the geom of a surface is given by its name."""
    if not isinstance(name, str):
        raise InputError(f"a {word} is given by the name of its geom, not by {shown(name)}")


def find_geom(model: mujoco.MjModel, name: str, kind: mujoco.mjtGeom, word: str) -> int:
    """Return the id of a geom of that name and type that is fixed to the world.

    Its contacts are disabled in the model: bodies meet the sand only through its law.
    """
    geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name)
    shape = kind.name.removeprefix("mjGEOM_").lower()
    if geom < 0:
        same = np.flatnonzero(model.geom_type == kind)
        known = [name_of(model, "geom", int(g)) for g in same]
        raise UnknownNameError(f"{shape} geom of the model", name, [k for k in known if k])
    if model.geom_type[geom] != kind:
        found = geom_type(model, geom)
        raise InputError(f"geom {name!r} is a {found}: a {word} is made of a {shape} geom")
    _disable_contacts(model, [geom], f"a {word}")
    return geom


def replace_geoms(model: mujoco.MjModel, geoms: Choice) -> list[int]:
    """Disable the contacts of geoms that the sand replaces; return their ids.

    If one is on a body that moves, or in an explicit contact pair, none of them is changed.
    """
    found = find_all(model, "geom", geoms)
    _disable_contacts(model, found, "ground that sand replaces")
    return found


def _disable_contacts(model: mujoco.MjModel, geoms: list[int], thing: str) -> None:
    """Disable contacts, after a check that this is possible."""
    for geom in geoms:
        body = int(model.geom_bodyid[geom])
        if model.body_weldid[body] != 0 or model.body_mocapid[body] >= 0:
            raise InputError(
                f"geom {_name(model, geom)!r} is on body {name_of(model, 'body', body)!r}, which "
                f"can move: {thing} must be fixed to the world"
            )
        for number in range(model.npair):  # an explicit pair collides whatever the two flags are
            ends = [int(model.pair_geom1[number]), int(model.pair_geom2[number])]
            if geom in ends:
                pair = name_of(model, "pair", number) or number
                first, second = (_name(model, end) for end in ends)
                other = sum(ends) - geom
                flags = model.geom_contype[other] or model.geom_conaffinity[other]
                raise InputError(
                    f"the contact pair {pair!r} makes geoms {first!r} and {second!r} collide, but "
                    f"{_name(model, geom)!r} is {thing}, which bodies sink into: remove that <pair>"
                    + ("" if flags else f", and name {_name(model, other)!r} in geoms=[...]")
                )
    model.geom_contype[geoms] = 0
    model.geom_conaffinity[geoms] = 0


def _name(model: mujoco.MjModel, geom: int) -> str | int:
    return name_of(model, "geom", geom) or geom


def world_pose(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """Return position (3,) and axes in columns (3, 3) of a geom that is fixed to the world."""
    data = data_at_start(model)
    return data.geom_xpos[geom].copy(), data.geom_xmat[geom].reshape(3, 3).copy()


def up_of(model: mujoco.MjModel) -> np.ndarray:
    """Return the unit vector against gravity, or z without it."""
    gravity = model.opt.gravity
    return -gravity / np.linalg.norm(gravity) if gravity.any() else np.array([0.0, 0.0, 1.0])


def strength_of_gravity(model: mujoco.MjModel) -> float:
    """Return the size of gravity [m/s^2], 0 if a flag disables it."""
    is_off = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    return 0.0 if is_off else float(np.linalg.norm(model.opt.gravity))


def tilt_of(normal: np.ndarray, model: mujoco.MjModel) -> float:
    """Return the angle of a unit normal from the vertical [rad]."""
    up = up_of(model)
    return math.atan2(float(np.linalg.norm(np.cross(normal, up))), float(normal @ up))
