"""Default resolution of each geom: the same for all, until there are too many facets.

A robot may have forty geoms, most of them small. Beyond a number of facets that a step has time
for, geoms share it by their surface area: facets become similar in size, and none finer than the
measured default.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.shape.sizes import half_extents

RESOLUTION = 12
"""Rings from pole to pole of a round geom; other parts of a surface in a measured proportion. It is
the smallest with which the total force on every tested primitive is within 2 % of that on a fine
mesh (tests/test_facets.py, docs/shapes.md)."""

FACETS = 4000
"""Approximate default number of facets of all geoms together. Chosen: Gymnasium's robots have fewer
at `RESOLUTION`, and with this number a humanoid of forty meshes takes about three times as long as
without sand."""

_ALIKE = 1.02  # sizes that differ by less count as equal; chosen
_LEAST = 4  # a sphere of 24 facets; coarser ones are not spheres
_OF_A_MESH, _OF_OTHERS = 2.0, 4 / 3  # maximum number of facets, over the square of the resolution


def resolutions(model: mujoco.MjModel, geoms: Sequence[int]) -> list[int]:
    """Return a resolution for each geom, so that there are about `FACETS` facets or fewer."""
    meshes = model.geom_type[list(geoms)] == int(mujoco.mjtGeom.mjGEOM_MESH)
    weights = np.where(meshes, _OF_A_MESH, _OF_OTHERS)
    if weights.sum() * RESOLUTION**2 <= FACETS:
        return [RESOLUTION] * len(geoms)
    # Invalid sizes are reported later. Valid ones, relative to the largest.
    half = np.nan_to_num([np.abs(half_extents(model, geom)) for geom in geoms])
    half /= max(half.max(), np.finfo(float).tiny)
    size = np.sqrt((half * np.roll(half, 1, axis=1)).sum(axis=1))  # root of the surface of its box

    def cut(facet: float) -> np.ndarray:
        return np.clip(size / facet, _LEAST, RESOLUTION).astype(int)

    fine, coarse = 1e-9, 1.0
    for _ in range(60):
        middle = (fine * coarse) ** 0.5
        if weights @ cut(middle) ** 2 > FACETS:
            fine = middle
        else:
            coarse = middle
    # Left and right of a robot differ slightly: sizes that near to a bound stay together.
    return cut(_ALIKE * coarse).tolist()
