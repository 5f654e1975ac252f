"""The elements that a law acts on, to be looked at: in a figure, or in a scene of MuJoCo's."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import mujoco
import numpy as np

from mjgranular.errors import InputError, UnknownNameError
from mjgranular.extras import need
from mjgranular.files import whole
from mjgranular.picture.plain import plain
from mjgranular.sand import Report, Sand
from mjgranular.surface import Plane

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Kind = Literal["rods", "facets", "blobs"]
Color = Literal["body", "geom", "depth"]

# A field that the elements of one kind have and those of the others have not.
_MARKS: dict[str, Kind] = {"half_length": "rods", "normal": "facets", "halves": "blobs"}

FORMATS = (".png", ".svg", ".pdf")
"""Endings of the files that a figure can be written to."""

# Okabe and Ito's colours, which stay apart for colour-blind readers.
_PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#8A8A8A", "#F0E442")
_DEPTHS = ("#F7E3B5", "#E0A85E", "#B0653B", "#6B3A3A", "#2B1B33")  # shallow to deep
_RED, _SAND, _INK = "#C0281C", "#D9BC85", "#303030"

_STYLE = {
    "font.size": 9,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
}
_MOST_NAMED = 10  # entries of a legend
_AROUND = 24  # corners of what is drawn for a circle
_LEAST_SIDE = 0.25  # of a figure's box, as a share of its longest side
_LEAST_SHARE = 0.25  # of a facet's area has the parallelogram of its edges, or it is a disc
_GAP = 0.97  # of their size have bodies in a scene, so that neighbours can be told apart
_LIGHT = np.array([0.35, -0.60, 0.72])  # towards the light of a figure


@dataclass(frozen=True)
class _Shown:
    """Elements at one instant, in the world frame.

    Attributes:
        kind: what they are.
        elements: as the law has them.
        origin: of each element's body [m], shape (n, 3).
        turn: axes of each element's body in columns, shape (n, 3, 3).
        report: what the sand does to them.
        colors: red, green and blue, 0 to 1, shape (n, 3).
        names: what the colours stand for, in the order of the model; empty for depths.
    """

    kind: Kind
    elements: np.ndarray
    origin: np.ndarray
    turn: np.ndarray
    report: Report
    colors: np.ndarray
    names: dict[str, np.ndarray]

    @classmethod
    def at(cls, sand: Sand, data: mujoco.MjData, color: str) -> _Shown:
        """The elements where the bodies in `data` are."""
        kind, elements, report = kind_of(sand), sand.elements, sand.report(data)
        if color == "depth":
            names, colors = {}, _depth_colors(report.table.depth)
        elif color in get_args(Color):
            words = report.names.bodies if color == "body" else report.names.geoms
            ids, rank = np.unique(elements[color], return_inverse=True)
            tints = np.array([_rgb(_PALETTE[k % len(_PALETTE)]) for k in range(len(ids))])
            names = {words[int(i)]: tint for i, tint in zip(ids, tints, strict=True)}
            colors = tints[rank]
            if kind == "rods":  # every other piece of a geom darker, lest they look like one
                _, first, geom = np.unique(elements["geom"], return_index=True, return_inverse=True)
                colors[(np.arange(len(elements)) - first[geom]) % 2 == 1] *= 0.75
        else:
            raise UnknownNameError("way to colour elements", color, get_args(Color))
        body = elements["body"]
        turn = data.xmat[body].reshape(-1, 3, 3)
        return cls(kind, elements, data.xpos[body], turn, report, colors, names)

    def place(self, local: np.ndarray) -> np.ndarray:
        """World positions of points given in the frames of the bodies, shape (n, k, 3)."""
        return self.origin[:, None] + np.einsum("nij,nkj->nki", self.turn, local)

    @property
    def middles(self) -> np.ndarray:
        """World positions of the elements' middles [m], shape (n, 3)."""
        name = "point" if self.kind == "facets" else "center"
        return self.place(self.elements[name][:, None])[:, 0]

    @property
    def sizes(self) -> np.ndarray:
        """Size of each element [m], shape (n,)."""
        e = self.elements
        if self.kind == "facets":
            return np.sqrt(e["area"])
        if self.kind == "rods":
            return 2 * e["half_length"]
        return 2 * (e["radii"] + e["halves"] + e["disc"][:, None]).max(axis=1)

    @property
    def reach(self) -> float:
        """Size of all of them together [m]."""
        middles, half = self.middles, self.sizes[:, None] / 2
        return float(((middles + half).max(axis=0) - (middles - half).min(axis=0)).max())

    def normals(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends of short normals of the facets [m], each of shape (n, 3)."""
        if self.kind != "facets":
            return np.zeros((0, 3)), np.zeros((0, 3))
        length = np.minimum(0.5 * self.sizes, 0.06 * self.reach)
        ends = self.elements["point"] + length[:, None] * self.elements["normal"]
        return self.middles, self.place(ends[:, None])[:, 0]

    def forces(self, scale: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Ends of arrows of the forces [m], each of shape (m, 3), m at most n.

        Facets are pushed from outside: their arrows end where the force acts. Others begin there.

        Args:
            scale: length of one newton [m]; None to make the greatest force 0.3 of the reach.
        """
        table = self.report.table
        size = np.linalg.norm(table.force, axis=1)
        if scale is None:
            scale = 0.3 * self.reach / max(float(size.max()), 1e-300)
        seen = scale * size > 2e-3 * self.reach
        point, arrow = table.point[seen], scale * table.force[seen]
        return (point - arrow, point) if self.kind == "facets" else (point, point + arrow)


def kind_of(sand: Sand) -> Kind:
    """Finds the kind of elements that a law has cut the geoms into.

    Raises:
        InputError: a law of one's own with elements of another kind.
    """
    fields = sand.elements.dtype.names or ()
    for mark, kind in _MARKS.items():
        if mark in fields:
            return kind
    raise InputError(
        f"the law {sand.law.name!r} has elements of a kind of its own ({', '.join(fields)}): rods, "
        "facets and blobs can be drawn"
    )


def count(number: int, things: str) -> str:
    """A number of things in words: "1 facet", "184 facets", "2 bodies"."""
    one = "body" if things == "bodies" else things.removesuffix("s")
    return f"{number} {one if number == 1 else things}"


def check_file(file: Path) -> None:
    """Refuses a file that no figure can be written to.

    Raises:
        InputError: its ending is none of `FORMATS`.
    """
    if file.suffix.lower() not in FORMATS:
        raise InputError(
            f"a figure is written as {', '.join(FORMATS[:-1])} or {FORMATS[-1]}, not "
            f"{file.suffix or file.name!r}"
        )


def draw_elements(
    sand: Sand,
    *,
    qpos: Sequence[float] | np.ndarray | None = None,
    qvel: Sequence[float] | np.ndarray | None = None,
    color: Color = "body",
    normals: bool = True,
    forces: bool = False,
    title: str | None = None,
    file: str | Path | None = None,
) -> Figure:
    """Draws the elements as they lie on the bodies, in space, all axes to the same scale.

    Rods have their length and width. A facet is a parallelogram, or a disc where it has no edges,
    as a mesh's triangle; its area is the true one. Blobs are drawn as the outlines that their
    support functions describe. Where a plane of sand passes through the picture, it is drawn too.

    Args:
        sand: whose elements.
        qpos: where the bodies are; None for the model's `qpos0`.
        qvel: how they move; None for not at all. Matters to `forces` only.
        color: what colours stand for: "body", "geom", or "depth" below the surface.
        normals: whether facets have their normals drawn.
        forces: whether the sand's force on each element is drawn, as an arrow.
        title: first line above the picture, over the counts.
        file: to save the picture in, .png, .svg or .pdf; None for none.

    Returns:
        The figure, made without pyplot.

    Raises:
        InputError: a state of the wrong length or not finite, or a kind of file that cannot be
            written.
        UnknownNameError: nothing can be coloured so; lists the ways.
        MissingExtraError: matplotlib is not installed; gives the install line.
        OutputError: the file cannot be written.
    """
    if file is not None:
        check_file(Path(file))
    matplotlib = need("matplotlib", extra="figures", purpose="Drawing elements")
    need("matplotlib.figure", extra="figures", purpose="Drawing elements")
    data = mujoco.MjData(sand.model)
    _set_state(data.qpos, qpos, "qpos")
    _set_state(data.qvel, qvel, "qvel")
    mujoco.mj_kinematics(sand.model, data)
    shown = _Shown.at(sand, data, color)
    with matplotlib.rc_context(_STYLE):
        figure = matplotlib.figure.Figure(figsize=(6.4, 5.6), layout="none")
        _draw(figure, shown, sand.surface, normals=normals, forces=forces)
        lines = [plain(title)] if title else []
        bodies, geoms = (len(np.unique(shown.elements[key])) for key in ("body", "geom"))
        lines.append(
            f"{count(len(shown.elements), shown.kind)} of {count(geoms, 'geoms')} on "
            f"{count(bodies, 'bodies')}, {sand.law.name} law"
        )
        figure.suptitle("\n".join(lines), y=0.985, va="top", fontsize=10)
        if file is not None:
            _save(figure, Path(file))
    return figure


def _set_state(target: np.ndarray, values: Sequence[float] | np.ndarray | None, name: str) -> None:
    if values is None:
        return
    given = np.asarray(values, dtype=float)
    if given.shape != target.shape:
        raise InputError(f"{name} must have shape {target.shape}, not {given.shape}")
    if not np.isfinite(given).all():
        raise InputError(f"{name} must be finite, not {given}")
    target[:] = given


def _save(figure: Figure, file: Path) -> None:
    with whole(file) as part:
        figure.savefig(part, dpi=150, facecolor="white", bbox_inches="tight", pad_inches=0.15)


def _draw(figure: Any, shown: _Shown, surface: Any, *, normals: bool, forces: bool) -> None:
    """Draws the elements, the sand and what the colours mean into an empty figure."""
    art = need("mpl_toolkits.mplot3d.art3d", extra="figures", purpose="Drawing elements")
    axes = figure.add_axes((0.0, 0.06, 0.88, 0.86), projection="3d", computed_zorder=False)
    polygons, owners = _polygons(shown)
    tails, tips = shown.normals() if normals else (np.zeros((0, 3)),) * 2
    lines = _padded(np.stack([tails, tips], axis=1), polygons.shape[1])
    faces = _shaded(polygons, shown.colors[owners])
    edges = 0.45 * shown.colors[owners]
    if shown.kind == "rods":
        round_sides = slice(None, _AROUND * len(shown.elements))
        edges[round_sides] = faces[round_sides]
    alpha = 0.55 if shown.kind == "blobs" else 1.0
    ink = np.tile([*_rgb(_INK), 1.0], (len(lines), 1))
    # One collection for all: only within one are polygons sorted by their distance.
    axes.add_collection3d(
        art.Poly3DCollection(
            np.concatenate([polygons, lines]),
            facecolors=np.concatenate([_with_alpha(faces, alpha), ink]),
            edgecolors=np.concatenate([_with_alpha(edges, alpha), ink]),
            linewidths=[0.35] * len(polygons) + [0.6] * len(lines),
            zorder=2,
        )
    )
    points = np.concatenate([polygons.reshape(-1, 3), tips])
    tails, tips = shown.forces(None) if forces else (np.zeros((0, 3)),) * 2
    if len(tails):
        arrows = tips - tails
        style = {"color": _RED, "linewidth": 1.1, "arrow_length_ratio": 0.2, "zorder": 3}
        axes.quiver(*tails.T, *arrows.T, **style)
        points = np.concatenate([points, tails, tips])
    low, high = _box(points)
    if isinstance(surface, Plane):
        _draw_plane(axes, art, surface, low, high)
    _set_axes(axes, low, high)
    if shown.names:
        _draw_legend(figure, shown.names)
    else:
        _draw_scale(figure, shown.report.table.depth)


def _box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the box that is shown: around all points, no side much shorter than another."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = (low + high) / 2, 1.04 * (high - low) / 2
    half = np.maximum(half, _LEAST_SIDE * half.max())
    return middle - half, middle + half


def _set_axes(axes: Any, low: np.ndarray, high: np.ndarray) -> None:
    side = (high - low) / (high - low).max()
    axes.set_box_aspect(side, zoom=1.0)
    axes.view_init(elev=22, azim=-56)
    for k, name in enumerate("xyz"):
        getattr(axes, f"set_{name}lim")(low[k], high[k])
        getattr(axes, f"set_{name}label")(f"{name} [m]", labelpad=2 + 6 * side[k])
        axes.locator_params(axis=name, nbins=max(2, round(5 * side[k])))
        getattr(axes, f"{name}axis").set_pane_color((0.98, 0.98, 0.98, 1.0))
    axes.tick_params(labelsize=8, pad=1)


def _draw_plane(axes: Any, art: Any, plane: Plane, low: np.ndarray, high: np.ndarray) -> None:
    """Draws the sand's surface where it passes through the box."""
    cut = _cut_box(plane, low, high)
    if len(cut) < 3:
        return
    axes.add_collection3d(
        art.Poly3DCollection([cut], facecolors=[(*_rgb(_SAND), 0.3)], edgecolors="none", zorder=1)
    )
    outline = np.vstack([cut, cut[:1]])
    axes.plot(*outline.T, color="#9A7B45", linewidth=0.9, linestyle="--", zorder=1)


def _cut_box(plane: Plane, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Corners, in order, of what a box cuts out of a plane, shape (k, 3), k at most 6."""
    sides = np.array(list(itertools.product((0, 1), repeat=3)))
    corners = low + sides * (high - low)
    above = (corners - [0, 0, plane.height]) @ plane.normal
    ends = [
        (i, j)
        for i, j in itertools.combinations(range(8), 2)
        if np.abs(sides[i] - sides[j]).sum() == 1 and (above[i] > 0) != (above[j] > 0)
    ]
    i, j = np.array(ends, dtype=int).reshape(-1, 2).T
    share = above[i] / (above[i] - above[j])
    points = corners[i] + share[:, None] * (corners[j] - corners[i])
    across = (points - points.sum(axis=0) / max(len(points), 1)) @ _frames(plane.normal[None])[0]
    return points[np.argsort(np.arctan2(across[:, 1], across[:, 0]))]


def _draw_legend(figure: Any, names: dict[str, np.ndarray]) -> None:
    patches = need("matplotlib.patches", extra="figures", purpose="Drawing elements")
    if len(names) < 2:
        return
    first = list(names.items())[:_MOST_NAMED]
    handles = [patches.Patch(color=tint, label=plain(name)) for name, tint in first]
    if len(names) > len(first):
        handles.append(patches.Patch(color="none", label=f"and {len(names) - len(first)} more"))
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, 0.90))


def _draw_scale(figure: Any, depth: np.ndarray) -> None:
    """Scale of the colours of depth."""
    cm = need("matplotlib.cm", extra="figures", purpose="Drawing elements")
    colors = need("matplotlib.colors", extra="figures", purpose="Drawing elements")
    low, high = float(depth.min()), float(depth.max())
    scale = cm.ScalarMappable(
        colors.Normalize(low, high), colors.LinearSegmentedColormap.from_list("depth", _DEPTHS)
    )
    bar = figure.colorbar(scale, cax=figure.add_axes((0.92, 0.27, 0.02, 0.44)))
    bar.set_label("depth below the surface [m]")
    bar.ax.invert_yaxis()
    bar.ax.tick_params(labelsize=8)
    bar.outline.set_visible(False)
    if low < 0 < high:
        bar.ax.axhline(0.0, color=_INK, linewidth=1.2)


def _polygons(shown: _Shown) -> tuple[np.ndarray, np.ndarray]:
    """Polygons of elements in the world frame, and the element that each belongs to."""
    e, n = shown.elements, np.arange(len(shown.elements))
    if shown.kind == "facets":
        return shown.place(_facet_corners(e)), n
    if shown.kind == "rods":
        rims = shown.place(_rod_rims(e)).reshape(-1, 2, _AROUND, 3)
        after = np.roll(rims, -1, axis=2)
        sides = np.stack([rims[:, 0], after[:, 0], after[:, 1], rims[:, 1]], axis=2)
        polygons = [_padded(sides.reshape(-1, 4, 3), _AROUND), rims.reshape(-1, _AROUND, 3)]
        return np.concatenate(polygons), np.concatenate([n.repeat(_AROUND), n.repeat(2)])
    grids = shown.place(_blob_points(e)).reshape(len(e), -1, _AROUND, 3)
    after = np.roll(grids, -1, axis=2)
    quads = np.stack([grids[:, :-1], grids[:, 1:], after[:, 1:], after[:, :-1]], axis=3)
    sides = _padded(quads.reshape(-1, 4, 3), _AROUND)
    polygons = np.concatenate([sides, grids[:, 0], grids[:, -1]])
    owners = np.concatenate([n.repeat(len(sides) // len(e)), n, n])
    # Directions that share their outermost points, as at a corner, leave nothing between them.
    area = np.linalg.norm(_area_vectors(polygons), axis=1)
    seen = area > 1e-6 * shown.sizes[owners] ** 2
    return polygons[seen], owners[seen]


def _padded(polygons: np.ndarray, corners: int) -> np.ndarray:
    """Polygons with their last corners repeated until they have so many."""
    last = np.repeat(polygons[:, -1:], corners - polygons.shape[1], axis=1)
    return np.concatenate([polygons, last], axis=1)


def _facet_corners(facets: np.ndarray) -> np.ndarray:
    """Corners of facets in their bodies' frames, shape (n, k, 3): of their true area."""
    wide, edges = _half_edges(facets)
    around = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) @ edges
    if not wide.all():
        discs = _disc_radius(facets["area"])[:, None, None] * _circles(facets["normal"])
        discs[wide] = _padded(around, _AROUND)
        around = discs
    return facets["point"][:, None] + around


def _half_edges(facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Facets that are drawn as parallelograms, shape (n,), and their half edges, shape (m, 2, 3).

    The edges are scaled to the facets' areas. A triangle by itself has none, a patch that is hidden
    but for a strip hardly any: those are drawn as discs.
    """
    if "edges" not in (facets.dtype.names or ()):
        return np.zeros(len(facets), bool), np.zeros((0, 2, 3))
    edges = facets["edges"]
    area = 4 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    wide = area > _LEAST_SHARE * facets["area"]
    return wide, edges[wide] * np.sqrt(facets["area"][wide] / area[wide])[:, None, None]


def _rod_rims(rods: np.ndarray) -> np.ndarray:
    """Corners of the two ends of rods in their bodies' frames, shape (n, 2 * _AROUND, 3)."""
    ring = (rods["width"] / 2)[:, None, None] * _circles(rods["axis"])
    along = (rods["half_length"][:, None] * rods["axis"])[:, None]
    return rods["center"][:, None] + np.concatenate([ring - along, ring + along], axis=1)


def _circles(axes: np.ndarray) -> np.ndarray:
    """Points on circles of radius 1 about axes, shape (n, _AROUND, 3)."""
    turn = 2 * math.pi * np.arange(_AROUND) / _AROUND
    return np.stack([np.cos(turn), np.sin(turn)], axis=1) @ _frames(axes)[:, :, :2].mT


def _blob_points(blobs: np.ndarray) -> np.ndarray:
    """Points of blobs in their bodies' frames, shape (n, (_AROUND / 2) * _AROUND, 3).

    They are the outermost points in directions of a grid of latitude and longitude, none of which
    lies in a plane of symmetry, where a box would have more than one.
    """
    polar = math.pi * (np.arange(_AROUND // 2) + 0.5) / (_AROUND // 2)
    turn = 2 * math.pi * (np.arange(_AROUND) + 0.5) / _AROUND
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


def _frames(axes: np.ndarray) -> np.ndarray:
    """Right-handed frames in columns whose z is a given unit vector, shape (n, 3, 3)."""
    first = np.cross(axes, np.eye(3)[np.argmin(np.abs(axes), axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(axes, first), axes], axis=2)


def _disc_radius(area: np.ndarray) -> np.ndarray:
    """Radius of the regular polygon with as many corners as a circle is drawn with [m]."""
    return np.sqrt(2 * area / (_AROUND * math.sin(2 * math.pi / _AROUND)))


def _area_vectors(polygons: np.ndarray) -> np.ndarray:
    """Area times normal of polygons of equally many corners, shape (n, 3)."""
    arms = polygons - polygons[:, :1]
    return np.cross(arms[:, 1:-1], arms[:, 2:]).sum(axis=1) / 2


def _shaded(polygons: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Colours of polygons under a light, whichever side is seen."""
    normals = _area_vectors(polygons)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    light = np.abs(normals @ (_LIGHT / np.linalg.norm(_LIGHT)))
    return 1 - (1 - colors) * (0.55 + 0.45 * (1 - light))[:, None]


def _rgb(color: str) -> np.ndarray:
    """Red, green and blue, 0 to 1, of a colour as #RRGGBB."""
    return np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255


def _with_alpha(colors: np.ndarray, alpha: float) -> np.ndarray:
    return np.column_stack([colors, np.full(len(colors), alpha)])


def _depth_colors(depth: np.ndarray) -> np.ndarray:
    """Colours between the shallowest and the deepest of some depths, shape (n, 3)."""
    stops = np.array([_rgb(color) for color in _DEPTHS])
    share = (depth - depth.min()) / max(float(np.ptp(depth)), 1e-300)
    at = np.linspace(0, 1, len(stops))
    return np.stack([np.interp(share, at, stops[:, k]) for k in range(3)], axis=1)


def add_elements(
    scene: mujoco.MjvScene,
    sand: Sand,
    data: mujoco.MjData,
    *,
    color: Color = "body",
    normals: bool = True,
    forces: bool = False,
    force_scale: float | None = None,
    fade: float = 0.25,
) -> int:
    """Adds the elements to a scene, as decoration: to the scene of a renderer or of a viewer.

    Call it after `renderer.update_scene(data)`, or for a passive viewer with `viewer.user_scn`,
    whose `ngeom` is set to 0 first. Positions are those in `data`, as the scene's own are. Facets
    are thin slabs (discs where they have no edges), rods cylinders, blobs solids.

    Args:
        scene: to be added to.
        sand: whose elements.
        data: the simulation.
        color: what colours stand for: "body", "geom", or "depth" below the surface.
        normals: whether facets have their normals drawn.
        forces: whether the sand's force on each element is drawn, as an arrow.
        force_scale: length of an arrow of one newton [m]; None to make the greatest of the instant
            0.3 of the size of all elements.
        fade: opacity that is left to the geoms that the elements are made from, and to a bed or
            height field of sand, where the scene holds them. A viewer's `user_scn` does not:
            there, press T to see through them.

    Returns:
        How many geoms were added.

    Raises:
        InputError: the scene has too little room, and then nothing is added; or `data` belongs to
            another model.
        UnknownNameError: nothing can be coloured so; lists the ways.
    """
    shown = _Shown.at(sand, data, color)
    tails, tips = shown.normals() if normals else (np.zeros((0, 3)),) * 2
    starts, ends = shown.forces(force_scale) if forces else (np.zeros((0, 3)),) * 2
    needed, room = len(shown.elements) + len(tails) + len(starts), scene.maxgeom - scene.ngeom
    if needed > room:
        raise InputError(
            f"the scene has room for {room} more geoms and {needed} are needed: make it larger "
            "(mujoco.Renderer(..., max_geom=...)), say normals=False, or cut with a lower "
            "resolution"
        )
    mine = {*np.unique(shown.elements["geom"]).tolist(), *sand.surface.geoms(sand.model)}
    for geom in scene.geoms[: scene.ngeom]:
        if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in mine:
            geom.rgba[3] = min(fade, float(geom.rgba[3]))
    before = scene.ngeom
    _add_bodies(scene, shown)
    thickness = 0.03 * shown.sizes
    for tail, tip, width in zip(tails, tips, thickness, strict=False):
        _add_arrow(scene, tail, tip, float(width), _INK)
    for tail, tip in zip(starts, ends, strict=True):
        _add_arrow(scene, tail, tip, 0.006 * shown.reach, _RED)
    return scene.ngeom - before


def _add_bodies(scene: mujoco.MjvScene, shown: _Shown) -> None:
    """Adds what stands for the elements themselves."""
    place = {"facets": _facet_bodies, "rods": _rod_bodies, "blobs": _blob_bodies}[shown.kind]
    kinds, sizes, frames = place(shown.elements)
    frames = shown.turn @ frames
    alpha = 0.5 if shown.kind == "blobs" else 1.0
    rgba = _with_alpha(shown.colors, alpha).astype(np.float32)
    for k, middle in enumerate(shown.middles):
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(geom, kinds[k], sizes[k], middle, frames[k].ravel(), rgba[k])
        scene.ngeom += 1


# Of each element: the type of geom, its size as a model has it (n, 3), its axes in the body's frame
# in columns (n, 3, 3).
_Bodies = tuple[list[mujoco.mjtGeom], np.ndarray, np.ndarray]


def _facet_bodies(facets: np.ndarray) -> _Bodies:
    thin = 0.01 * np.sqrt(facets["area"])
    sizes = np.column_stack([np.sqrt(facets["area"] / math.pi), thin, thin])
    frames = _frames(facets["normal"])
    wide, edges = _half_edges(facets)
    # A scene takes axes that are not square to each other: the slab becomes a slanted one.
    lengths = np.linalg.norm(edges, axis=2)
    axes = np.concatenate([edges / lengths[..., None], facets["normal"][wide, None]], axis=1)
    sizes[wide] = np.column_stack([_GAP * lengths, thin[wide]])
    frames[wide] = axes.mT
    box, disc = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
    return [box if k else disc for k in wide], sizes, frames


def _rod_bodies(rods: np.ndarray) -> _Bodies:
    radius = rods["width"] / 2
    sizes = np.column_stack([radius, _GAP * rods["half_length"], radius])
    return [mujoco.mjtGeom.mjGEOM_CYLINDER] * len(rods), sizes, _frames(rods["axis"])


def _blob_bodies(blobs: np.ndarray) -> _Bodies:
    kinds = []
    sizes = blobs["radii"] + blobs["halves"]
    for blob, size in zip(blobs, sizes, strict=True):
        if blob["disc"] > 0:
            kinds.append(mujoco.mjtGeom.mjGEOM_CYLINDER)
            size[:2] = blob["disc"], blob["halves"][2]
        elif not blob["radii"].any():
            kinds.append(mujoco.mjtGeom.mjGEOM_BOX)
        elif blob["halves"].any():
            kinds.append(mujoco.mjtGeom.mjGEOM_CAPSULE)
            size[1] = blob["halves"][2]
        else:
            kinds.append(mujoco.mjtGeom.mjGEOM_ELLIPSOID)
    return kinds, sizes, blobs["axes"].reshape(-1, 3, 3)


def _add_arrow(
    scene: mujoco.MjvScene, tail: np.ndarray, tip: np.ndarray, width: float, color: str
) -> None:
    arrow = mujoco.mjtGeom.mjGEOM_ARROW
    geom = scene.geoms[scene.ngeom]
    rgba = np.array([*_rgb(color), 1.0], dtype=np.float32)
    mujoco.mjv_initGeom(geom, arrow, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
    mujoco.mjv_connector(geom, arrow, width, tail, tip)
    scene.ngeom += 1
