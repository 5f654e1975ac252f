"""Elements at one instant, and the polygons that outline them: the data of figures and scenes."""

import math
from dataclasses import dataclass
from typing import Literal, Self, get_args

import mujoco
import numpy as np

from mjgranular._util.checks import check_name
from mjgranular.errors import InputError
from mjgranular.sand import Report, Sand

Kind = Literal["rods", "facets", "blobs"]
Color = Literal["body", "geom"]

# A field that only the elements of this kind have.
_MARKS: dict[str, Kind] = {"half_length": "rods", "normal": "facets", "halves": "blobs"}

# Okabe and Ito's colors, which color-blind readers can distinguish.
_PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#8A8A8A", "#F0E442")
AROUND = 24  # number of corners of a drawn circle
_LEAST_SHARE = 0.25  # least area of the edges' parallelogram, relative to the facet's; else a disc
RED, INK = "#C0281C", "#303030"
"""Colors of forces, and of lines."""


@dataclass(frozen=True)
class Shown:
    """Elements at one instant, in the world frame."""

    kind: Kind  # their kind
    elements: np.ndarray  # the law's structured array
    origin: np.ndarray  # origin of each element's body [m], shape (n, 3)
    turn: np.ndarray  # rotation matrix of each element's body, axes in columns, shape (n, 3, 3)
    report: Report  # the sand's action on them
    colors: np.ndarray  # red, green and blue, 0 to 1, shape (n, 3)
    names: dict[str, np.ndarray]  # colors by the names that they stand for

    @classmethod
    def at(cls, sand: Sand, data: mujoco.MjData, color: str, *, of_state: bool = False) -> Self:
        """Return the elements at the state in `data`.

        Poses of bodies are the last that MuJoCo computed, or with `of_state` those at `qpos`.
        """
        kind, elements, report = kind_of(sand), sand.elements, sand.report(data)
        check_name("way to color elements", color, get_args(Color))
        poses = data
        if of_state:
            poses = mujoco.MjData(sand.model)
            for name in ("qpos", "mocap_pos", "mocap_quat"):
                getattr(poses, name)[:] = getattr(data, name)
            mujoco.mj_kinematics(sand.model, poses)
        words = report.names.bodies if color == "body" else report.names.geoms
        ids, rank = np.unique(elements[color], return_inverse=True)
        tints = np.array([rgb(_PALETTE[k % len(_PALETTE)]) for k in range(len(ids))])
        names = {words[int(i)]: tint for i, tint in zip(ids, tints, strict=True)}
        colors = tints[rank]
        if kind == "rods":  # every other piece of a geom darker, to tell them apart
            _, first, geom = np.unique(elements["geom"], return_index=True, return_inverse=True)
            colors[(np.arange(len(elements)) - first[geom]) % 2 == 1] *= 0.75
        body = elements["body"]
        turn = poses.xmat[body].reshape(-1, 3, 3)
        return cls(kind, elements, poses.xpos[body], turn, report, colors, names)

    def place(self, local: np.ndarray) -> np.ndarray:
        """Return world positions of points given in body frames, shape (n, k, 3)."""
        return self.origin[:, None] + np.einsum("nij,nkj->nki", self.turn, local)

    @property
    def middles(self) -> np.ndarray:
        """The world positions of the elements' centers [m], shape (n, 3)."""
        name = "point" if self.kind == "facets" else "center"
        return self.place(self.elements[name][:, None])[:, 0]

    @property
    def sizes(self) -> np.ndarray:
        """The size of each element [m], shape (n,)."""
        e = self.elements
        if self.kind == "facets":
            return np.sqrt(e["area"])
        if self.kind == "rods":
            return 2 * e["half_length"]
        return 2 * (e["radii"] + e["halves"] + e["disc"][:, None]).max(axis=1)

    @property
    def reach(self) -> float:
        """The size of all of them together [m]."""
        middles, half = self.middles, self.sizes[:, None] / 2
        return float(((middles + half).max(axis=0) - (middles - half).min(axis=0)).max())

    def normals(self) -> tuple[np.ndarray, np.ndarray]:
        """Return both ends of short normals of the facets [m], each of shape (n, 3)."""
        if self.kind != "facets":
            return np.zeros((0, 3)), np.zeros((0, 3))
        length = np.minimum(0.5 * self.sizes, 0.06 * self.reach)
        ends = self.elements["point"] + length[:, None] * self.elements["normal"]
        return self.middles, self.place(ends[:, None])[:, 0]

    def forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Return both ends of arrows of the forces [m], each of shape (m, 3), m at most n.

        Forces push facets from outside: their arrows end where the force acts. Others start there.
        The largest force takes 0.3 of the reach.
        """
        table = self.report.elements
        size = np.linalg.norm(table.force, axis=1)
        scale = 0.3 * self.reach / max(float(size.max()), 1e-300)
        seen = scale * size > 2e-3 * self.reach
        point, arrow = table.point[seen], scale * table.force[seen]
        return (point - arrow, point) if self.kind == "facets" else (point, point + arrow)


def kind_of(sand: Sand) -> Kind:
    """Find the kind of elements that a law has cut the geoms into."""
    fields = sand.elements.dtype.names or ()
    for mark, kind in _MARKS.items():
        if mark in fields:
            return kind
    raise InputError(
        f"the law {sand.law.name!r} has elements of an unknown kind ({', '.join(fields)}): rods, "
        "facets and blobs can be drawn"
    )


def rgb(color: str) -> np.ndarray:
    """Return red, green and blue, 0 to 1, of a color #RRGGBB."""
    return np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255


def with_alpha(colors: np.ndarray, alpha: float) -> np.ndarray:
    """Add an opacity to colors, shape (n, 4)."""
    return np.column_stack([colors, np.full(len(colors), alpha)])


