"""Triangles of the meshes of a model, as the sand meets them."""

from __future__ import annotations

import mujoco
import numpy as np

from mjgranular.errors import InputError, warn_user
from mjgranular.shape.sizes import check_size, geom_name


def mesh_corners(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Return corners of the triangles of a geom's mesh [m], in the geom's frame, shape (n, 3, 3).

    They are counter-clockwise seen from outside: a mesh that is inside out is flipped, with a
    warning. There is one too for a mesh that is not watertight, with the number of its open edges.
    """
    mesh = int(model.geom_dataid[geom])
    if mesh < 0 or model.mesh_facenum[mesh] == 0:
        raise InputError(f"the mesh of geom {geom_name(model, geom)} has no faces")
    check_size(model, geom, flat=True)
    first = int(model.mesh_vertadr[mesh])
    vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])].astype(float)
    start = int(model.mesh_faceadr[mesh])
    faces = model.mesh_face[start : start + int(model.mesh_facenum[mesh])]
    gaps = open_edges(vertices, faces)
    if gaps:
        warn_user(
            f"the mesh of geom {geom_name(model, geom)} is not watertight, it has {gaps} open "
            "edges: its faces act as they are, each on its outer side"
        )
    corners = vertices[faces]
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if not vectors.any():
        raise InputError(f"the mesh of geom {geom_name(model, geom)} has no face with an area")
    if not gaps and (corners.mean(axis=1) * vectors).sum() < 0:
        warn_user(
            f"the mesh of geom {geom_name(model, geom)} is inside out: its faces are turned round"
        )
        return corners[:, ::-1]
    return corners


def open_edges(vertices: np.ndarray, faces: np.ndarray) -> int:
    """Count the edges of a triangle mesh that do not belong to two faces.

    Vertices at the same position count as one: MuJoCo splits vertices where normals or textures
    differ.
    """
    _, merged = np.unique(vertices, axis=0, return_inverse=True)
    corners = merged.reshape(-1)[faces]
    edges = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges = edges[edges[:, 0] != edges[:, 1]]
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return int((counts % 2 == 1).sum())
