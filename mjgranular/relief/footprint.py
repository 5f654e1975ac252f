"""Footprints: the skin by which bodies press sand down, as points no farther apart than cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from mjgranular.kernel.lanes import aligned
from mjgranular.relief.memory import WINDOW, Memory
from mjgranular.shape import facets_from_model
from mjgranular.shape.sizes import check_count, geom_width, half_extents

POINT_DTYPE = np.dtype(
    [
        ("point", np.float64, (3,)),  # [m], body frame
        ("normal", np.float64, (3,)),  # unit, outward; of a rod's axis every one, so none: zero
    ]
)
FOOT_DTYPE = np.dtype(
    [
        ("body", np.int64),
        ("end", np.int64),  # one past its last tile of points
        ("middle", np.float64, (3,)),  # of the box around its points [m], body frame
        ("half", np.float64, (3,)),  # half the extents of that box [m]
    ]
)


LANES = 8
"""Points that are looked at side by side, a tile."""

TILE = 6 * LANES
"""Numbers of a tile: each of a point's and a normal's for all points in turn."""

_BESIDE = 0.5  # what is remembered beyond the bodies themselves, both sides together [m]; chosen


@dataclass(frozen=True)
class Footprint:
    """Points of the skin, geom by geom.

    Attributes:
        points: tiles, shape (n, 6, LANES); the last of a geom is filled up with its last point.
        feet: rows of `FOOT_DTYPE`, one for each geom, body by body.
    """

    points: np.ndarray
    feet: np.ndarray


def surroundings_of(model: mujoco.MjModel, geoms: Sequence[int], memory: Memory) -> float:
    """How far around a place sand counts for its level [m].

    Args:
        model: the model.
        geoms: ids of those that meet the sand.
        memory: which may say so itself.
    """
    if memory.surroundings is not None:
        return memory.surroundings
    return max(geom_width(model, geom) for geom in geoms) + 4 * memory.cell


def fitting(model: mujoco.MjModel, geoms: Sequence[int], memory: Memory) -> Memory:
    """A memory that reaches as far as a model needs, unless it says itself how far it reaches.

    It needs room for the surroundings of its widest geom, and for all that meets the sand, where
    the model stands as it is (qpos0), with a quarter of a metre on each side.

    Args:
        model: the model.
        geoms: ids of those that meet the sand.
        memory: its memory.
    """
    needed = WINDOW * surroundings_of(model, geoms, memory), spread_of(model, geoms) + _BESIDE
    return memory.reaching(max(needed))


def spread_of(model: mujoco.MjModel, geoms: Sequence[int]) -> float:
    """How far apart geoms reach along x or y, where the model stands as it is (qpos0) [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    axes = data.geom_xmat[list(geoms)].reshape(-1, 3, 3)
    half = np.stack([half_extents(model, geom) for geom in geoms])
    reach = (np.abs(axes) @ half[:, :, None])[:, :2, 0]
    place = data.geom_xpos[list(geoms)][:, :2]
    return float(((place + reach).max(axis=0) - (place - reach).min(axis=0)).max())


def footprint_of(
    model: mujoco.MjModel, geoms: Sequence[int], elements: np.ndarray, cell: float
) -> Footprint:
    """The footprint of the geoms that meet the sand.

    It is where a law's elements look for sand: the axis of a rod, the skin of all else.

    Args:
        model: the model.
        geoms: their ids.
        elements: of the law.
        cell: side of a cell [m].

    Raises:
        InputError: more points than there is room for.
    """
    names = elements.dtype.names or ()
    if "half_length" in names:
        parts = [(int(rod["geom"]), _on_rod(rod, cell)) for rod in elements]
    else:
        facets = elements if "edges" in names else facets_from_model(model, geoms)
        parts = [(int(facet["geom"]), _on_facet(facet, cell)) for facet in facets]
        meshes = [g for g in geoms if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH]
        # Facets of a mesh do not tell how far they reach.
        parts += [(geom, _on_mesh(model, geom, cell)) for geom in meshes]
    points, feet, count = [], [], 0
    for geom in dict.fromkeys(elements["geom"].tolist()):
        mine = [part for owner, part in parts if owner == geom]
        here = np.concatenate(mine)
        points.append(_in_tiles(here))
        count += len(points[-1])
        check_count(LANES * count)
        low, high = here["point"].min(axis=0), here["point"].max(axis=0)
        feet.append((model.geom_bodyid[geom], count, (low + high) / 2, (high - low) / 2))
    return Footprint(aligned(np.concatenate(points)), np.array(feet, FOOT_DTYPE))


def _in_tiles(points: np.ndarray) -> np.ndarray:
    """Points as kernels read them, shape (n, 6, LANES)."""
    points = np.concatenate([points, np.repeat(points[-1:], -len(points) % LANES)])
    numbers = np.concatenate([points["point"], points["normal"]], axis=1)
    return numbers.reshape(-1, LANES, 6).transpose(0, 2, 1)


def _on_rod(rod: np.void, cell: float) -> np.ndarray:
    half = float(rod["half_length"])
    count = max(math.ceil(2 * half / cell), 1) + 1  # both ends included
    points = np.zeros(count, POINT_DTYPE)
    points["point"] = rod["center"] + np.linspace(-half, half, count)[:, None] * rod["axis"]
    return points


def _on_facet(facet: np.void, cell: float) -> np.ndarray:
    edges = facet["edges"]
    s, t = (_middles(2 * float(np.linalg.norm(edge)), cell) for edge in edges)
    s, t = (part.ravel()[:, None] for part in np.meshgrid(s, t))
    normals = facet["normal"] + s * facet["spread"][0] + t * facet["spread"][1]
    points = np.zeros(len(s), POINT_DTYPE)
    points["point"] = facet["point"] + s * edges[0] + t * edges[1]
    points["normal"] = normals / np.linalg.norm(normals, axis=1)[:, None]
    return points


def _middles(length: float, cell: float) -> np.ndarray:
    """Middles of equal parts of a length, no longer than a cell, from -1 to 1."""
    count = max(math.ceil(length / cell - 1e-9), 1)
    return (2 * np.arange(count) + 1) / count - 1


def _on_mesh(model: mujoco.MjModel, geom: int, cell: float) -> np.ndarray:
    """Middles of the triangles of a mesh, cut until none is longer than a cell."""
    mesh = int(model.geom_dataid[geom])
    first, start = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    faces = model.mesh_face[start : start + int(model.mesh_facenum[mesh])]
    corners = model.mesh_vert[first:][faces].astype(float)
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = -1.0 if (corners.mean(axis=1) * areas).sum() < 0 else 1.0  # or it is inside out
    places, normals = [], []
    for corner, area in zip(corners, areas, strict=True):
        size = float(np.linalg.norm(area))
        if size == 0.0:
            continue
        edges = corner - np.roll(corner, 1, axis=0)
        weights = _in_triangle(math.ceil(np.linalg.norm(edges, axis=1).max() / cell - 1e-9))
        places.append(weights @ corner)
        normals.append(np.broadcast_to(outward * area / size, places[-1].shape))
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    points = np.zeros(sum(map(len, places)), POINT_DTYPE)
    turned = rotation.reshape(3, 3).T
    points["point"] = np.concatenate(places) @ turned + model.geom_pos[geom]
    points["normal"] = np.concatenate(normals) @ turned
    return points


@cache
def _in_triangle(parts: int) -> np.ndarray:
    """Weights of a triangle's corners for the middles of the parts of it, each edge cut in so many.

    Returns:
        Shape (parts^2, 3).
    """
    upright = [(a + 1 / 3, b + 1 / 3) for a in range(parts) for b in range(parts - a)]
    hanging = [(a + 2 / 3, b + 2 / 3) for a in range(parts) for b in range(parts - a - 1)]
    first, second = np.array(upright + hanging).T / parts
    return np.stack([first, second, 1 - first - second], axis=1)
