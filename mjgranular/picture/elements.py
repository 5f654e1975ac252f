"""The elements that a law acts on, in a figure or as solids in a MuJoCo scene."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from mjgranular._util.checks import require
from mjgranular._util.files import atomic_write
from mjgranular.errors import InputError
from mjgranular.picture import outlines
from mjgranular.picture.figures import plain
from mjgranular.picture.outlines import Color, Shown
from mjgranular.picture.outlines import kind_of as kind_of
from mjgranular.picture.scene import add_arrow
from mjgranular.sand import Sand
from mjgranular.surface import Plane

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")  # file extensions that a figure can be written to
GAP = 0.97  # relative size of solids, less than one so that neighbors can be distinguished

_SAND = "#D9BC85"
_FADED = 0.25  # opacity of geoms around elements
_NONE = np.zeros((2, 0, 3))  # ends of no arrows
_STYLE = {
    "font.size": 9, "grid.color": "#DDDDDD", "grid.linewidth": 0.6, "legend.frameon": False,
}  # fmt: skip
_MOST_NAMED = 10  # entries of a legend
_LEAST_SIDE = 0.25  # least side of a figure's box, relative to its longest side
_LIGHT = np.array([0.35, -0.60, 0.72])  # toward the light of a figure


def count(number: int, things: str) -> str:
    """Return a count of things: "1 facet", "184 facets", "2 bodies"."""
    one = "body" if things == "bodies" else things.removesuffix("s")
    return f"{number} {one if number == 1 else things}"


def check_file(file: Path) -> None:
    """Check that a figure can be written to a file."""
    if file.suffix.lower() not in FORMATS:
        raise InputError(
            f"a figure is written as {', '.join(FORMATS[:-1])} or {FORMATS[-1]}, not "
            f"{file.suffix or file.name!r}"
        )


def draw_elements(
    sand: Sand,
    data: mujoco.MjData | None = None,
    *,
    color: Color = "body",
    normals: bool = True,
    forces: bool = False,
    title: str | None = None,
    file: str | Path | None = None,
) -> Figure:
    """Draw the elements on the bodies in 3D, all axes to the same scale.

    Rods have their length and width. A facet is a parallelogram with its true area, or a disc if it
    has no edges, like a triangle of a mesh. Blobs are drawn as the outlines that their support
    functions describe. A plane of sand is drawn where it passes through the picture.

    Args:
        sand: the sand whose elements are drawn.
        data: the simulation, of which `qpos` is drawn; None for the model's `qpos0`, at rest.
        color: meaning of the colors: "body" or "geom".
        normals: whether normals of facets are drawn.
        forces: whether the sand's force on each element is drawn, as an arrow.
        title: first line above the picture, above the counts.
        file: file for the picture, .png, .svg or .pdf; None to save nothing.

    Returns:
        The figure, made without pyplot.

    Raises:
        InputError: `data` belongs to another model, or a kind of file that cannot be written.
        UnknownNameError: no such coloring; lists the valid ones.
        MissingExtraError: matplotlib is not installed; gives the install line.
        OutputError: the file cannot be written.
    """
    if file is not None:
        check_file(Path(file))
    matplotlib = require("matplotlib", extra="figures", purpose="Drawing elements")
    require("matplotlib.figure", extra="figures", purpose="Drawing elements")
    data = mujoco.MjData(sand.model) if data is None else data
    shown = Shown.at(sand, data, color, of_state=True)
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
            with atomic_write(Path(file)) as part:
                style = {"facecolor": "white", "bbox_inches": "tight", "pad_inches": 0.15}
                figure.savefig(part, dpi=150, **style)
    return figure


def _draw(figure: Any, shown: Shown, surface: Any, *, normals: bool, forces: bool) -> None:
    """Draw the elements, the sand and a legend into an empty figure."""
    art = require("mpl_toolkits.mplot3d.art3d", extra="figures", purpose="Drawing elements")
    axes = figure.add_axes((0.0, 0.06, 0.88, 0.86), projection="3d", computed_zorder=False)
    polygons, owners = outlines.polygons_of(shown)
    tails, tips = shown.normals() if normals else _NONE
    lines = outlines.padded(np.stack([tails, tips], axis=1), polygons.shape[1])
    faces = _shaded(polygons, shown.colors[owners])
    edges = 0.45 * shown.colors[owners]
    if shown.kind == "rods":
        round_sides = slice(None, outlines.AROUND * len(shown.elements))
        edges[round_sides] = faces[round_sides]
    alpha = 0.55 if shown.kind == "blobs" else 1.0
    ink = np.tile([*outlines.rgb(outlines.INK), 1.0], (len(lines), 1))
    # One collection for all: only within one are polygons sorted by their distance.
    axes.add_collection3d(
        art.Poly3DCollection(
            np.concatenate([polygons, lines]),
            facecolors=np.concatenate([outlines.with_alpha(faces, alpha), ink]),
            edgecolors=np.concatenate([outlines.with_alpha(edges, alpha), ink]),
            linewidths=[0.35] * len(polygons) + [0.6] * len(lines),
            zorder=2,
        )
    )
    points = np.concatenate([polygons.reshape(-1, 3), tips])
    tails, tips = shown.forces() if forces else _NONE
    if len(tails):
        arrows = tips - tails
        style = {"color": outlines.RED, "linewidth": 1.1, "arrow_length_ratio": 0.2, "zorder": 3}
        axes.quiver(*tails.T, *arrows.T, **style)
        points = np.concatenate([points, tails, tips])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = (low + high) / 2, 1.04 * (high - low) / 2
    half = np.maximum(half, _LEAST_SIDE * half.max())
    low, high = middle - half, middle + half
    if isinstance(surface, Plane):
        _draw_plane(axes, art, surface, low, high)
    _set_axes(axes, low, high)
    _draw_legend(figure, shown.names)


def _shaded(polygons: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Return the colors of polygons under a light, from either side."""
    normals = outlines.area_vectors(polygons)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    light = np.abs(normals @ (_LIGHT / np.linalg.norm(_LIGHT)))
    return 1 - (1 - colors) * (0.55 + 0.45 * (1 - light))[:, None]


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
    """Draw the sand's surface over the ground of the box, if it passes through the box."""
    x, y = np.array([(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]).T
    along, across, up = plane.normal
    z = plane.height - (along * x + across * y) / up
    if z.max() >= low[2] and z.min() <= high[2]:
        sheet = art.Poly3DCollection([np.column_stack([x, y, z])], zorder=1, linestyles="--")
        sheet.set(facecolor=(*outlines.rgb(_SAND), 0.3), edgecolor="#9A7B45", linewidth=0.9)
        axes.add_collection3d(sheet)


def _draw_legend(figure: Any, names: dict[str, np.ndarray]) -> None:
    patches = require("matplotlib.patches", extra="figures", purpose="Drawing elements")
    if len(names) < 2:
        return
    first = list(names.items())[:_MOST_NAMED]
    handles = [patches.Patch(color=tint, label=plain(name)) for name, tint in first]
    if len(names) > len(first):
        handles.append(patches.Patch(color="none", label=f"and {len(names) - len(first)} more"))
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, 0.90))


