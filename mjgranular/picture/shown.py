"""Elements at one instant: the data of figures and scenes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import mujoco
import numpy as np

from mjgranular.errors import InputError, UnknownNameError
from mjgranular.sand import Report, Sand

Kind = Literal["rods", "facets", "blobs"]
Color = Literal["body", "geom", "depth"]

# A field that only the elements of this kind have.
_MARKS: dict[str, Kind] = {"half_length": "rods", "normal": "facets", "halves": "blobs"}

# Okabe and Ito's colors, which color-blind readers can distinguish.
_PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#8A8A8A", "#F0E442")
DEPTHS = ("#F7E3B5", "#E0A85E", "#B0653B", "#6B3A3A", "#2B1B33")
"""Colors from shallow to deep."""
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
    # Meaning of the colors, in the order of the model; empty for depths
    names: dict[str, np.ndarray]

    @classmethod
    def at(cls, sand: Sand, data: mujoco.MjData, color: str) -> Shown:
        """Return the elements at the state in `data`."""
        kind, elements, report = kind_of(sand), sand.elements, sand.report(data)
        if color == "depth":
            names, colors = {}, _depth_colors(report.table.depth)
        elif color in get_args(Color):
            words = report.names.bodies if color == "body" else report.names.geoms
            ids, rank = np.unique(elements[color], return_inverse=True)
            tints = np.array([rgb(_PALETTE[k % len(_PALETTE)]) for k in range(len(ids))])
            names = {words[int(i)]: tint for i, tint in zip(ids, tints, strict=True)}
            colors = tints[rank]
            if kind == "rods":  # every other piece of a geom darker, to tell them apart
                _, first, geom = np.unique(elements["geom"], return_index=True, return_inverse=True)
                colors[(np.arange(len(elements)) - first[geom]) % 2 == 1] *= 0.75
        else:
            raise UnknownNameError("way to color elements", color, get_args(Color))
        body = elements["body"]
        turn = data.xmat[body].reshape(-1, 3, 3)
        return cls(kind, elements, data.xpos[body], turn, report, colors, names)

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

    def forces(self, scale: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Return both ends of arrows of the forces [m], each of shape (m, 3), m at most n.

        Forces push facets from outside: their arrows end where the force acts. Others start there.
        The length of a newton [m] is by default such that the largest force takes 0.3 of the reach.
        """
        table = self.report.table
        size = np.linalg.norm(table.force, axis=1)
        if scale is None:
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


def _depth_colors(depth: np.ndarray) -> np.ndarray:
    """Return the colors of depths, from the shallowest to the deepest, shape (n, 3)."""
    stops = np.array([rgb(color) for color in DEPTHS])
    share = (depth - depth.min()) / max(float(np.ptp(depth)), 1e-300)
    at = np.linspace(0, 1, len(stops))
    return np.stack([np.interp(share, at, stops[:, k]) for k in range(3)], axis=1)
