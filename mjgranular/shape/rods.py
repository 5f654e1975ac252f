"""Slender bodies as rods: one element for each capsule or cylinder, from pole to pole."""

from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular._util.checks import check_count
from mjgranular.errors import InputError
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

_CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
_CYLINDER = int(mujoco.mjtGeom.mjGEOM_CYLINDER)


def rods_from_model(model: mujoco.MjModel, geoms: Sequence[int]) -> np.ndarray:
    """Make one rod for each geom: a capsule or cylinder. Shape (n,), dtype `ROD_DTYPE`.

    A capsule's rod extends from pole to pole, as the length of the paper's link does.
    """
    rods = np.zeros(len(geoms), ROD_DTYPE)
    rods["geom"] = geoms
    sizes.set_bodies(model, rods)
    for rod, geom in zip(rods, geoms, strict=True):
        kind = int(model.geom_type[geom])
        if kind not in (_CAPSULE, _CYLINDER):
            raise InputError(
                f"geom {sizes.geom_name(model, geom)} is a {sizes.geom_type(model, geom)}: the "
                f"link law acts on slender bodies, capsules and cylinders; {CHOOSE}; or take a "
                "medium whose own law takes every shape, such as quikrete_medium"
            )
        sizes.check_size(model, geom)
        radius, half = model.geom_size[geom][:2]
        rod["center"] = model.geom_pos[geom]
        rod["axis"] = sizes.geom_axes(model, geom)[:, 2]
        rod["half_length"] = half + (radius if kind == _CAPSULE else 0.0)
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
