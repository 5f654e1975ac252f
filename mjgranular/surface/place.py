"""Where a geom that is sand lies: fixed in the world, and no obstacle of its own."""

from __future__ import annotations

import mujoco
import numpy as np

from mjgranular.errors import InputError, UnknownNameError, shown
from mjgranular.names import name_of


def find_geom(model: mujoco.MjModel, name: str, kind: mujoco.mjtGeom, word: str) -> int:
    """The id of a geom of that name and type that is fixed to the world.

    Its contacts are switched off in the model: sand is met through its law alone.

    Args:
        model: the model.
        name: of the geom.
        kind: the type it has to have.
        word: what it is wanted for, for messages: "bed", "height field".

    Raises:
        UnknownNameError: no such geom; lists those of the type.
        InputError: a geom of another type, on a body that moves, or in an explicit contact pair.
    """
    if not isinstance(name, str):
        raise InputError(f"a {word} is given by the name of its geom, not by {shown(name)}")
    geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name)
    shape = kind.name.removeprefix("mjGEOM_").lower()
    if geom < 0:
        same = np.flatnonzero(model.geom_type == kind)
        known = [name_of(model, "geom", int(g)) for g in same]
        raise UnknownNameError(f"{shape} geom of the model", name, [k for k in known if k])
    if model.geom_type[geom] != kind:
        found = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
        raise InputError(f"geom {name!r} is a {found}: a {word} is made of a {shape} geom")
    body = int(model.geom_bodyid[geom])
    if model.body_weldid[body] != 0 or model.body_mocapid[body] >= 0:
        mover = name_of(model, "body", body)
        raise InputError(
            f"geom {name!r} is on body {mover!r}, which can move: a {word} must be fixed to the "
            "world"
        )
    _refuse_pairs(model, geom, word)
    model.geom_contype[geom] = 0
    model.geom_conaffinity[geom] = 0
    return geom


def _refuse_pairs(model: mujoco.MjModel, geom: int, word: str) -> None:
    """Explicit pairs collide whatever contype and conaffinity are, and cannot be switched off."""
    for number in range(model.npair):
        ends = [int(model.pair_geom1[number]), int(model.pair_geom2[number])]
        if geom in ends:
            pair = name_of(model, "pair", number) or number
            first, second = (name_of(model, "geom", end) or end for end in ends)
            ours = name_of(model, "geom", geom)
            raise InputError(
                f"the contact pair {pair!r} makes geoms {first!r} and {second!r} collide, but "
                f"{ours!r} is a {word}, which bodies sink into: remove that <pair>"
            )


def world_pose(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and axes in columns (3, 3) of a geom that is fixed to the world."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data.geom_xpos[geom].copy(), data.geom_xmat[geom].reshape(3, 3).copy()


def tilt_of(normal: np.ndarray) -> float:
    """Angle of a unit normal against the vertical [rad]."""
    return float(np.arccos(np.clip(normal[2], -1.0, 1.0)))
