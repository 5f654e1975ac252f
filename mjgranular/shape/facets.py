"""Bodies as skins: the facets of their geoms, for laws that act on surface elements."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.errors import GranularWarning, InputError
from mjgranular.kernel.memory import records
from mjgranular.shape import tessellation
from mjgranular.shape.tessellation import Facets

FACET_DTYPE = np.dtype(
    [
        ("geom", np.int64),
        ("body", np.int64),
        ("slot", np.int64),  # row of the body in the binding's table of bodies
        ("point", np.float64, (3,)),  # centroid [m], body frame
        ("normal", np.float64, (3,)),  # unit, outward, body frame
        ("area", np.float64),  # [m^2]
        ("width", np.float64),  # of the geom, for Froude numbers [m]
    ]
)
facet_records = records(FACET_DTYPE)

RESOLUTION = 8
"""Patches from pole to pole of a round geom, or along a box's longest edge. Against a fine mesh the
total force is within 2 % in the median, 12 % at worst where the leading edge or the surface cuts
facets (tests/test_facets.py, docs/shapes.md)."""

_GEOM = mujoco.mjtGeom


def facets_from_model(
    model: mujoco.MjModel, geoms: Sequence[int], resolution: int = RESOLUTION
) -> np.ndarray:
    """Cuts geoms into facets.

    Capsule, sphere, cylinder, ellipsoid and box are cut into patches of their true skin; a mesh
    gives its own triangles, whether it is convex or not.

    Args:
        model: the model.
        geoms: geom ids.
        resolution: patches from pole to pole of a round geom, or along a box's longest edge.

    Returns:
        Facets, ordered by body, shape (n,), dtype `FACET_DTYPE`.

    Raises:
        InputError: a geom of another type, of size zero, or a mesh without faces; a resolution
            below 2.

    Warns:
        GranularWarning: a mesh is not watertight, says how many open edges it has; or is inside
            out, and then is turned round.
    """
    if resolution < 2:
        raise InputError(f"the resolution must be at least 2, not {resolution}")
    slots: dict[int, int] = {}
    parts = []
    for geom in sorted(geoms, key=lambda g: (int(model.geom_bodyid[g]), g)):
        skin = _skin(model, geom, resolution)
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        rotation = rotation.reshape(3, 3)
        part = np.zeros(len(skin), FACET_DTYPE)
        body = int(model.geom_bodyid[geom])
        part["geom"] = geom
        part["body"] = body
        part["slot"] = slots.setdefault(body, len(slots))
        part["point"] = skin.points @ rotation.T + model.geom_pos[geom]
        part["normal"] = skin.normals @ rotation.T
        part["area"] = skin.areas
        part["width"] = geom_width(model, geom)
        parts.append(part)
    return np.concatenate(parts)


def geom_width(model: mujoco.MjModel, geom: int) -> float:
    """Width of a geom: its second largest extent [m], a rod's diameter, a plate's shorter side."""
    return float(np.sort(2 * half_extents(model, geom))[1])


def half_extents(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Half extents of a geom along its own axes [m], shape (3,)."""
    size = model.geom_size[geom]
    kind = int(model.geom_type[geom])
    if kind == _GEOM.mjGEOM_SPHERE:
        return np.full(3, size[0])
    if kind == _GEOM.mjGEOM_CAPSULE:
        return np.array([size[0], size[0], size[1] + size[0]])
    if kind == _GEOM.mjGEOM_CYLINDER:
        return np.array([size[0], size[0], size[1]])
    if kind == _GEOM.mjGEOM_MESH:
        return model.geom_aabb[geom, 3:]
    return size


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """A geom's name in quotes, or its number."""
    name = model.geom(geom).name
    return repr(name) if name else f"number {geom}"


def _skin(model: mujoco.MjModel, geom: int, resolution: int) -> Facets:
    kind = int(model.geom_type[geom])
    if kind == _GEOM.mjGEOM_MESH:
        return _mesh_skin(model, geom)
    shapes = {
        _GEOM.mjGEOM_SPHERE: lambda s: tessellation.ellipsoid((s[0], s[0], s[0]), resolution),
        _GEOM.mjGEOM_ELLIPSOID: lambda s: tessellation.ellipsoid((s[0], s[1], s[2]), resolution),
        _GEOM.mjGEOM_CAPSULE: lambda s: tessellation.capsule(s[0], s[1], resolution),
        _GEOM.mjGEOM_CYLINDER: lambda s: tessellation.cylinder(s[0], s[1], resolution),
        _GEOM.mjGEOM_BOX: lambda s: tessellation.box((s[0], s[1], s[2]), resolution),
    }
    shape = shapes.get(_GEOM(kind))
    if shape is None:
        word = _GEOM(kind).name.removeprefix("mjGEOM_").lower()
        raise InputError(
            f"geom {geom_name(model, geom)} is a {word}: sand acts on capsules, spheres, "
            "cylinders, ellipsoids, boxes and meshes"
        )
    if not (half_extents(model, geom) > 0).all():
        raise InputError(f"geom {geom_name(model, geom)} has a size of zero: it needs a volume")
    return shape(model.geom_size[geom])


def _mesh_skin(model: mujoco.MjModel, geom: int) -> Facets:
    mesh = int(model.geom_dataid[geom])
    if mesh < 0 or model.mesh_facenum[mesh] == 0:
        raise InputError(f"the mesh of geom {geom_name(model, geom)} has no faces")
    first = int(model.mesh_vertadr[mesh])
    vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])].astype(float)
    start = int(model.mesh_faceadr[mesh])
    faces = model.mesh_face[start : start + int(model.mesh_facenum[mesh])]
    gaps = open_edges(vertices, faces)
    if gaps:
        warnings.warn(
            f"the mesh of geom {geom_name(model, geom)} is not watertight, it has {gaps} open "
            "edges: its faces act as they are, each on its outer side",
            GranularWarning,
            stacklevel=2,
        )
    skin = tessellation.triangles(vertices[faces])
    if len(skin) == 0:
        raise InputError(f"the mesh of geom {geom_name(model, geom)} has no face with an area")
    if not gaps and (skin.points * skin.normals).sum(axis=1) @ skin.areas < 0:
        warnings.warn(
            f"the mesh of geom {geom_name(model, geom)} is inside out: its faces are turned round",
            GranularWarning,
            stacklevel=2,
        )
        return Facets(skin.points, -skin.normals, skin.areas)
    return skin


def open_edges(vertices: np.ndarray, faces: np.ndarray) -> int:
    """Number of edges of a triangle mesh that do not belong to two faces.

    Vertices at the same place count as one: MuJoCo splits vertices where normals or textures do.
    """
    _, merged = np.unique(vertices, axis=0, return_inverse=True)
    corners = merged.reshape(-1)[faces]
    edges = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges = edges[edges[:, 0] != edges[:, 1]]
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return int((counts % 2 == 1).sum())
