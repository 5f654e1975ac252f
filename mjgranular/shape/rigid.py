"""What the sand sees of a rigid body: its faces, how wide they are, and what shelters them.

Both belong to all geoms that are welded together, not to one of them, so a rigid body that is cut
into more geoms stays the same body.
"""

from __future__ import annotations

import copy
import math

import mujoco
import numpy as np

# Facets belong to one flat face where their normals differ by less than 3 degrees, their planes by
# a small share of the geom's width, and where gaps between them are narrow in the same measure. A
# gap five times as wide is open. Chosen, not measured.
_PARALLEL, _COPLANAR, _GAP, _OPEN = math.cos(math.radians(3)), 0.05, 0.1, 0.5

_MOST = 4000  # facets of a plane that are compared in pairs, else they are one face; chosen

# Rays from a facet go into the directions around its normal with the weight cos(angle)^_FOCUS.
# Fitted to plates in tandem in simulated grains (referee/data/tandem, docs/shapes.md).
_FOCUS = 20.0
_RINGS, _AROUND = 4, 8  # rays: angles to the normal, and directions for each; chosen
# Rays start so far outside, in parts of the geom's width, and what they meet of the facet's own
# geom within so far is the facet. Chosen.
_TOUCH, _ITSELF = 1e-6, 1e-2

_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)


def in_own_frames(model: mujoco.MjModel) -> mujoco.MjData:
    """Return data in which each rigid body stands in its own frame, with all that is welded to it.

    So nothing here depends on where the body is in the world, or how it is turned.
    """
    data, not_same = mujoco.MjData(model), int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)

    def place(pos: np.ndarray, mat: np.ndarray, body: int, *local: np.ndarray) -> None:
        mujoco.mj_local2Global(data, pos, mat, *local, body, not_same)

    for body in range(model.nbody):
        data.xpos[body], data.xquat[body] = 0.0, (1.0, 0.0, 0.0, 0.0)
        data.xmat[body] = np.eye(3).ravel()
        if model.body_weldid[body] != body:
            parent, local = model.body_parentid[body], (model.body_pos[body], model.body_quat[body])
            place(data.xpos[body], data.xmat[body], parent, *local)
            mujoco.mju_mulQuat(data.xquat[body], data.xquat[parent], local[1])
        local = (model.body_ipos[body], model.body_iquat[body])
        place(data.xipos[body], data.ximat[body], body, *local)
    for geom, body in enumerate(model.geom_bodyid):
        local = (model.geom_pos[geom], model.geom_quat[geom])
        place(data.geom_xpos[geom], data.geom_xmat[geom], body, *local)
    return data


