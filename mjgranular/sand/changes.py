"""Checks for changes of a model after its sand was made, and for steps without the sand."""

import hashlib
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.shape.select import body_name
from mjgranular.shape.sizes import geom_name

_SHAPES = ("geom_type", "geom_size", "geom_pos", "geom_quat")
_GEOMS = (*_SHAPES, "geom_bodyid", "geom_dataid")
_BODIES = ("body_pos", "body_quat", "body_parentid", "body_jntnum", "body_dofadr", "body_dofnum")
_JOINTS = ("jnt_type", "jnt_pos", "jnt_axis", "jnt_bodyid")
_FIELDS = ("hfield_size", "hfield_nrow", "hfield_ncol")
_MESHES = ("mesh_vert", "mesh_face", "mesh_vertadr", "mesh_faceadr")


class Original:
    """Record of the parts of a model that a sand was made from.

    Masses, options, actuators and the heights of a height field are not recorded: they are read at
    each step. The position of the root of a tree is not recorded either: the elements do not depend
    on it. `geoms` meet the sand, `places` are the sand.
    """

    def __init__(self, model: mujoco.MjModel, geoms: Sequence[int], places: Sequence[int]) -> None:
        self._geoms = np.array(sorted({*geoms, *places}), int)
        bodies = {int(model.geom_bodyid[geom]) for geom in geoms}
        inner = {body for body in bodies if model.body_parentid[body] != 0}
        self._bodies = np.array(sorted(inner | {int(model.geom_bodyid[g]) for g in places}), int)
        self._met = list(geoms)
        self._arrays = {name: getattr(model, name)[self._geoms].copy() for name in _GEOMS}
        self._arrays |= {name: getattr(model, name)[self._bodies].copy() for name in _BODIES}
        self._rest = self._digests(model)

    def check_shapes(self, model: mujoco.MjModel) -> None:
        """Check the geoms alone, which takes microseconds."""
        for name in _SHAPES:
            self._compare(model, name, self._geoms)

    def check(self, model: mujoco.MjModel, geoms: Sequence[int]) -> None:
        """Check everything; `geoms` are the ids that the sand's selection matches now."""
        for name in _GEOMS:
            self._compare(model, name, self._geoms)
        for name in _BODIES:
            self._compare(model, name, self._bodies)
        now = self._digests(model)
        changed = [name for name, digest in self._rest.items() if now[name] != digest]
        if changed:
            raise _changed(changed[0])
        if list(geoms) != self._met:
            geom = min(set(geoms) ^ set(self._met))
            raise _changed(f"whether geom {geom_name(model, geom)} meets the sand")

    def _compare(self, model: mujoco.MjModel, name: str, rows: np.ndarray) -> None:
        then, now = self._arrays[name], getattr(model, name)[rows]
        if not np.array_equal(then, now):
            row = int(np.argwhere(then != now)[0][0])
            kind = name.partition("_")[0]
            number = int(rows[row])
            whose = geom_name(model, number) if kind == "geom" else body_name(model, number)
            raise _changed(f"{name} of {kind} {whose} ({then[row]} then, {now[row]} now)")

    def _digests(self, model: mujoco.MjModel) -> dict[str, bytes]:
        kinds = model.geom_type[self._geoms]
        meshes = _MESHES if mujoco.mjtGeom.mjGEOM_MESH in kinds else ()
        fields = _FIELDS if mujoco.mjtGeom.mjGEOM_HFIELD in kinds else ()
        names = (*_JOINTS, *meshes, *fields)
        return {name: hashlib.blake2b(getattr(model, name).tobytes()).digest() for name in names}


def _changed(what: str) -> InputError:
    return InputError(
        f"{what} was changed after Sand was made, whose elements are those of before: make another"
    )
