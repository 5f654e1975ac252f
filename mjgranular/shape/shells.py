"""The shells of a mesh: closed ones face outward, and hide what of the others is inside them."""

from functools import partial

import mujoco
import numpy as np

from mjgranular.errors import InputError, warn_user
from mjgranular.kernel.compiled import compiled, entry
from mjgranular.kernel.vector import cross, dot, read_vector
from mjgranular.shape.sizes import check_size, geom_name

_TOUCH = 1e-6  # what is closer, as a share of the mesh, coincides; chosen: rounding
_NEARLY_CLOSED = 0.1  # sum of area vectors over that of areas, at most; chosen


def mesh_arrays(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the model's arrays of the vertices and faces of a geom's mesh, in the geom's frame."""
    mesh = int(model.geom_dataid[geom])
    if mesh < 0 or model.mesh_facenum[mesh] == 0:
        raise InputError(f"the mesh of geom {geom_name(model, geom)} has no faces")
    first, start = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]
    return vertices, model.mesh_face[start : start + int(model.mesh_facenum[mesh])]


def mesh_faces(
    model: mujoco.MjModel, geom: int, *, warn: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the faces of a geom's mesh, counter-clockwise seen from outside.

    A closed shell that is inside out is turned round, if it is not a cavity in another, and so is
    what is not closed, all together, if it nearly is; with a warning. So is there one of a mesh
    that is not watertight.

    Returns:
        Vertices [m], in the frame of the geom, shape (m, 3); those of each face, shape (n, 3); and
        the number of its closed shell, less than n, or n, shape (n,).
    """
    vertices, faces = mesh_arrays(model, geom)
    check_size(model, geom, flat=True)
    vertices, name = vertices.astype(float), geom_name(model, geom)
    shells, gaps = _shells(vertices, faces)
    if warn and gaps:
        warn_user(
            f"the mesh of geom {name} is not watertight, it has {gaps} open edges, or edges of "
            "faces turned opposite ways: each face acts on its outer side"
        )
    corners = vertices[faces]
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if not vectors.any():
        raise InputError(f"the mesh of geom {name} has no face with an area")

    def total(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(shells, column) for column in values.T], axis=1)

    middles = corners.mean(axis=1)
    away = middles - (total(middles) / np.maximum(np.bincount(shells), 1)[:, None])[shells]
    areas = np.bincount(shells, np.linalg.norm(vectors, axis=1))
    inward = np.linalg.norm(total(vectors), axis=1) < _NEARLY_CLOSED * areas
    least = -_TOUCH * np.ptp(vertices, axis=0).max() * areas
    inward &= np.bincount(shells, (away * vectors).sum(axis=1)) < least
    turned = inward[shells]
    cavity = within_others(corners[turned], shells[turned], corners, shells)
    turned &= np.bincount(shells[turned], ~cavity, len(faces) + 1)[shells] > 0
    if warn and turned.any():
        what = "the mesh" if turned.all() else "a shell of the mesh"
        warn_user(f"{what} of geom {name} is inside out: its faces are turned round")
    return vertices, np.where(turned[:, None], faces[:, ::-1], faces), shells


def _shells(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the shell of each face, as of `mesh_faces`, and the number of open edges.

    Faces that share an edge are of one shell. An edge is open if not as many faces run along it one
    way as the other. Vertices that MuJoCo has split, at the same position, count as one.
    """
    places = np.round(vertices / (_TOUCH * np.ptp(vertices, axis=0).max()))
    _, merged = np.unique(places, axis=0, return_inverse=True)
    edges = merged.reshape(-1)[faces][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    ways = np.sign(edges[:, 1] - edges[:, 0])
    _, edge = np.unique(np.sort(edges, axis=1) @ [len(vertices), 1], return_inverse=True)
    is_open, edge = np.bincount(edge, ways) != 0, edge.reshape(-1, 3)
    # The least number of a face spreads over edges, and from face to face of the same number.
    shells, before = np.arange(len(faces)), faces[:0]
    while not np.array_equal(shells, before):
        before, least = shells, np.full(len(is_open), len(faces))
        np.minimum.at(least, edge, before[:, None])
        shells = least[edge].min(axis=1)
        np.minimum.at(shells, before, shells.copy())
        shells = shells[shells]
    gaps = np.bincount(shells, is_open[edge].any(axis=1))[shells] > 0
    return np.where(gaps, len(faces), shells), int(is_open.sum())


def within_others(
    corners: np.ndarray, own: np.ndarray, whole: np.ndarray, shells: np.ndarray
) -> np.ndarray:
    """Return which triangles, of shells `own`, are inside closed shells other than these.

    Where two shells coincide and face the same way, the first is kept; if they face each other,
    none. `whole` and `shells` are of all faces of the mesh, as of `mesh_faces`.
    """
    found = np.zeros(len(corners), bool)
    if (shells == shells[0]).all():
        return found
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.maximum(np.linalg.norm(vectors, axis=1), 1e-300)
    step = _TOUCH * np.ptp(whole, axis=(0, 1)).max() * vectors / areas[:, None]
    find = entry(_add_crossings, "void(float64[:, ::1], float64[:, :, ::1], int64[::1])")
    for side in (1, -1):  # outside of the triangles, and inside, which counts for later shells
        points = corners.mean(axis=1) + side * step
        order = points[:, 1].argsort()
        along = points[order, 1]
        for shell in np.unique(shells[shells < len(shells)]):
            faces = whole[shells == shell]
            begin, end = along.searchsorted([faces[:, :, 1].min(), faces[:, :, 1].max()])
            rows = order[begin:end]
            rows = rows[own[rows] != shell if side > 0 else own[rows] > shell]
            crossings = np.zeros(len(rows), np.int64)
            find(points[rows], faces, crossings)
            found[rows] |= crossings != 0
    return found


@compiled
def _add_crossings(points, faces, crossings):
    """Add how often a shell crosses the line up from each point: outward 1, inward -1.

    The points are in the order of y.
    """
    for face in faces:
        a, b, c = read_vector(face[0], 0), read_vector(face[1], 0), read_vector(face[2], 0)
        for i in range(np.searchsorted(points[:, 1], min(a.y, b.y, c.y)), len(points)):
            p = read_vector(points[i], 0)
            if p.y > max(a.y, b.y, c.y):
                break
            turn = _half_turn(a, b, p) + _half_turn(b, c, p) + _half_turn(c, a, p)
            if dot(a - p, cross(b - a, c - a)) * turn > 0:
                crossings[i] += turn


@partial(compiled, inline=True)
def _half_turn(a, b, p):
    """Return 1 if an edge passes a point on its right, seen from above, upward in y, -1 downward.

    To rounding this is the same for the faces on both sides of it.
    """
    up = int(a.y <= p.y) - int(b.y <= p.y)
    low, high = (a, b) if up > 0 else (b, a)
    is_right = (high.x - low.x) * (p.y - low.y) > (p.x - low.x) * (high.y - low.y)
    return up if is_right else 0
