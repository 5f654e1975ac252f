"""Elements as solids in a MuJoCo scene."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.picture.outlines import frames_of, half_edges
from mjgranular.picture.scene import add_arrow
from mjgranular.picture.shown import INK, RED, Color, Shown, rgb, with_alpha
from mjgranular.sand import Sand

GAP = 0.97
"""Relative size of solids, less than one so that neighbors can be distinguished."""


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
    """Add the elements to a scene, as decoration: to the scene of a renderer or of a viewer.

    Call it after `renderer.update_scene(data)`, or for a passive viewer with `viewer.user_scn`,
    whose `ngeom` is set to 0 first. Positions are those in `data`, as for the scene itself. Facets
    are thin slabs (discs if they have no edges), rods are cylinders, blobs are solids.

    Args:
        scene: the scene to add to.
        sand: the sand whose elements are drawn.
        data: the simulation.
        color: meaning of the colors: "body", "geom", or "depth" below the surface.
        normals: whether normals of facets are drawn.
        forces: whether the sand's force on each element is drawn, as an arrow.
        force_scale: length of an arrow of one newton [m]; None to make the largest of the instant
            0.3 of the size of all elements.
        fade: opacity of the geoms that the elements are made from, and of a bed or height field of
            sand, if the scene has them. A viewer's `user_scn` does not: there, press T to see
            through them.

    Returns:
        The number of geoms added.

    Raises:
        InputError: the scene has too few free geoms, and then nothing is added; or `data` belongs
            to another model.
        UnknownNameError: no such coloring; lists the valid ones.
    """
    shown = Shown.at(sand, data, color)
    tails, tips = shown.normals() if normals else (np.zeros((0, 3)),) * 2
    starts, ends = shown.forces(force_scale) if forces else (np.zeros((0, 3)),) * 2
    needed, free = len(shown.elements) + len(tails) + len(starts), scene.maxgeom - scene.ngeom
    if needed > free:
        raise InputError(
            f"the scene can hold {free} more geoms and {needed} are needed: make it larger "
            "(mujoco.Renderer(..., max_geom=...)), use normals=False, or a lower "
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
        add_arrow(scene, tail, tip, float(width), rgb(INK))
    for tail, tip in zip(starts, ends, strict=True):
        add_arrow(scene, tail, tip, 0.006 * shown.reach, rgb(RED))
    return scene.ngeom - before


def _add_bodies(scene: mujoco.MjvScene, shown: Shown) -> None:
    """Add the solids of the elements."""
    place = {"facets": facet_bodies, "rods": _rod_bodies, "blobs": _blob_bodies}[shown.kind]
    kinds, sizes, frames = place(shown.elements)
    frames = shown.turn @ frames
    alpha = 0.5 if shown.kind == "blobs" else 1.0
    rgba = with_alpha(shown.colors, alpha).astype(np.float32)
    for k, middle in enumerate(shown.middles):
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(geom, kinds[k], sizes[k], middle, frames[k].ravel(), rgba[k])
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        scene.ngeom += 1


# For each element: the type of geom, its size as in a model (n, 3), its axes in the body's frame,
# in columns (n, 3, 3).
_Bodies = tuple[list[mujoco.mjtGeom], np.ndarray, np.ndarray]


def facet_bodies(facets: np.ndarray) -> _Bodies:
    """Return slabs, slanted like the edges; discs for facets without edges."""
    thin = 0.01 * np.sqrt(facets["area"])
    sizes = np.column_stack([np.sqrt(facets["area"] / math.pi), thin, thin])
    frames = frames_of(facets["normal"])
    wide, edges = half_edges(facets)
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
    return [mujoco.mjtGeom.mjGEOM_CYLINDER] * len(rods), sizes, frames_of(rods["axis"])


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
