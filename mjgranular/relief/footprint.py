"""Footprints: points on the surface of bodies that press sand down, at most a cell apart."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import mujoco
import numpy as np

from mjgranular.kernel.lanes import aligned
from mjgranular.relief.memory import WINDOW, Memory
from mjgranular.shape.shells import mesh_faces
from mjgranular.shape.sizes import check_count, data_at_start, geom_axes, geom_width, half_extents

POINT_DTYPE = np.dtype(
    [
        ("point", np.float64, (3,)),  # [m], body frame
        ("normal", np.float64, (3,)),  # unit, outward; zero for a rod's axis, which has none
    ]
)
FOOT_DTYPE = np.dtype(
    [
        ("body", np.int64),
        ("end", np.int64),  # one past its last tile of points
        ("middle", np.float64, (3,)),  # center of the box around its points [m], body frame
        ("half", np.float64, (3,)),  # half the extents of that box [m]
        ("far", np.float64),  # the farthest that a point may be from the body frame [m]
    ]
)

LANES = 8  # points processed side by side, a tile
TILE = 6 * LANES  # numbers in a tile: each component of points and normals for all points in turn

_GEOM = mujoco.mjtGeom
_ROUNDING = 1e-9  # far above that of a point's height [m]; chosen
_BESIDE = 0.5  # extent beyond the bodies themselves, both sides together [m]; chosen


@dataclass(frozen=True)
class Footprint:
    """Surface points, geom by geom."""

    points: np.ndarray  # tiles, shape (n, 6, LANES); the last of a geom repeats its last point
    spheres: np.ndarray  # around each tile: center and radius [m], body frame, shape (n, 4)
    feet: np.ndarray  # rows of `FOOT_DTYPE`, one for each geom, body by body


def surroundings_of(model: mujoco.MjModel, geoms: Sequence[int], memory: Memory) -> float:
    """Return the distance up to which sand counts for the level around a point [m]."""
    if memory.surroundings is not None:
        return memory.surroundings
    return max(geom_width(model, geom) for geom in geoms) + 4 * memory.cell


def fitting(model: mujoco.MjModel, geoms: Sequence[int], memory: Memory) -> Memory:
    """Return a memory whose extent fits the model, unless the extent was set.

    It must hold the surroundings of its widest geom, and all bodies at qpos0 with 25 cm around.
    """
    needed = WINDOW * surroundings_of(model, geoms, memory), spread_of(model, geoms) + _BESIDE
    return memory.reaching(max(needed))


def spread_of(model: mujoco.MjModel, geoms: Sequence[int]) -> float:
    """Return the greatest extent of the geoms along x or y at qpos0 [m]."""
    data = data_at_start(model)
    axes = data.geom_xmat[list(geoms)].reshape(-1, 3, 3)
    half = np.stack([half_extents(model, geom) for geom in geoms])
    reach = (np.abs(axes) @ half[:, :, None])[:, :2, 0]
    place = data.geom_xpos[list(geoms)][:, :2]
    return float(((place + reach).max(axis=0) - (place - reach).min(axis=0)).max())


def footprint_of(
    model: mujoco.MjModel, geoms: Sequence[int], elements: np.ndarray, cell: float
) -> Footprint:
    """Return the footprint of the geoms that meet the sand, for cells of that side [m].

    It is where a law's elements look for sand: the axis of a rod, the surface of all other geoms.
    """
    parts: dict[int, list[np.ndarray]] = {int(geom): [] for geom in elements["geom"]}
    if "half_length" in (elements.dtype.names or ()):
        for rod in elements:
            parts[int(rod["geom"])].append(_on_rod(rod, cell))
    else:
        parts = {geom: [_on_skin(model, geom, cell)] for geom in parts}
    points, feet, count = [], [], 0
    for geom, mine in parts.items():
        here = np.concatenate(mine)
        points.append(_in_tiles(here))
        count += len(points[-1])
        check_count(LANES * count)
        low, high = here["point"].min(axis=0), here["point"].max(axis=0)
        middle, half = (low + high) / 2, (high - low) / 2
        far = math.hypot(*middle) + math.hypot(*half)
        feet.append((model.geom_bodyid[geom], count, middle, half, far))
    tiles = aligned(np.concatenate(points))
    places = tiles[:, :3]
    middles = (places.min(axis=2) + places.max(axis=2)) / 2
    radii = np.linalg.norm(places - middles[:, :, None], axis=1).max(axis=1)
    spheres = np.column_stack([middles, radii + _ROUNDING])
    return Footprint(tiles, spheres, np.array(feet, FOOT_DTYPE))


def _in_tiles(points: np.ndarray) -> np.ndarray:
    """Return points as kernels read them, shape (n, 6, LANES)."""
    points = np.concatenate([points, np.repeat(points[-1:], -len(points) % LANES)])
    numbers = np.concatenate([points["point"], points["normal"]], axis=1)
    return numbers.reshape(-1, LANES, 6).transpose(0, 2, 1)


def _on_rod(rod: np.void, cell: float) -> np.ndarray:
    half = float(rod["half_length"])
    count = max(math.ceil(2 * half / cell), 1) + 1  # both ends included
    points = np.zeros(count, POINT_DTYPE)
    points["point"] = rod["center"] + np.linspace(-half, half, count)[:, None] * rod["axis"]
    return points


def _on_skin(model: mujoco.MjModel, geom: int, cell: float) -> np.ndarray:
    """Return points all over the surface of a geom, at most a cell apart; body frame."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == _GEOM.mjGEOM_MESH:
        places, normals = _on_mesh(model, geom, cell)
    elif kind == _GEOM.mjGEOM_BOX:
        places, normals = _on_box(size, cell)
    elif kind == _GEOM.mjGEOM_CYLINDER:
        radius, half = size[:2]
        ends = [[0, half], [radius, half], [radius, -half], [0, -half]]
        places, normals = _revolved([_on_line(*two, cell) for two in pairwise(ends)], cell)
    else:
        # A stretched sphere: a capsule along its axis, an ellipsoid along all axes.
        half = size[1] if kind == _GEOM.mjGEOM_CAPSULE else 0.0
        radius = half_extents(model, geom) - [0, 0, half]
        profile = [_on_arc(radius.max(), half, cell)]
        if half:
            profile += [_on_line((radius[0], half), (radius[0], -half), cell)]
        places, normals = _revolved(profile, cell)
        stretch = radius / radius.max()
        places, normals = places * stretch, normals / stretch
    turn = geom_axes(model, geom).T
    points = np.zeros(len(places), POINT_DTYPE)
    points["point"] = places @ turn + model.geom_pos[geom]
    points["normal"] = normals / np.linalg.norm(normals, axis=1)[:, None] @ turn
    return points