def add_elements(
    scene: mujoco.MjvScene,
    sand: Sand,
    data: mujoco.MjData,
    *,
    color: Color = "body",
    normals: bool = True,
    forces: bool = False,
) -> int:
    """Add the elements to a scene, as decoration: to the scene of a renderer or of a viewer.

    Call it after `renderer.update_scene(data)`, or for a passive viewer with `viewer.user_scn`,
    whose `ngeom` is set to 0 first. Positions are those in `data`, as for the scene itself. Facets
    are thin slabs (discs if they have no edges), rods are cylinders, blobs are solids.

    The geoms that they are made from, and a bed or height field of sand, become transparent if the
    scene has them. A viewer's `user_scn` does not: there, press T to see through them.

    Return the number of geoms added. The options are those of `draw_elements`.

    Raises:
        InputError: too few free geoms in the scene (nothing is added), or `data` of another model.
        UnknownNameError: no such coloring; lists the valid ones.
    """
    shown = Shown.at(sand, data, color)
    tails, tips = shown.normals() if normals else _NONE
    starts, ends = shown.forces() if forces else _NONE
    needed, free = len(shown.elements) + len(tails) + len(starts), scene.maxgeom - scene.ngeom
    if needed > free:
        raise InputError(
            f"the scene can hold {free} more geoms and {needed} are needed: make it larger "
            "(mujoco.Renderer(..., max_geom=...)), use normals=False, or a lower resolution"
        )
    mine = {*np.unique(shown.elements["geom"]).tolist(), *sand.surface.geoms(sand.model)}
    for geom in scene.geoms[: scene.ngeom]:
        if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in mine:
            geom.rgba[3] = min(_FADED, float(geom.rgba[3]))
    before = scene.ngeom
    _add_bodies(scene, shown)
    thickness = 0.03 * shown.sizes
    for tail, tip, width in zip(tails, tips, thickness, strict=False):
        add_arrow(scene, tail, tip, float(width), outlines.rgb(outlines.INK))
    for tail, tip in zip(starts, ends, strict=True):
        add_arrow(scene, tail, tip, 0.006 * shown.reach, outlines.rgb(outlines.RED))
    return scene.ngeom - before


def _add_bodies(scene: mujoco.MjvScene, shown: Shown) -> None:
    place = {"facets": facet_bodies, "rods": _rod_bodies, "blobs": _blob_bodies}[shown.kind]
    kinds, sizes, frames = place(shown.elements)
    frames = shown.turn @ frames
    alpha = 0.5 if shown.kind == "blobs" else 1.0
    rgba = outlines.with_alpha(shown.colors, alpha).astype(np.float32)
    for k, middle in enumerate(shown.middles):
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(geom, kinds[k], sizes[k], middle, frames[k].ravel(), rgba[k])
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        scene.ngeom += 1


# Of each element: geom type, size as in a model (n, 3), axes in the body's frame, columns (n, 3, 3)
_Bodies = tuple[list[mujoco.mjtGeom], np.ndarray, np.ndarray]


def facet_bodies(facets: np.ndarray) -> _Bodies:
    """Return slabs, slanted like the edges; discs for facets without edges."""
    thin = 0.01 * np.sqrt(facets["area"])
    sizes = np.column_stack([np.sqrt(facets["area"] / math.pi), thin, thin])
    frames = outlines.frames_of(facets["normal"])
    wide, edges = outlines.half_edges(facets)
    # A scene accepts axes that are not orthogonal: the slab is sheared.
    lengths = np.linalg.norm(edges, axis=2)
    axes = np.concatenate([edges / lengths[..., None], facets["normal"][wide, None]], axis=1)
    sizes[wide] = np.column_stack([GAP * lengths, thin[wide]])
    frames[wide] = axes.mT
    box, disc = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
    return [box if k else disc for k in wide], sizes, frames


def _rod_bodies(rods: np.ndarray) -> _Bodies:
    radius = rods["width"] / 2
    sizes = np.column_stack([radius, GAP * rods["half_length"], radius])
    return [mujoco.mjtGeom.mjGEOM_CYLINDER] * len(rods), sizes, outlines.frames_of(rods["axis"])


def _blob_bodies(blobs: np.ndarray) -> _Bodies:
    kinds, sizes = [], blobs["radii"] + blobs["halves"]
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