def _placed(data: mujoco.MjData, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points [m], normals and half edges [m] of facets, in the frames of their bodies."""
    turn = data.xmat[facets["body"]].reshape(-1, 3, 3)
    points = data.xpos[facets["body"]] + np.einsum("nij,nj->ni", turn, facets["point"])
    normals = np.einsum("nij,nj->ni", turn, facets["normal"])
    return points, normals, np.einsum("nij,nkj->nki", turn, facets["edges"])


def join_faces(model: mujoco.MjModel, data: mujoco.MjData, facets: np.ndarray) -> None:
    """Set the width of the face that each facet belongs to, and close narrow gaps in flat faces.

    A flat face is the union of the coplanar, adjacent facets of a rigid body. Its width is its area
    over its length, and its length that of a rod with the same greatest radius of gyration: the
    shorter side of a rectangle. Curved skin is as wide as its geom; of meshes that touch, as all of
    them together. Sand in a narrow gap moves with the body and is part of the face, so the facets
    on both sides get half of the gap each, and less of wider ones.

    Args:
        model: the model.
        data: of `in_own_frames`.
        facets: dtype `FACET_DTYPE`; `width` is that of the geom. Sets `face` and `area`.
    """
    points, normals, edges = _placed(data, facets)
    facets["face"] = facets["width"]
    widths, areas = facets["face"], facets["area"]
    welds = model.body_weldid[facets["body"]]
    for weld in np.unique(welds):
        mine = np.flatnonzero(welds == weld)
        # From the largest facet on, then by place: whatever the order of geoms.
        mine = mine[np.lexsort([*points[mine].T.round(9), -areas[mine].round(12)])]
        is_flat = facets["flat"][mine] >= 0.5
        left = mine[is_flat]
        while len(left):
            n, width = normals[left[0]], facets["width"][left[0]]
            near = np.abs((points[left] - points[left[0]]) @ n) < _COPLANAR * width
            plane = near & (normals[left] @ n > _PARALLEL)
            rows, left = left[plane], left[~plane]
            axes = _axes_across(n, edges[rows[0], 0])
            at, half = points[rows] @ axes.T, edges[rows] @ axes.T
            reach = np.abs(half).sum(axis=1)
            width = facets["width"][rows].max()
            if len(rows) > _MOST:
                widths[rows] = _width_of(at, half, areas[rows])
                continue
            areas[rows] *= _bridged(at, reach, facets["geom"][rows], width)
            for part in _connected(at - reach, at + reach, _GAP * width):
                widths[rows[part]] = _width_of(at[part], half[part], areas[rows[part]])
        meshes = np.unique(facets["geom"][mine[~is_flat]])
        meshes = meshes[model.geom_type[meshes] == _MESH]
        if len(meshes) < 2:
            continue
        reach = np.abs(edges[mine]).sum(axis=1)
        low, high = points[mine] - reach, points[mine] + reach
        own = [facets["geom"][mine] == geom for geom in meshes]
        low, high = (
            np.array([low[m].min(0) for m in own]),
            np.array([high[m].max(0) for m in own]),
        )
        for part in _connected(low, high, _GAP * widths[mine].max()):
            if len(part) > 1:
                rows = mine[np.isin(facets["geom"][mine], meshes[part])]
                curved = rows[facets["flat"][rows] < 0.5]
                widths[curved] = _second_extent(points[rows], edges[rows], areas[rows])


def exposures(model: mujoco.MjModel, data: mujoco.MjData, facets: np.ndarray) -> np.ndarray:
    """Return the share of each facet that meets sand which does not move along, shape (n,).

    A face in front of which another part of the same rigid body stands is sheltered: the sand
    between them moves with the body. Exposed is the share of rays that meet no such part. Across a
    joint nothing is sheltered.

    Args:
        model: the model.
        data: of `in_own_frames`.
        facets: dtype `FACET_DTYPE`.
    """
    exposed = np.ones(len(facets))
    points, normals, edges = _placed(data, facets)
    welds = model.body_weldid[facets["body"]]
    directions = _lobe()
    seen = copy.copy(model)  # rays meet what is visible
    seen.geom_rgba[:, 3], seen.geom_matid[:] = 1.0, -1
    group = np.array([1, 0, 0, 0, 0, 0], np.uint8)
    hit, distance = np.zeros(len(directions), np.int32), np.zeros(len(directions))
    slant = np.zeros(3 * len(directions))
    for weld in np.unique(welds):
        mine = np.flatnonzero(welds == weld)
        geoms = np.unique(facets["geom"][mine])
        if len(geoms) == 1 and model.geom_type[geoms[0]] != _MESH:
            continue  # one convex skin
        seen.geom_group[:] = 1
        seen.geom_group[geoms] = 0
        for row in mine:
            n, (first, second) = normals[row], edges[row]
            # The middle of a patch lies within a bulging skin: so far, at most.
            bulge = np.linalg.norm(edges[row], axis=1) @ np.linalg.norm(
                facets["spread"][row], axis=1
            )
            least = _ITSELF * facets["width"][row]
            start = points[row] + (bulge + _TOUCH * facets["width"][row]) * n
            rays = directions @ np.vstack([_axes_across(n, first), n])
            free = []
            for s, t in ((-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)):
                mujoco.mj_multiRay(
                    seen, data, start + s * first + t * second, rays.ravel(), group, True, -1, hit,
                    distance, slant, len(rays), mujoco.mjMAXVAL,
                )  # fmt: skip
                # A ray that leaves the geom's own skin from within has not been stopped, nor has
                # one that meets the facet itself by rounding.
                leaves = np.einsum("ni,ni->n", slant.reshape(-1, 3), rays) > 0
                itself = (hit == facets["geom"][row]) & (leaves | (distance < least))
                free.append(((hit < 0) | itself).mean())
            exposed[row] = np.mean(free)
    return exposed


def _lobe() -> np.ndarray:
    """Directions around z, as many as weights ask for: cos^(_FOCUS + 1) over the half sphere."""
    share = (np.arange(_RINGS) + 0.5) / _RINGS
    up = share ** (1.0 / (_FOCUS + 2.0))
    ring, around = np.meshgrid(np.arange(_RINGS), np.arange(_AROUND), indexing="ij")
    turn = 2 * math.pi * (around + 0.5 * (ring % 2)) / _AROUND
    out = np.sqrt(1.0 - up**2)[ring]
    return np.stack([out * np.cos(turn), out * np.sin(turn), up[ring]], -1).reshape(-1, 3)


def _axes_across(n: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Two axes across a normal, the first along an edge where there is one, shape (2, 3)."""
    if not along.any():
        along = np.eye(3)[np.abs(n).argmin()]
    along = along - (along @ n) * n
    along = along / np.linalg.norm(along)
    return np.stack([along, np.cross(n, along)])


def _connected(low: np.ndarray, high: np.ndarray, gap: float) -> list[np.ndarray]:
    """Return the rows of boxes that touch, directly or through others, one array for each part."""
    apart = np.maximum(low[:, None] - high[None], low[None] - high[:, None]).max(axis=2)
    joined = apart <= gap
    parts, left = [], np.ones(len(low), bool)
    while left.any():
        part = np.zeros(len(low), bool)
        found = np.zeros(len(low), bool)
        found[np.flatnonzero(left)[0]] = True
        while found.any():
            part |= found
            found = joined[found].any(axis=0) & ~part
        parts.append(np.flatnonzero(part))
        left &= ~part
    return parts


def _bridged(at: np.ndarray, reach: np.ndarray, geoms: np.ndarray, width: float) -> np.ndarray:
    """Return factors on areas with which coplanar facets of geoms meet halfway, shape (n,).

    Args:
        at: their middles in the plane [m], shape (n, 2).
        reach: half their extents [m], shape (n, 2).
        geoms: their geoms, shape (n,); in between facets of one geom there is no gap.
        width: of the geoms [m], in parts of which gaps are wide.
    """
    away = at[None] - at[:, None]
    apart = np.abs(away) - reach[None] - reach[:, None]
    foreign = geoms[None] != geoms[:, None]
    factor = np.ones(len(at))
    for axis in (0, 1):
        beside = apart[..., 1 - axis] < -_TOUCH * reach.max()
        for side in (-1, 1):
            there = beside & (side * away[..., axis] > 0)
            gaps = np.where(foreign, np.maximum(apart[..., axis], 0.0), 0.0)
            nearest = np.where(there, gaps, np.inf).min(axis=1)
            closed = np.clip((_OPEN - nearest / width) / (_OPEN - _GAP), 0.0, 1.0)
            is_gap = (closed > 0) & (nearest > _TOUCH * width)
            half = 0.5 * closed[is_gap] * nearest[is_gap]
            factor[is_gap] += half / (2 * np.maximum(reach[is_gap, axis], half))
    return factor


def _width_of(at: np.ndarray, half: np.ndarray, areas: np.ndarray) -> float:
    """Return the width of a flat face: see `face_widths`.

    Args:
        at: middles of its facets in the plane [m], shape (n, 2).
        half: their half edges [m], shape (n, 2, 2).
        areas: [m^2], shape (n,).
    """
    area = areas.sum()
    away = at - areas @ at / area
    moments = np.einsum("n,ni,nj->ij", areas, away, away)
    moments += np.einsum("n,nki,nkj->ij", areas, half, half) / 3
    length = math.sqrt(12 * max(np.linalg.eigvalsh(moments / area)[-1], 0.0))
    return float(area / max(length, math.sqrt(area)))


def _second_extent(points: np.ndarray, edges: np.ndarray, areas: np.ndarray) -> float:
    """Return the second largest extent of facets along their principal axes [m]."""
    away = points - areas @ points / areas.sum()
    axes = np.linalg.eigh(np.einsum("n,ni,nj->ij", areas, away, away))[1]
    at, reach = away @ axes, np.abs(edges @ axes).sum(axis=1)
    return float(np.sort((at + reach).max(axis=0) - (at - reach).min(axis=0))[1])
