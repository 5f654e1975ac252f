"""A rigid body as the sand meets it: its faces, how wide they are, and what shelters them.

Both depend on all geoms that are welded together: dividing a body into more of them has no effect.
"""

import copy
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from mjgranular.shape.patches import flatness
from mjgranular.shape.shells import mesh_arrays
from mjgranular.shape.sizes import half_extents, rod_length
from mjgranular.shape.tessellation import CORNERS

# Facets belong to one flat face if their normals differ by less than 3 degrees, their planes by a
# small share of the geom's width, and if gaps between them are narrow in the same measure. A gap
# five times as wide is open. Chosen, not measured.
_PARALLEL, _COPLANAR, _GAP, _OPEN = math.cos(math.radians(3)), 0.05, 0.1, 0.5

# Gamma of (A0): how much thicker fluid moves with a cylinder than a ball (pi/4 to 1/3 diameters:
# Lamb, Hydrodynamics), with a strip than a square plate (1 to 0.579: DNV RP-C205).
_LONG_ROUND, _LONG_FLAT = 1.36, 0.73

_HOLLOW = 0.05  # of a nearly convex body that is ahead of the faces of a part, at most; chosen
_MOST = 4000  # facets of a plane compared in pairs, at most; else they are one face; chosen

# Rays from a facet are distributed around its normal with the weight cos(angle)^_FOCUS. Fitted to
# plates in tandem in simulated grains (referee/data/tandem, docs/shapes.md).
_FOCUS = 21.0
_RINGS = 4  # angles of rays to the normal, two opposite ones at each; chosen
# Rays start this far outside, in units of the geom's width, and hits at grazing angles on the
# facet's own geom within the second distance count as the facet itself. Chosen.
_TOUCH, _ITSELF = 1e-6, 1e-2

# Maximum number of parts that count along a ray; arcs are followed in at most `_CHORDS` chords of
# `_CHORD` radians. Chosen.
_WALLS, _CHORDS, _CHORD = 4, 4, math.radians(22.5)

_SHOWN, _ALONE = (np.array(groups, np.uint8) for groups in ([1, 1, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]))
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
_RODS = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER))
_BALL = int(mujoco.mjtGeom.mjGEOM_SPHERE)

Chords = Sequence[tuple[np.ndarray, np.ndarray]]
"""Begins and vectors of the chords of a ray [m]."""


