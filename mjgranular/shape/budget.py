"""How finely each geom is cut where nobody says: all alike, until they are too many.

A robot may have forty geoms, and most of them are small. Beyond a number of facets that a step has
the time for, geoms share it by their skins: facets become alike in size, and none finer than the
measured default.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.shape.sizes import half_extents

RESOLUTION = 12
"""Rings from pole to pole of a round geom; other parts of a skin in a measured proportion. The
smallest with which the total force on every primitive that was tried is within 2 % of that on a
fine mesh (tests/test_facets.py, docs/shapes.md)."""

FACETS = 4000
"""Of all geoms together by default, about. Chosen: Gymnasium's robots have fewer at `RESOLUTION`,
and a humanoid of forty meshes takes some three times as long with so many as without sand."""

_ALIKE = 1.02  # sizes that differ by less are alike; chosen
_LEAST = 4  # a sphere of 24 facets; coarser ones are no spheres
_OF_A_MESH, _OF_OTHERS = 2.0, 4 / 3  # facets at most, over the square of the resolution


def resolutions(model: mujoco.MjModel, geoms: Sequence[int]) -> list[int]:
    """A resolution for each geom, so that there are about `FACETS` facets or fewer.

    Args:
        model: the model.
        geoms: ids of all geoms that meet the sand.
    """
    meshes = model.geom_type[list(geoms)] == int(mujoco.mjtGeom.mjGEOM_MESH)
    weights = np.where(meshes, _OF_A_MESH, _OF_OTHERS)
    if weights.sum() * RESOLUTION**2 <= FACETS:
        return [RESOLUTION] * len(geoms)
    # Sizes that are none are told of later. Those there are, as shares of the largest.
    half = np.nan_to_num([np.abs(half_extents(model, geom)) for geom in geoms])
    half /= max(half.max(), np.finfo(float).tiny)
    size = np.sqrt((half * np.roll(half, 1, axis=1)).sum(axis=1))  # root of the skin of its box

    def cut(facet: float) -> np.ndarray:
        return np.clip(size / facet, _LEAST, RESOLUTION).astype(int)

    fine, coarse = 1e-9, 1.0
    for _ in range(60):
        middle = (fine * coarse) ** 0.5
        if weights @ cut(middle) ** 2 > FACETS:
            fine = middle
        else:
            coarse = middle
    # Left and right of a robot differ by little: what is that near to a bound stays together.
    return cut(_ALIKE * coarse).tolist()
