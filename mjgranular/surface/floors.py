"""Rigid ground of the model that carries bodies before they meet the sand."""

import copy
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.shape.sizes import data_at_start, geom_name, geom_type
from mjgranular.surface.place import up_of
from mjgranular.surface.surface import Plane, Surface

SKIN = 1e-3
"""Depth below the sand's surface up to which ground carries what stands on it [m]; chosen."""

_STEEP = 0.5
"""Component against gravity from which on a contact's normal carries; chosen: walls have less."""

_TOLD = 4  # maximum number of geoms named in a message
_FLOOR, _SAND = 4, 5  # geom groups of the model that rays are cast in


def find_floors(model: mujoco.MjModel, geoms: Sequence[int], surface: Surface) -> list[int]:
    """Return the ids of geoms of the world that bodies stand on at or above the sand's surface.

    From each geom that meets the sand, at `qpos0`, rays are cast down, along the normal of a plane,
    to the sand and to what is fixed to the world and collides with that geom. Ground that is hit
    before the sand carries the geom; the base on which a robot's own joints sit does not.
    """
    sand = surface.geoms(model)
    plane = surface if isinstance(surface, Plane) else None
    if plane is None and not sand:
        return []
    fixed = [geom for geom in range(model.ngeom) if _is_fixed(model, geom) and geom not in sand]
    meets = _collisions(model, geoms, fixed)
    if not meets.any():
        return []
    rays = copy.copy(model)
    rays.geom_matid[:] = -1  # rays ignore invisible geoms
    rays.geom_rgba[:] = 1.0
    rays.geom_group[:] = 0
    rays.geom_group[list(sand)] = _SAND
    data = data_at_start(rays)
    down = -up_of(model) if plane is None else -plane.normal
    found = set()
    for geom, against in zip(geoms, meets, strict=True):
        rays.geom_group[fixed] = np.where(against, _FLOOR, 0)
        # Start above the geom, which may be inside its own floor.
        start = data.geom_xpos[geom] - model.geom_rbound[geom] * down
        if plane is None:
            to_sand, _ = _cast(rays, data, start, down, _SAND)
        else:
            to_sand = float(([0.0, 0.0, plane.height] - start) @ down)
        if not np.isfinite(to_sand):  # beside the sand, ground is allowed
            continue
        while True:  # there may be more below a removed floor
            to_floor, floor = _cast(rays, data, start, down, _FLOOR)
            if to_floor > to_sand + SKIN or floor < 0:
                break
            found.add(floor)
            rays.geom_group[floor] = 0
    return sorted(found)


class FloorWatch:
    """Watch contacts for ground of the model that carries bodies instead of the sand.

    `find_floors` finds ground above the sand at `qpos0`. This finds the rest: a floor just under
    the surface, which feet reach, and ground that bodies walk onto. `floors` has the ids of the
    geoms that have carried bodies so far.
    """

    def __init__(self, model: mujoco.MjModel, geoms: Sequence[int], surface: Surface) -> None:
        sand, self._model = surface.geoms(model), model
        self._meets = np.isin(np.arange(model.ngeom), geoms)
        self._fixed = np.array(
            [_is_fixed(model, geom) and geom not in sand for geom in range(model.ngeom)], bool
        )
        self.floors: set[int] = set()

    def look(self, data: mujoco.MjData) -> None:
        """Process the contacts of a step."""
        if data.ncon == 0:
            return
        contact = data.contact
        pairs = contact.geom
        acts = (contact.efc_address >= 0) & (pairs >= 0).all(axis=1)  # a flex has no geom
        acts &= np.abs(contact.frame[:, :3] @ up_of(self._model)) > _STEEP
        both = np.concatenate([pairs[acts], pairs[acts, ::-1]])
        for floor, geom in both[self._fixed[both[:, 0]] & self._meets[both[:, 1]]].tolist():
            if not _is_base(self._model, floor, geom):
                self.floors.add(floor)


def describe_floors(model: mujoco.MjModel, floors: Sequence[int], does: str) -> str:
    """Describe the geoms that carry the model: `does` is a verb with its object."""
    named = [f"{geom_name(model, geom)} (a {geom_type(model, geom)})" for geom in floors]
    if len(named) > _TOLD:
        named[_TOLD:] = [f"{len(named) - _TOLD} more"]
    what = "geoms" if len(floors) > 1 else "geom"
    return f"the model's own {what} {', '.join(named)} {does}"


WOULD_CARRY = "would carry it at or above the sand's surface"
CARRIES = "carries it beside or beneath the sand, which bears the rest"


def _is_fixed(model: mujoco.MjModel, geom: int) -> bool:
    body = int(model.geom_bodyid[geom])
    return bool(model.body_weldid[body] == 0 and model.body_mocapid[body] < 0)


def _is_base(model: mujoco.MjModel, floor: int, geom: int) -> bool:
    """Return True if a fixed geom is of the base from which the geom's body hangs by joints."""
    base, body = int(model.geom_bodyid[floor]), int(model.geom_bodyid[geom])
    while body > base:  # parents have lower numbers
        body = int(model.body_parentid[body])
    return body == base > 0 and int(model.geom_type[floor]) > int(mujoco.mjtGeom.mjGEOM_HFIELD)


def _collisions(model: mujoco.MjModel, geoms: Sequence[int], others: Sequence[int]) -> np.ndarray:
    """Return which geoms make contacts with which others: bool, shape (geoms, others)."""
    types, affinities = model.geom_contype, model.geom_conaffinity
    meets = (types[geoms, None] & affinities[others]) | (affinities[geoms, None] & types[others])
    meets = meets != 0
    pairs = {frozenset(ends) for ends in zip(model.pair_geom1, model.pair_geom2, strict=True)}
    if pairs:
        meets |= [[frozenset((geom, other)) in pairs for other in others] for geom in geoms]
    for row, column in np.argwhere(meets):
        meets[row, column] = not _is_base(model, others[column], geoms[row])
    return meets


def _cast(
    model: mujoco.MjModel, data: mujoco.MjData, start: np.ndarray, along: np.ndarray, group: int
) -> tuple[float, int]:
    """Return the distance [m] and id of the first geom of a group along a ray; inf, -1 for none."""
    groups, hit = np.eye(6, dtype=np.uint8)[group], np.full(1, -1, np.int32)
    distance = mujoco.mj_ray(model, data, start, along, groups, 1, -1, hit)
    return (float(distance), int(hit[0])) if hit[0] >= 0 else (np.inf, -1)