def in_own_frames(model: mujoco.MjModel) -> mujoco.MjData:
    """Return data with each rigid body, and all that is welded to it, in the body's own frame.

    So the results do not depend on the body's pose in the world.
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


def join_faces(
    model: mujoco.MjModel, data: mujoco.MjData, facets: np.ndarray, exposed: np.ndarray
) -> None:
    """Set the widths of the face that each facet belongs to, and close narrow gaps in flat faces.

    A flat face is the union of the coplanar, adjacent facets of a rigid body. Its width is its area
    over its length, and its length that of a rod with the same greatest radius of gyration, or the
    root of its area: the shorter side of a rectangle. A curved surface is as wide as its geom; of
    meshes that touch and are nearly convex together, as all of them. Sand in a narrow gap moves
    with the body and is part of the face, so the facets on both sides get half of the gap each, and
    less of wider ones.

    The layer that moves along is that of a wider face if the face is long: `layer`, eq. (A0).
    `data` is of `in_own_frames`; `width` of facets is their geom's; `exposed` are their shares
    (`exposures`). Sets `face`, `layer`, `area`.
    """
    points, normals, edges = _placed(data, facets)
    facets["face"] = facets["width"]
    widths, areas, longer = facets["face"], facets["area"], np.zeros(len(facets))
    welds = model.body_weldid[facets["body"]]
    for weld in np.unique(welds):
        mine = np.flatnonzero(welds == weld)
        # From the largest facet on, then by position: independent of the order of geoms.
        mine = mine[np.lexsort([*points[mine].T.round(9), -areas[mine].round(12)])]
        joined = list(_joined(model, data, facets, mine, exposed))
        for rows, _, width, _ in joined:
            seen = areas[rows] * exposed[rows]
            facets["flat"][rows] = flatness(points[rows], normals[rows], seen, width)
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
                widths[rows], longer[rows] = _width_of(at, half, areas[rows])
                continue
            areas[rows] *= _bridged(at, reach, facets["geom"][rows], width)
            for part in _connected(at - reach, at + reach, _GAP * width):
                found = _width_of(at[part], half[part], areas[rows[part]])
                widths[rows[part]], longer[rows[part]] = found
        curved, turns = mine[~is_flat], data.geom_xmat.reshape(-1, 3, 3)
        for geom in np.unique(facets["geom"][curved]):
            half, rows = half_extents(model, geom), curved[facets["geom"][curved] == geom]
            (width, long), axis = 2 * np.sort(half)[1:], turns[geom][:, half.argmax()]
            if model.geom_type[geom] in (*_RODS, _BALL):
                long, axis = _rod_through(model, data, geom, facets["geom"][mine])
                long = max(long, width)
            longer[rows] = _longer(normals[rows], axis, width, long)
        for rows, axis, width, long in joined:
            rows = rows[facets["flat"][rows] < 0.5]
            widths[rows], longer[rows] = width, _longer(normals[rows], axis, width, long)
    facets["layer"] = widths * (1 + longer)


def exposures(
    model: mujoco.MjModel, data: mujoco.MjData, facets: np.ndarray, skins: np.ndarray
) -> np.ndarray:
    """Return the share of each facet that meets sand which does not move along, shape (n,).

    A face in front of which another part of the same rigid body stands is sheltered: the sand
    between them moves with the body. With f_k the share of rays that meet a k-th wall, exposed is

        (1 - f_1) (1 - (1 - f_1) f_2) (1 - (1 - f_1) f_3) ...

    Where the body turns on a hinge, rays run in arcs around it, as the sand does past the body.
    Across a joint nothing is sheltered. `data` is of `in_own_frames`, `skins` are points of the
    facets and normals there (`Facets.skin`), in the frames of the bodies. Rays start from these.
    """
    exposed = np.ones(len(facets))
    _, normals, edges = _placed(data, facets)
    skins = np.einsum("nij,nkmj->mnki", data.xmat[facets["body"]].reshape(-1, 3, 3), skins)
    touch = _TOUCH * facets["width"][:, None, None]
    starts = data.xpos[facets["body"], None] + skins[0] + touch * skins[1]
    axes = [[*_axes_across(n, edge), n] for n, edge in zip(normals, edges[:, 0], strict=True)]
    axes = _turned_to(skins[1], normals, np.array(axes))
    welds = model.body_weldid[facets["body"]]
    sight = _Sight(model, data)
    lobes = np.sign([(s, t, 1.0) for s, t in CORNERS])[:, None] * _lobe()  # mirrored: symmetry
    for weld in np.unique(welds):
        mine = np.flatnonzero(welds == weld)
        geoms = np.unique(facets["geom"][mine])
        if len(geoms) == 1 and model.geom_type[geoms[0]] != _MESH:
            continue  # one convex skin
        sight.show(geoms)
        hinge = _hinge(model, weld)
        for row in mine:
            rays, own = lobes @ axes[row], (facets["geom"][row], facets["width"][row])
            met = [sight.walls(*ray, *own) for ray in sight.not_free(starts[row], rays, hinge)]
            if met:
                share = np.sum(met, axis=0) / lobes[..., 0].size
                share[1:] *= 1.0 - share[0]
                exposed[row] = np.prod(1.0 - share)
    return exposed


class _Hinge(NamedTuple):
    """A hinge in the frame of its rigid body."""

    anchor: np.ndarray
    axis: np.ndarray

    def arcs(
        self, starts: np.ndarray, rays: np.ndarray, length: float
    ) -> Iterator[tuple[Chords, np.ndarray]]:
        """Yield chords and directions of arcs around it from some points; of rays, (n, k, 3).

        An arc that turns by less than a chord in `length` [m] is straight: one chord.
        """
        out = starts - self.anchor
        out -= np.outer(out @ self.axis, self.axis)
        radius = np.linalg.norm(out, axis=1, keepdims=True)
        away = out / np.maximum(radius, mujoco.mjMINVAL)
        frames = np.stack([away, np.cross(self.axis, away), np.broadcast_to(self.axis, out.shape)])
        outward, around, along = np.einsum("fni,nki->fnk", frames, rays)[..., None]
        turn, radii = np.abs(around), radius[:, None]
        straight = (turn * length < _CHORD * radii) | (radii <= mujoco.mjMINVAL)
        turn, radii = np.maximum(turn, mujoco.mjMINVAL), np.maximum(radii, mujoco.mjMINVAL)
        gone = np.minimum(length, _CHORD * radii / turn) * np.arange(_CHORDS + 1)
        angle, far = around * gone / radii, radii + outward * gone
        ends = np.stack([far * np.cos(angle), far * np.sin(angle), along * gone], -1)
        ends = ends @ frames.swapaxes(0, 1)[:, None] + (starts - out)[:, None, None]
        ends[:, :, 0] = starts[:, None]
        vectors = np.diff(ends, axis=2)
        for at in np.ndindex(rays.shape[:2]):
            arc = [*zip(ends[at][:-1], vectors[at], strict=True)]
            yield [(starts[at[0]], length * rays[at])] if straight[at] else arc, rays[at]


class _Sight:
    """Ray casts within one rigid body."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = copy.copy(model), data
        self._model.geom_rgba[:, 3], self._model.geom_matid[:] = 1.0, -1  # rays hit what is visible
        self._size = 0.0
        self._hit, self._normal = np.zeros(1, np.int32), np.zeros(3)

    def show(self, geoms: np.ndarray) -> None:
        """Let rays meet these geoms only."""
        self._model.geom_group[:] = 2
        self._model.geom_group[geoms] = 1
        far = np.linalg.norm(self._data.geom_xpos[geoms], axis=1) + self._model.geom_rbound[geoms]
        self._size = float(far.max())

    def not_free(
        self, starts: np.ndarray, rays: np.ndarray, hinge: _Hinge | None
    ) -> Iterator[tuple[Chords, np.ndarray]]:
        """Yield the rays from some points, shape (n, k, 3), that hit something, and their chords.

        They are straight, in one chord, without a hinge, and else run in arcs around it.
        """
        length, many = 2.0 * self._size, rays.shape[1]
        hit, far = np.zeros(many, np.int32), np.zeros(many)
        if hinge is not None:
            for chords, ray in hinge.arcs(starts, rays, length):
                if any(0.0 <= self._first(*chord)[0] <= 1.0 for chord in chords):
                    yield chords, ray
            return
        for at, some in zip(starts, rays, strict=True):
            mujoco.mj_multiRay(
                self._model, self._data, at, some.ravel(), _SHOWN, True, -1, hit, far, None, many,
                mujoco.mjMAXVAL,
            )  # fmt: skip
            for ray in some[hit >= 0]:
                yield [(at, length * ray)], ray

    def _first(
        self, at: np.ndarray, way: np.ndarray, group: np.ndarray = _SHOWN
    ) -> tuple[float, int, bool]:
        """Return the next surface's distance in units of `way`, its geom, and if the ray enters."""
        far = mujoco.mj_ray(
            self._model, self._data, at, way, group, True, -1, self._hit, self._normal
        )
        return far, int(self._hit[0]), bool(self._normal @ way < 0)

    def _leaves(self, geom: int, at: np.ndarray, way: np.ndarray) -> float:
        """Return where a ray that has entered a geom leaves it, in units of `way`."""
        self._model.geom_group[geom] = 0
        far = self._first(at, way, _ALONE)[0]
        self._model.geom_group[geom] = 1
        return max(far, 0.0)

    def _is_within(self, geom: int, at: np.ndarray, way: np.ndarray) -> bool:
        """Return whether a ray that hits a geom comes from inside another, and so leaves that."""
        self._model.geom_group[geom] = 2
        far, _, enters = self._first(at, way)
        self._model.geom_group[geom] = 1
        return far >= 0 and not enters

    def walls(self, chords: Chords, ray: np.ndarray, own: int, width: float) -> np.ndarray:
        """Return the walls that a ray hits, one after the other, shape (_WALLS,).

        A wall counts in full, 1, if as much sand is before it as before the first, and else in that
        proportion: walls that touch are one. The ray starts in the direction `ray` from a facet of
        the geom `own`, which has that width [m].
        """
        met, count = np.zeros(_WALLS), 0
        passed, end, nearest = 0.0, 0.0, 0.0  # distance before the chord, end of the last wall [m]
        touch = _TOUCH * width
        for here, way in chords:
            length = math.sqrt(way @ way)
            x, step = 0.0, touch / length
            while x < 1.0 and count < _WALLS:
                far, geom, enters = self._first(here + x * way, way)
                if far < 0 or x + far > 1.0:
                    break
                x += far
                place = passed + x * length
                if not enters:
                    if not (count == 0 and geom == own):
                        if count == 0:  # it started inside another geom
                            met[0], count = 1.0, 1
                        end = place
                    x += step
                    continue
                near = count == 0 and geom == own and place < _ITSELF * width
                itself = near and float(self._normal @ ray) > -0.5  # not the far side of a slit
                gap = place - end
                if count and gap > touch and self._is_within(geom, here + (x - far) * way, way):
                    gap = 0.0
                if not itself and (count == 0 or gap > touch):
                    nearest = nearest if count else gap
                    met[count] = min(1.0, gap / nearest) if nearest > 0 else 1.0
                    count += 1
                x = min(x + step + self._leaves(geom, here + (x + step) * way, way), 1.0)
                end = passed + x * length
                x += step
            passed += length
        return met


