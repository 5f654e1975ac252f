"""One element for each geom: a rod, from pole to pole, or a blob, with a support function."""

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular._util.checks import check_count
from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import norm, transposed, vector
from mjgranular.shape import sizes

CHOOSE = "choose them with geoms=[...] or bodies=[...]"
"""Advice for Python, which the command line replaces by its own."""

ROD_DTYPE = np.dtype(
    [
        *sizes.PART_FIELDS,
        ("center", np.float64, (3,)),  # midpoint [m], body frame
        ("axis", np.float64, (3,)),  # unit vector along the rod, body frame
        ("half_length", np.float64),  # [m], including round ends
        ("width", np.float64),  # diameter [m]
    ]
)

MOST_PIECES = 10_000  # maximum number of pieces per rod; chosen: far more than accuracy needs

_GEOM = mujoco.mjtGeom


def rods_from_model(model: mujoco.MjModel, geoms: Sequence[int]) -> np.ndarray:
    """Make one rod for each geom: a capsule or cylinder. Shape (n,), dtype `ROD_DTYPE`.

    A capsule's rod extends from pole to pole, as the length of the paper's link does.
    """
    rods = np.zeros(len(geoms), ROD_DTYPE)
    rods["geom"] = geoms
    sizes.set_bodies(model, rods)
    for rod, geom in zip(rods, geoms, strict=True):
        kind = int(model.geom_type[geom])
        if kind not in (_GEOM.mjGEOM_CAPSULE, _GEOM.mjGEOM_CYLINDER):
            raise InputError(
                f"geom {sizes.geom_name(model, geom)} is a {sizes.geom_type(model, geom)}: the "
                f"link law acts on slender bodies, capsules and cylinders; {CHOOSE}; or take a "
                "medium whose own law takes every shape, such as quikrete_medium"
            )
        sizes.check_size(model, geom)
        radius, half = model.geom_size[geom][:2]
        rod["center"] = model.geom_pos[geom]
        rod["axis"] = sizes.geom_axes(model, geom)[:, 2]
        rod["half_length"] = half + (radius if kind == _GEOM.mjGEOM_CAPSULE else 0.0)
        rod["width"] = 2 * radius
    return rods


def cut_rods(rods: np.ndarray, pieces: int) -> np.ndarray:
    """Divide every rod into a number of pieces of equal length, each a rod, shape (n * pieces,)."""
    check_count("the resolution", pieces, 1, MOST_PIECES)
    pieces = int(pieces)
    sizes.check_count(len(rods) * pieces)
    cut = np.repeat(rods, pieces)
    # Centers of the pieces along the axis, in half-lengths: symmetric to the last bit.
    index = np.arange(pieces)
    along = np.tile((2 * index - (pieces - 1)) / pieces, len(rods))
    cut["center"] += (along * cut["half_length"])[:, None] * cut["axis"]
    cut["half_length"] /= pieces
    return cut


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