def _on_line(begin: Sequence[float], end: Sequence[float], cell: float) -> np.ndarray:
    """Return points of a profile (`_revolved`) on a straight piece, with outside on the left."""
    first, last = np.array(begin, float), np.array(end, float)
    way = last - first
    share = (1 + _middles(float(np.linalg.norm(way)), cell)[:, None]) / 2
    return np.hstack([first + share * way, np.tile([-way[1], way[0]], (len(share), 1))])


def _on_arc(radius: float, half: float, cell: float) -> np.ndarray:
    """Return points of a profile (`_revolved`) on a half circle, its halves `2 half` apart."""
    polar = math.pi / 2 * (1 + _middles(math.pi * radius, cell))
    normals = np.stack([np.sin(polar), np.cos(polar)], axis=1)
    apart = half * np.sign(normals[:, 1:])
    return np.hstack([radius * normals + apart * [0, 1], normals])


def _revolved(profile: Sequence[np.ndarray], cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points and normals on a surface of revolution around the z axis, at most a cell apart.

    The profile has points (r, z) with their normals, shape (n, 4).
    """
    points = []
    for r, z, out, up in np.concatenate(profile):
        turn = math.pi * _middles(2 * math.pi * r, cell)
        c, s, one = np.cos(turn), np.sin(turn), np.ones(len(turn))
        points.append(np.stack([r * c, r * s, z * one, out * c, out * s, up * one], axis=1))
    found = np.concatenate(points)
    return found[:, :3], found[:, 3:]


def _on_box(half: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    places, normals = [], []
    for axis in range(3):
        ways = [half[k] * _middles(2 * half[k], cell) for k in range(3)]
        for side in (-1.0, 1.0):
            ways[axis] = np.array([side * half[axis]])
            places.append(np.stack(np.meshgrid(*ways), axis=-1).reshape(-1, 3))
            normals.append(np.tile(side * np.eye(3)[axis], (len(places[-1]), 1)))
    return np.concatenate(places), np.concatenate(normals)


def _middles(length: float, cell: float) -> np.ndarray:
    """Return the centers of equal parts of a length, at most a cell long, from -1 to 1."""
    count = max(math.ceil(length / cell - 1e-9), 1)
    return (2 * np.arange(count) + 1) / count - 1


def _on_mesh(model: mujoco.MjModel, geom: int, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the centers of the triangles of a mesh, divided until none is longer than a cell."""
    places, normals = [], []
    vertices, faces, _ = mesh_faces(model, geom, warn=False)  # those of the force, which warn
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    for corner, area in zip(corners, areas, strict=True):
        if area.any():
            edges = corner - np.roll(corner, 1, axis=0)
            weights = _in_triangle(math.ceil(np.linalg.norm(edges, axis=1).max() / cell - 1e-9))
            places.append(weights @ corner)
            normals.append(np.broadcast_to(area, places[-1].shape))
    return np.concatenate(places), np.concatenate(normals)


@cache
def _in_triangle(parts: int) -> np.ndarray:
    """Return corner weights of the centers of the `parts`^2 parts of a triangle, one a row."""
    upright = [(a + 1 / 3, b + 1 / 3) for a in range(parts) for b in range(parts - a)]
    hanging = [(a + 2 / 3, b + 2 / 3) for a in range(parts) for b in range(parts - a - 1)]
    first, second = np.array(upright + hanging).T / parts
    return np.stack([first, second, 1 - first - second], axis=1)
