"""Checks for changes of a model after its sand was made."""

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from mjgranular.errors import InputError

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
        self._met = list(geoms)
        self.geoms = every = sorted({*geoms, *places})
        bodies = {int(model.geom_bodyid[geom]) for geom in geoms}
        inner = {body for body in bodies if model.body_parentid[body] != 0}
        inner |= {int(model.geom_bodyid[geom]) for geom in places}
        kinds = model.geom_type[every]
        meshes = _MESHES if mujoco.mjtGeom.mjGEOM_MESH in kinds else ()
        fields = _FIELDS if mujoco.mjtGeom.mjGEOM_HFIELD in kinds else ()
        self._rows = {
            **dict.fromkeys(_GEOMS, np.array(every, int)),
            **dict.fromkeys(_BODIES, np.array(sorted(inner), int)),
            **dict.fromkeys((*_JOINTS, *meshes, *fields), slice(None)),
        }
        self._then = {name: getattr(model, name)[rows].copy() for name, rows in self._rows.items()}

    def check_shapes(self, model: mujoco.MjModel) -> None:
        """Check the geoms alone, which takes microseconds."""
        self._check(model, _SHAPES)

    def check(self, model: mujoco.MjModel, geoms: Sequence[int]) -> None:
        """Check everything; `geoms` are the ids that the sand's selection matches now."""
        self._check(model, self._rows)
        if list(geoms) != self._met:
            raise _changed("the selection of geoms that meet the sand")

    def _check(self, model: mujoco.MjModel, names: Iterable[str]) -> None:
        for name in names:
            if not np.array_equal(self._then[name], getattr(model, name)[self._rows[name]]):
                raise _changed(f"{name} of the model")


def _changed(what: str) -> InputError:
    return InputError(
        f"{what} was changed after Sand was made, whose elements are those of before: make another"
    )