def _hinge(model: mujoco.MjModel, weld: int) -> _Hinge | None:
    """Return the hinge of a rigid body that turns on one, in a carriage on its other joints."""
    joint = model.body_jntadr[weld] + model.body_jntnum[weld] - 1
    if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
        return None
    return _Hinge(model.jnt_pos[joint].copy(), model.jnt_axis[joint].copy())


def _lobe() -> np.ndarray:
    """Return directions around z, distributed as cos^_FOCUS over the half sphere."""
    ring = np.arange(_RINGS)
    up = ((ring + 0.5) / _RINGS) ** (1.0 / (_FOCUS + 1.0))
    turn = math.pi * (ring + 0.5) / _RINGS
    out = np.sqrt(1.0 - up**2)
    rays = np.stack([out * np.cos(turn), out * np.sin(turn), up], axis=-1)
    return np.concatenate([rays, rays * (-1.0, -1.0, 1.0)])


def _axes_across(n: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return two axes across a normal, the first along an edge if there is one, shape (2, 3)."""
    if not along.any():
        along = np.eye(3)[np.abs(n).argmin()]
    along = along - (along @ n) * n
    along = along / np.linalg.norm(along)
    return np.stack([along, np.cross(n, along)])


def _turned_to(around: np.ndarray, normals: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return axes of normals, (n, 3, 3), turned to those around each by the least angle."""
    about = np.cross(normals[:, None], around)[:, :, None]
    cos = np.einsum("ni,nki->nk", normals, around)[..., None, None]
    across = np.cross(about, axes[:, None])
    return axes[:, None] + across + np.cross(about, across) / (1.0 + np.maximum(cos, 0.0))


def _connected(low: np.ndarray, high: np.ndarray, gap: np.ndarray | float) -> list[np.ndarray]:
    """Return the rows of boxes that touch, directly or through others, one array for each part."""
    apart = np.maximum(low[:, None] - high[None], low[None] - high[:, None]).max(axis=2)
    joined = apart <= gap
    parts, left = [], np.ones(len(low), bool)
    while left.any():
        part, found = np.zeros((2, len(low)), bool)
        found[left.argmax()] = True
        while found.any():
            part |= found
            found = joined[found].any(axis=0) & ~part
        parts.append(np.flatnonzero(part))
        left &= ~part
    return parts


def _bridged(at: np.ndarray, reach: np.ndarray, geoms: np.ndarray, width: float) -> np.ndarray:
    """Return factors on areas with which coplanar facets of geoms meet halfway, shape (n,).

    `at` are their centers in the plane, `reach` half their extents [m]. Between facets of one geom
    there is no gap; gaps are compared to the width of the geoms [m].
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


def _width_of(at: np.ndarray, half: np.ndarray, areas: np.ndarray) -> tuple[float, float]:
    """Return the width of a flat face and Gamma (1 - w/l), by its facets' centers, half edges."""
    area = areas.sum()
    length = max(rod_length(at, areas, half, 3), math.sqrt(area))
    return float(area / length), float(_LONG_FLAT * (1 - area / length**2))


def _joined(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    facets: np.ndarray,
    mine: np.ndarray,
    exposed: np.ndarray,
) -> Iterator[tuple[np.ndarray, np.ndarray, float, float]]:
    """Yield the facets of meshes that touch and are nearly convex together, with their extents.

    That is the longest axis, and the second and the largest extent [m].
    """
    mine = mine[model.geom_type[facets["geom"][mine]] == _MESH]
    geoms, first, own = np.unique(facets["geom"][mine], return_index=True, return_inverse=True)
    if len(geoms) < 2:
        return
    # Along the axes of all meshes: the axes of the body's frame must not decide.
    across = np.hstack(data.geom_xmat[geoms].reshape(-1, 3, 3))
    points, normals, edges = _placed(data, facets[mine])
    at, reach = points @ across, np.abs(edges @ across).sum(axis=1)
    low = np.array([(at - reach)[own == k].min(axis=0) for k in range(len(geoms))])
    high = np.array([(at + reach)[own == k].max(axis=0) for k in range(len(geoms))])
    widths = facets["width"][mine[first]]
    for part in _connected(low, high, _GAP * np.minimum(widths, widths[:, None])):
        if len(part) < 2:
            continue
        inside = np.isin(own, part)
        rows = mine[inside]
        areas = facets["area"][rows] * exposed[rows]
        away = points[inside] - areas @ points[inside] / areas.sum()
        axes = np.linalg.eigh(np.einsum("n,ni,nj->ij", areas, away, away))[1]
        corners = [
            data.geom_xpos[g] + mesh_arrays(model, g)[0] @ data.geom_xmat[g].reshape(3, 3).T
            for g in geoms[part]
        ]
        extents = np.ptp(np.concatenate(corners) @ axes, axis=0)
        width, long = np.sort(extents)[1:]
        some = slice(None, None, -(-len(rows) // _MOST))
        ahead = normals[inside][some] @ away[some].T
        is_ahead = ahead - ahead.diagonal()[:, None] > _COPLANAR * width
        geom, weight = facets["geom"][rows][some], areas[some]
        found = np.bincount(geom, weight * (is_ahead @ weight))
        if (found <= _HOLLOW * weight.sum() * np.bincount(geom, weight)).all():
            yield rows, axes[:, extents.argmax()], width, long


def _longer(normals: np.ndarray, axis: np.ndarray, width: float, long: float) -> np.ndarray:
    """Return Gamma (1 - w/l) (1 - (n.e)^2) of layer = w (1 + ...) (A0), for round skin."""
    return _LONG_ROUND * (1 - width / long) * (1 - (normals @ axis) ** 2)


def _rod_through(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, geoms: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the length of the rod that a round geom is part of [m], and its axis.

    That is a capsule or a cylinder with what continues it, as wide, to `_GAP`: others, and spheres.
    """
    ids = np.array([g for g in np.unique(geoms) if model.geom_type[g] in (*_RODS, _BALL)])
    balls, radius = model.geom_type[ids] == _BALL, model.geom_size[geom, 0]
    axes, slack = data.geom_xmat.reshape(-1, 3, 3)[ids, :, 2], 2 * _GAP * radius
    ends = np.array([half_extents(model, g)[2] for g in ids])
    found = 0.0, axes[0]
    for line, axis in zip(ids, axes, strict=True):
        away = data.geom_xpos[ids] - data.geom_xpos[line]
        along = away @ axis
        one = np.linalg.norm(away - np.outer(along, axis), axis=1) < slack
        one &= abs(model.geom_size[ids, 0] - radius) < slack / 2
        one &= balls | (abs(axes @ axis) > _PARALLEL)
        if model.geom_type[line] == _BALL or geom not in ids[one]:
            continue
        low, high = (along - ends)[one, None], (along + ends)[one, None]
        (part,) = (p for p in _connected(low, high, slack) if geom in ids[one][p])
        found = max(found, (float(high[part].max() - low[part].min()), axis), key=lambda x: x[0])
    return found