def polygons_of(shown: Shown) -> tuple[np.ndarray, np.ndarray]:
    """Return polygons of elements in the world frame, and the element that each belongs to."""
    e, n = shown.elements, np.arange(len(shown.elements))
    if shown.kind == "facets":
        return shown.place(facet_corners(e)), n
    if shown.kind == "rods":
        rims = shown.place(_rod_rims(e)).reshape(-1, 2, AROUND, 3)
        after = np.roll(rims, -1, axis=2)
        sides = np.stack([rims[:, 0], after[:, 0], after[:, 1], rims[:, 1]], axis=2)
        polygons = [padded(sides.reshape(-1, 4, 3), AROUND), rims.reshape(-1, AROUND, 3)]
        return np.concatenate(polygons), np.concatenate([n.repeat(AROUND), n.repeat(2)])
    grids = shown.place(_blob_points(e)).reshape(len(e), -1, AROUND, 3)
    after = np.roll(grids, -1, axis=2)
    quads = np.stack([grids[:, :-1], grids[:, 1:], after[:, 1:], after[:, :-1]], axis=3)
    sides = padded(quads.reshape(-1, 4, 3), AROUND)
    polygons = np.concatenate([sides, grids[:, 0], grids[:, -1]])
    owners = np.concatenate([n.repeat(len(sides) // len(e)), n, n])
    # Directions with the same outermost point, as at a corner, have empty polygons between them.
    area = np.linalg.norm(area_vectors(polygons), axis=1)
    seen = area > 1e-6 * shown.sizes[owners] ** 2
    return polygons[seen], owners[seen]


def padded(polygons: np.ndarray, corners: int) -> np.ndarray:
    """Repeat the last corners of polygons until each has `corners` corners."""
    last = np.repeat(polygons[:, -1:], corners - polygons.shape[1], axis=1)
    return np.concatenate([polygons, last], axis=1)


def facet_corners(facets: np.ndarray) -> np.ndarray:
    """Return the corners of facets in body frames, shape (n, k, 3), with the true area."""
    wide, edges = half_edges(facets)
    around = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) @ edges
    if not wide.all():
        radius = np.sqrt(2 * facets["area"] / (AROUND * math.sin(2 * math.pi / AROUND)))
        discs = radius[:, None, None] * _circles(facets["normal"])
        discs[wide] = padded(around, AROUND)
        around = discs
    return facets["point"][:, None] + around


def half_edges(facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which facets are parallelograms, shape (n,), and their half edges, shape (m, 2, 3).

    The edges are scaled to the facets' areas. A single triangle has no edges, and those of a patch
    hidden except for a strip are tiny: both are drawn as discs.
    """
    if "edges" not in (facets.dtype.names or ()):
        return np.zeros(len(facets), bool), np.zeros((0, 2, 3))
    edges = facets["edges"]
    area = 4 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    wide = area > _LEAST_SHARE * facets["area"]
    return wide, edges[wide] * np.sqrt(facets["area"][wide] / area[wide])[:, None, None]


def _rod_rims(rods: np.ndarray) -> np.ndarray:
    """Return the corners of the two ends of rods in body frames, shape (n, 2 * AROUND, 3)."""
    ring = (rods["width"] / 2)[:, None, None] * _circles(rods["axis"])
    along = (rods["half_length"][:, None] * rods["axis"])[:, None]
    return rods["center"][:, None] + np.concatenate([ring - along, ring + along], axis=1)


def _circles(axes: np.ndarray) -> np.ndarray:
    """Return points on circles of radius 1 about axes, shape (n, AROUND, 3)."""
    turn = 2 * math.pi * np.arange(AROUND) / AROUND
    return np.stack([np.cos(turn), np.sin(turn)], axis=1) @ frames_of(axes)[:, :, :2].mT


def _blob_points(blobs: np.ndarray) -> np.ndarray:
    """Return points of blobs in body frames, shape (n, (AROUND / 2) * AROUND, 3).

    They are the outermost points in directions of a grid of latitude and longitude, none of which
    lies in a plane of symmetry, where a box would have more than one.
    """
    polar = math.pi * (np.arange(AROUND // 2) + 0.5) / (AROUND // 2)
    turn = 2 * math.pi * (np.arange(AROUND) + 0.5) / AROUND
    polar, turn = np.meshgrid(polar, turn, indexing="ij")
    ways = np.stack(
        [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=-1
    ).reshape(1, -1, 3)
    radii, halves = blobs["radii"][:, None], blobs["halves"][:, None]
    length = np.linalg.norm(radii * ways, axis=2, keepdims=True)
    points = radii**2 * ways / np.where(length > 0, length, 1.0) + halves * np.sign(ways)
    flat = ways[..., :2] / np.linalg.norm(ways[..., :2], axis=2, keepdims=True)
    points[..., :2] += blobs["disc"][:, None, None] * flat
    turned = np.einsum("nij,nkj->nki", blobs["axes"].reshape(-1, 3, 3), points)
    return blobs["center"][:, None] + turned


def frames_of(axes: np.ndarray) -> np.ndarray:
    """Return right-handed frames in columns with given unit vectors as z, shape (n, 3, 3)."""
    first = np.cross(axes, np.eye(3)[np.argmin(np.abs(axes), axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(axes, first), axes], axis=2)


def area_vectors(polygons: np.ndarray) -> np.ndarray:
    """Return area times normal of polygons with the same number of corners, shape (n, 3)."""
    arms = polygons - polygons[:, :1]
    return np.cross(arms[:, 1:-1], arms[:, 2:]).sum(axis=1) / 2
