"""Which geoms of a model meet the sand."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from mjgranular.errors import InputError, UnknownNameError


def select_geoms(
    model: mujoco.MjModel,
    *,
    bodies: Sequence[str] | str | None = None,
    geoms: Sequence[str] | str | None = None,
    leave_out: Sequence[int] = (),
) -> list[int]:
    """The ids of the geoms that meet the sand, in the order of the model.

    Without `bodies` and `geoms`: every collision geom (contype or conaffinity not zero) of a body
    that can move. A body named in `bodies` brings its collision geoms; a geom named in `geoms` is
    taken as it is, visual or not.

    Args:
        model: the model.
        bodies: a body's name, or several.
        geoms: a geom's name, or several.
        leave_out: ids of geoms that are the sand itself.

    Raises:
        UnknownNameError: a name that the model does not have; lists those it has.
        InputError: nothing is left, or what is named cannot move.
    """
    wanted_bodies = [_id(model, mujoco.mjtObj.mjOBJ_BODY, "body", name) for name in _names(bodies)]
    wanted_geoms = [_id(model, mujoco.mjtObj.mjOBJ_GEOM, "geom", name) for name in _names(geoms)]
    everything = bodies is None and geoms is None

    chosen = set(wanted_geoms)
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
        if collides and (body in wanted_bodies or (everything and moves(model, body))):
            chosen.add(geom)
    chosen.difference_update(leave_out)
    for body in {*wanted_bodies, *(int(model.geom_bodyid[g]) for g in wanted_geoms)}:
        if not moves(model, body):
            raise InputError(
                f"body {model.body(body).name!r} is fixed to the world: sand cannot act on it; "
                "name a body that has a joint above it"
            )
    if not chosen:
        raise InputError(
            "no geom of the model can meet the sand: a body with a joint and a collision geom "
            "(contype or conaffinity not 0) is needed, or geoms=[...] to name one"
        )
    return sorted(chosen)


def moves(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body has a degree of freedom between itself and the world."""
    return int(model.body_weldid[body]) != 0 and last_dof(model, body) >= 0


def last_dof(model: mujoco.MjModel, body: int) -> int:
    """The last degree of freedom in the body's chain, -1 if it has none."""
    while body > 0 and model.body_dofnum[body] == 0:
        body = int(model.body_parentid[body])
    return int(model.body_dofadr[body] + model.body_dofnum[body] - 1) if body > 0 else -1


def _names(names: Sequence[str] | str | None) -> Sequence[str]:
    if names is None:
        return ()
    return (names,) if isinstance(names, str) else names


def _id(model: mujoco.MjModel, kind: mujoco.mjtObj, word: str, name: str) -> int:
    found = mujoco.mj_name2id(model, kind, name)
    if found < 0:
        count = model.nbody if word == "body" else model.ngeom
        known = [mujoco.mj_id2name(model, kind, i) for i in range(count)]
        raise UnknownNameError(f"{word} of the model", name, [k for k in known if k])
    return found
