"""Selection of the geoms of a model that meet the sand."""

import operator
from collections.abc import Collection, Iterable, Sequence
from typing import Any

import mujoco
import numpy as np

from mjgranular._util.checks import kind_of
from mjgranular.errors import InputError, UnknownNameError
from mjgranular.shape.sizes import name_of

Choice = Sequence[str | int] | str | int | None
"""Selection of bodies or geoms: a name or id, or several; None for no selection."""

EVERY = "all"  # name for every body or geom that can meet the sand, unless one has this name


def select_geoms(
    model: mujoco.MjModel,
    *,
    bodies: Choice = None,
    geoms: Choice = None,
    groups: Sequence[int] | int | None = None,
    leave_out: Sequence[int] = (),
) -> list[int]:
    """Return the ids of the geoms that meet the sand, in the order of the model.

    A body named in `bodies` adds its collision geoms (contype or conaffinity not 0, or a <pair>). A
    group in `groups` adds those of bodies that can move, or all of a group without collision geoms.
    A geom named in `geoms` is used as it is, visual or not. The result is the union. "all" for
    `bodies` or `geoms`, or no selection, means every collision geom of a body that can move. Each
    is given as one or several names or ids, and `leave_out` as ids of geoms that are the sand
    itself. Errors list the names and groups that exist.
    """
    _check_names(model)
    moving = [g for g in range(model.ngeom) if moves(model, int(model.geom_bodyid[g]))]
    meets = [geom for geom in moving if collides(model, geom)]
    chosen = set(_in_groups(model, moving, groups))
    if bodies is None and geoms is None and groups is None:
        chosen.update(meets)
    for name in names_in(bodies):
        every = _is_every(model, "body", name)
        chosen.update(meets if every else _of_body(model, _find(model, "body", name)))
    for name in names_in(geoms):
        if _is_every(model, "geom", name):
            chosen.update(meets)
        else:
            geom = _find(model, "geom", name)
            _refuse_fixed(model, int(model.geom_bodyid[geom]))
            chosen.add(geom)
    chosen.difference_update(leave_out)
    if not chosen:
        raise InputError(
            "no geom of the model can meet the sand: a body with a joint and a collision geom "
            "(contype or conaffinity not 0) is needed, or geoms=[...] to name one"
        )
    return sorted(chosen)


def find_all(model: mujoco.MjModel, kind: str, names: Choice) -> list[int]:
    """Return the ids of bodies or geoms, as `kind` says, from names or ids."""
    _check_names(model)
    return [_find(model, kind, name) for name in names_in(names)]


def collides(model: mujoco.MjModel, geom: int) -> bool:
    """Return True if a geom takes part in contacts, if only those of an explicit pair."""
    pairs = np.concatenate([model.pair_geom1, model.pair_geom2])
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom] or geom in pairs)


def moves(model: mujoco.MjModel, body: int) -> bool:
    """Return True if a body has a degree of freedom between itself and the world."""
    return int(model.body_weldid[body]) != 0 and last_dof(model, body) >= 0


def last_dof(model: mujoco.MjModel, body: int) -> int:
    """Return the last degree of freedom in the body's chain, -1 if it has none."""
    while body > 0 and model.body_dofnum[body] == 0:
        body = int(model.body_parentid[body])
    return int(model.body_dofadr[body] + model.body_dofnum[body] - 1) if body > 0 else -1


def is_choice(names: Choice) -> bool:
    """Return True if names select some bodies or geoms, and not none or all."""
    return any(name != EVERY for name in names_in(names))


def body_name(model: mujoco.MjModel, body: int) -> str:
    """Return a body's name in quotes, or its id."""
    name = name_of(model, "body", body)
    return repr(name) if name else f"number {body}"


def names_in(names: Choice) -> list[str | int]:
    """Return names and ids as a list; raise for anything else."""
    if names is None:
        return []
    one = isinstance(names, (str, bytes)) or not isinstance(names, Collection)
    several: Any = (names,) if one else names
    for name in several:
        if isinstance(name, bool) or not isinstance(name, (str, int, np.integer)):
            raise InputError(
                f"bodies and geoms are chosen by names or numbers, not by {kind_of(name)}"
            )
    return [name if isinstance(name, str) else int(name) for name in several]


def _check_names(model: mujoco.MjModel) -> None:
    """Check that Python can read all names: MuJoCo accepts any bytes."""
    try:
        bytes(model.names).decode()
    except UnicodeDecodeError:
        raise InputError(
            "a name in the model is not UTF-8, as those of an MJCF file must be: save it again"
        ) from None


_OBJECTS = {"body": mujoco.mjtObj.mjOBJ_BODY, "geom": mujoco.mjtObj.mjOBJ_GEOM}


def _is_every(model: mujoco.MjModel, kind: str, name: str | int) -> bool:
    return name == EVERY and mujoco.mj_name2id(model, _OBJECTS[kind], EVERY) < 0


def _find(model: mujoco.MjModel, kind: str, name: str | int) -> int:
    """Return the id of a body or geom by its name or id."""
    count = model.nbody if kind == "body" else model.ngeom
    found = mujoco.mj_name2id(model, _OBJECTS[kind], name) if isinstance(name, str) else name
    if found < 0 and str(name).isdecimal():  # an id that was written as a word
        found = int(name)
    if 0 <= found < count:
        return found
    if isinstance(name, int) or name.isdecimal():
        raise InputError(f"the model has no {kind} number {name}: they go from 0 to {count - 1}")
    known = [name_of(model, kind, i) for i in range(count)]
    theirs = [name for name in known if name and not name.startswith("mjgranular_")]
    other = "geom" if kind == "body" else "body"
    is_other = mujoco.mj_name2id(model, _OBJECTS[other], name) >= 0
    hint = f"there is a {other} of that name" if is_other else ""
    raise UnknownNameError(f"{kind} of the model", name, theirs, hint)


def _of_body(model: mujoco.MjModel, body: int) -> list[int]:
    _refuse_fixed(model, body)
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    found = [geom for geom in range(first, first + count) if collides(model, geom)]
    if not found:
        raise InputError(
            f"body {body_name(model, body)} has no collision geom (contype or conaffinity not 0) "
            "that could meet the sand: name its geoms with geoms=[...], or another body"
        )
    return found


def _refuse_fixed(model: mujoco.MjModel, body: int) -> None:
    if moves(model, body):
        return
    raise InputError(
        f"body {body_name(model, body)} is fixed to the world, or to a mocap body, which has no "
        "velocity: sand cannot act on it; name a body that has a joint above it, which a <weld> "
        "may have follow a mocap body"
    )


def _in_groups(
    model: mujoco.MjModel, moving: Sequence[int], groups: Sequence[int] | int | None
) -> list[int]:
    """Return the geoms of `moving` in the groups: per group its collision geoms, or else all."""
    members: dict[int, list[int]] = {}
    for geom in moving:
        members.setdefault(int(model.geom_group[geom]), []).append(geom)
    chosen = []
    for group in _numbers(groups):
        if group not in members:
            kind = "geoms of bodies that can move in geom group"
            raise UnknownNameError(kind, group, map(str, sorted(members)))
        colliding = [geom for geom in members[group] if collides(model, geom)]
        chosen.extend(colliding or members[group])
    return chosen


def _numbers(groups: Sequence[int] | int | None) -> list[int]:
    if groups is None:
        return []
    try:
        several = groups if isinstance(groups, Iterable) else (groups,)
        return [operator.index(group) for group in several]
    except TypeError:
        raise InputError(
            f"groups takes the number of a geom group, or several, not {groups!r}"
        ) from None
