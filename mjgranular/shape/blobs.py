"""Whole bodies: center and support function of each geom, for laws with one force per body."""

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import norm, transposed, vector
from mjgranular.shape import sizes

BLOB_DTYPE = np.dtype(
    [
        *sizes.PART_FIELDS,
        ("center", np.float64, (3,)),  # [m], body frame
        ("axes", np.float64, (9,)),  # rotation matrix of the geom in the body frame, row by row
        ("radii", np.float64, (3,)),  # of the ellipsoidal part [m]
        ("halves", np.float64, (3,)),  # half extents of the box that this part is swept along [m]
        ("disc", np.float64),  # radius of a disc across z [m]
        ("width", np.float64),  # of the geom, for Froude numbers [m]
    ]
)

_GEOM = mujoco.mjtGeom


def blobs_from_model(model: mujoco.MjModel, geoms: Sequence[int]) -> np.ndarray:
    """Make one blob for each geom; a mesh counts as the box around it.

    They are ordered by body, shape (n,), dtype `BLOB_DTYPE`. A type of geom that has no volume, and
    a size that is zero or beyond numerical limits, are errors.
    """
    blobs = np.zeros(len(geoms), BLOB_DTYPE)
    blobs["geom"] = sorted(geoms, key=lambda g: (int(model.geom_bodyid[g]), g))
    sizes.set_bodies(model, blobs)
    for blob, geom in zip(blobs, blobs["geom"].tolist(), strict=True):
        blob["center"] = model.geom_pos[geom]
        blob["axes"] = sizes.geom_axes(model, geom).ravel()
        blob["width"] = sizes.geom_width(model, geom)
        _set_support(model, geom, blob)
    return blobs


def _set_support(model: mujoco.MjModel, geom: int, blob: np.void) -> None:
    kind = _GEOM(int(model.geom_type[geom]))
    half = sizes.half_extents(model, geom)
    sizes.check_size(model, geom)
    if kind in (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_ELLIPSOID):
        blob["radii"] = half
    elif kind == _GEOM.mjGEOM_CAPSULE:
        blob["radii"] = half[0]
        blob["halves"] = 0.0, 0.0, half[2] - half[0]
    elif kind == _GEOM.mjGEOM_CYLINDER:
        blob["disc"] = half[0]
        blob["halves"] = 0.0, 0.0, half[2]
    elif kind in (_GEOM.mjGEOM_BOX, _GEOM.mjGEOM_MESH):
        blob["halves"] = half
        if kind == _GEOM.mjGEOM_MESH:
            blob["center"] += blob["axes"].reshape(3, 3) @ model.geom_aabb[geom, :3]
    else:
        raise sizes.type_error(model, geom)


@compiled
def support(blob, along):
    """Return a blob's extent from its center in a direction, a vector in the body frame [m]."""
    u = transposed(blob.axes) @ along
    r, h = blob.radii, blob.halves
    reach = norm(vector(r.x * u.x, r.y * u.y, r.z * u.z)) + blob.disc * math.sqrt(
        u.x * u.x + u.y * u.y
    )
    return reach + h.x * abs(u.x) + h.y * abs(u.y) + h.z * abs(u.z)
