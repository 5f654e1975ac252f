"""Surfaces of bodies: the facets of their geoms, for laws that act on surface elements."""

import copy
import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, Literal

import mujoco
import numpy as np

from mjgranular._util.checks import check_count
from mjgranular.shape import patches, sizes, tessellation
from mjgranular.shape.rigid import exposures, in_own_frames, join_faces
from mjgranular.shape.shells import mesh_arrays, mesh_faces, within_others
from mjgranular.shape.tessellation import Cells

FACET_DTYPE = np.dtype(
    [
        *sizes.PART_FIELDS,
        ("point", np.float64, (3,)),  # centroid [m], body frame
        ("normal", np.float64, (3,)),  # unit, outward, body frame
        ("area", np.float64),  # exposed to sand [m^2] (`shape.rigid`)
        # A point of the facet is point + s edges[0] + t edges[1], s and t from -1 to 1, body frame;
        # the normal there is along normal + s spread[0] + t spread[1]. Zero for triangles.
        ("edges", np.float64, (2, 3)),  # [m]
        ("spread", np.float64, (2, 3)),
        ("extent", np.float64),  # of the edges from the center [m], 0 for triangles
        ("width", np.float64),  # of the widest face of the geom, for Froude numbers [m]
        ("face", np.float64),  # width of the face that it is part of [m] (`shape.rigid`)
        ("flat", np.float64),  # 0 to 1: fraction of the geom's projection that is one flat face
        ("layer", np.float64),  # width, of sand that moves along [m] (`shape.rigid`)
        # As its normal turns by t [rad], skin slides along itself by hides[0].t of edges[0] and
        # hides[1].t of edges[1] (`law.slip`).
        ("hides", np.float64, (2, 3)),
    ]
)

FINEST = 200
"""Largest resolution; chosen: a sphere then has 51 000 facets and takes 0.9 GB to divide."""

_TOUCH = 1e-6  # share of a geom's size within which surfaces coincide; chosen: far above rounding
_FLAT = 1e-9  # change of a normal that is rounding; chosen
# Radii of round and of straight skin, in its widths; chosen: the shells of legs are round.
_ROUND, _STRAIGHT = 2.0, 2.5
_TURNS = 16  # positions around a hinge; less of a turn between limits is not all round; chosen

_GEOM, _HINGE = mujoco.mjtGeom, int(mujoco.mjtJoint.mjJNT_HINGE)


def facets_from_model(
    model: mujoco.MjModel,
    geoms: Sequence[int],
    resolution: int | None = None,
    *,
    hidden: Literal["drop", "keep"] = "drop",
    sheltered: Literal["drop", "keep"] = "drop",
    meshes: Literal["patches", "triangles"] = "patches",
) -> np.ndarray:
    """Divide geoms into facets.

    Capsule, sphere, cylinder, ellipsoid and box are divided into patches of their true surface; the
    triangles of a mesh, convex or not, are grouped into patches (`shape.patches`).

    Args:
        model: the model.
        geoms: geom ids.
        resolution: rings from pole to pole of a round geom, patches around half of a cylinder, and
            three times the number along a box's longest edge; a mesh has at most twice its square.
            None for 12, and less for small geoms if there are many (`resolutions`).
        hidden: whether to drop surfaces that no grain can touch, since they are inside another of
            the geoms (`hidden_skin`) or shells of a mesh (`within_others`), or to keep all.
        sheltered: whether to drop the share of a facet's area that other parts of the same rigid
            body shelter (`shape.rigid.exposures`), or to keep all.
        meshes: facets of a mesh: patches, or its own triangles, for comparisons.

    Returns:
        Facets, ordered by body, shape (n,), dtype `FACET_DTYPE`.
    """
    ordered = sorted(set(geoms), key=lambda g: (int(model.geom_bodyid[g]), g))
    if resolution is None:
        rings = sizes.resolutions(model, ordered)
    else:
        check_count("the resolution", resolution, 2, FINEST)
        rings = [int(resolution)] * len(ordered)
    model = copy.copy(model)
    data = sizes.data_at_start(model)
    parts, skins, is_cut = [], [], meshes == "patches"
    # One surface at a time: the cells of all would fill the memory.
    for geom, fine in zip(ordered, rings, strict=True):
        if int(model.geom_type[geom]) == _GEOM.mjGEOM_MESH:
            vertices, faces, shells = mesh_faces(model, geom)
            mesh_arrays(model, geom)[1][:] = faces  # rays meet them as turned
            corners, parents = vertices[faces], np.arange(len(faces))
            if is_cut:
                corners, parents = patches.pieces(corners, fine)
            if hidden == "drop":
                skin = tessellation.triangles(corners)
                inside = within_others(corners, shells[parents], vertices[faces], shells)
                seen = ~(inside | hidden_skin(model, data, geom, skin, ordered))
                corners, parents = corners[seen], parents[seen]
            facets, bent, leans = patches.single(corners), 0.0, 0.0
            if is_cut:
                bends = (found[parents] for found in patches.bends(vertices, faces))
                facets, bent, leans = patches.gathered(corners, fine, *bends)
            width = sizes.geom_width(model, geom)
            flat = patches.flatness(facets.points, facets.normals, facets.areas, width)
            is_round = np.maximum(1 - 2 * flat, 0)[:, None]
            facets.spread[:] += is_round[:, None] * bent
            facets.normals[:] += is_round * leans
            facets.normals[:] /= np.linalg.norm(facets.normals, axis=1)[:, None]
        else:
            skin = _skin(model, data, geom, fine)
            if hidden == "drop":
                skin = skin.only(~hidden_skin(model, data, geom, skin, ordered))
            facets = skin.gathered()
            flat = (np.abs(facets.spread).max(axis=(1, 2), initial=0.0) < _FLAT).astype(float)
        part = np.zeros(len(facets), FACET_DTYPE)
        parts.append(part)
        sizes.check_count(sum(map(len, parts)))
        rotation = sizes.geom_axes(model, geom)
        part["geom"] = geom
        part["point"] = facets.points @ rotation.T + model.geom_pos[geom]
        part["normal"] = facets.normals @ rotation.T
        part["area"] = facets.areas
        part["edges"] = facets.edges @ rotation.T
        # Flat facets are exactly flat: rounding must not decide whether a face leads.
        plane = np.abs(facets.spread).max(axis=(1, 2)) < _FLAT
        part["spread"] = np.where(plane[:, None, None], 0.0, facets.spread @ rotation.T)
        part["extent"] = np.linalg.norm(facets.edges, axis=2).sum(axis=1)
        part["width"] = sizes.geom_width(model, geom)
        part["flat"] = flat
        skins.append(facets.skin @ rotation.T + [model.geom_pos[geom], np.zeros(3)])
    facets, own = np.concatenate(parts), in_own_frames(model)
    sizes.set_bodies(model, facets)
    exposed = np.ones(len(facets))
    if sheltered == "drop":
        exposed = exposures(model, own, facets, np.concatenate(skins))
        facets, exposed = facets[exposed > 0], exposed[exposed > 0]
    if is_cut:
        join_faces(model, own, facets, exposed)
    else:
        facets["face"] = facets["layer"] = facets["width"]
    widest = np.zeros(model.ngeom)
    np.maximum.at(widest, facets["geom"], facets["face"])
    facets["width"] = widest[facets["geom"]]
    facets["hides"] = _hidden(facets)
    facets["area"] *= exposed
    return facets[facets["area"] > 0]


def _hidden(facets: np.ndarray) -> np.ndarray:
    """Return `hides` of facets: along directions of principal curvature, where skin is round."""
    dual = np.linalg.pinv(facets["edges"])
    bend = dual @ facets["spread"] @ dual @ facets["edges"]
    curvatures, axes = np.linalg.eigh((bend + bend.swapaxes(1, 2)) / 2)
    bent = np.abs(curvatures) * facets["face"][:, None] - 1 / _STRAIGHT
    # Cubed, since sand hardly follows even a tenth of such motion.
    share = np.clip(bent / (1 / _ROUND - 1 / _STRAIGHT), 0, 1) ** 3 * (1 - facets["flat"])[:, None]
    radii = share / np.where(share > 0, curvatures, 1)
    return dual.swapaxes(1, 2) @ (axes * radii[:, None]) @ axes.swapaxes(1, 2)


def hidden_skin(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, skin: Cells, geoms: Sequence[int]
) -> np.ndarray:
    """Return a mask of the cells of the surface of a geom that are inside others.

    A geom hides what is inside it on its own body, and on bodies welded to it. On a body connected
    to its own by hinge or ball joints, parent or child, it hides what is inside it at `qpos0`, the
    pose of `data`, and no farther from the joint than half its width: that stays there, roughly, as
    the joint turns; if it turns all round (`_turned`), only what stays inside. A slide joint hides
    nothing. Where two surfaces coincide and face the same way, that of the lower id is kept, or
    that of no mesh; else none. A mesh hides only its copy.
    """
    hidden = np.zeros(len(skin.points), bool)
    is_mesh = int(model.geom_type[geom]) == _GEOM.mjGEOM_MESH
    poses = np.hstack([data.geom_xpos, data.geom_xmat])
    turn = data.geom_xmat[geom].reshape(3, 3)
    # Cells without area have no normal and are not used; what is too far to compute hides nothing.
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        points, vectors = skin.points @ turn.T + data.geom_xpos[geom], skin.vectors @ turn.T
        normals = vectors / np.linalg.norm(vectors, axis=1)[:, None]
        for other in geoms:
            apart = float(np.linalg.norm(data.geom_xpos[geom] - data.geom_xpos[other]))
            joints = _joints_between(model, geom, other)
            if other == geom or joints is None or apart > sum(model.geom_rbound[[geom, other]]):
                continue
            is_same = is_mesh and model.geom_type[other] == _GEOM.mjGEOM_MESH and not joints
            if is_same and other < geom and np.allclose(poses[other], poses[geom]):
                arrays = (mesh_arrays(model, g) for g in (geom, other))
                if all(map(np.array_equal, *arrays)):
                    return ~hidden
            back, place = data.geom_xmat[other].reshape(3, 3), data.geom_xpos[other]
            step = _TOUCH * sizes.half_extents(model, other).max() * normals
            covered = _inside(model, other, (points + step - place) @ back)
            if other < geom or is_mesh:
                covered |= _inside(model, other, (points - step - place) @ back)
            for joint in joints:
                away, reach = points - data.xanchor[joint], 0.5 * sizes.geom_width(model, other)
                covered &= np.linalg.norm(away, axis=1) <= (1 + _TOUCH) * reach
                kept = np.flatnonzero(covered)
                hub, arms = (data.xanchor[joint] - place) @ back, (away - step)[kept] @ back
                for turned in _turned(model, joint, data.xaxis[joint] @ back, arms):
                    covered[kept] &= _inside(model, other, hub + turned)
            hidden |= covered
    return hidden


def _turned(model: mujoco.MjModel, joint: int, axis: np.ndarray, arms: np.ndarray) -> Iterator[Any]:
    """Yield vectors from a joint [m] in positions all round it; none if its limits prevent them."""
    is_hinge = model.jnt_type[joint] == _HINGE
    span = (1 - 1 / _TURNS) * math.pi * (1 + is_hinge)  # limits of a ball joint are from 0
    if model.jnt_limited[joint] and np.ptp(model.jnt_range[joint]) < span:
        return
    if not is_hinge:
        length = np.linalg.norm(arms, axis=1)[:, None]
        ways = product((-1, 0, 1), repeat=3)
        yield from (length * way / math.hypot(*way) for way in ways if any(way))
        return
    along, beside = np.outer(arms @ axis, axis), np.cross(axis, arms)
    for angle in 2 * math.pi / _TURNS * np.arange(_TURNS):
        yield along + math.cos(angle) * (arms - along) + math.sin(angle) * beside


def _joints_between(model: mujoco.MjModel, geom: int, other: int) -> list[int] | None:
    """Return joints between the bodies of two geoms: empty if welded, None if unrelated.

    Unrelated bodies are not joined to each other, or are joined by a slide joint.
    """
    one, two = sorted(int(model.body_weldid[model.geom_bodyid[g]]) for g in (geom, other))
    if one == two:
        return []
    # Bodies come after their parents.
    if one == 0 or int(model.body_weldid[model.body_parentid[two]]) != one:
        return None
    joints = np.flatnonzero(model.jnt_bodyid == two)
    is_slide = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE
    return None if is_slide.any() else joints.tolist()


def _inside(model: mujoco.MjModel, geom: int, points: np.ndarray) -> np.ndarray:
    """Return which points [m] in the frame of a geom are inside it, shape (n,)."""
    size, kind = model.geom_size[geom], int(model.geom_type[geom])
    if kind in (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_ELLIPSOID):
        return ((points / sizes.half_extents(model, geom)) ** 2).sum(axis=1) < 1
    if kind == _GEOM.mjGEOM_BOX:
        return (np.abs(points) < size).all(axis=1)
    across, along = np.hypot(points[:, 0], points[:, 1]), np.abs(points[:, 2])
    if kind == _GEOM.mjGEOM_CYLINDER:
        return (across < size[0]) & (along < size[1])
    if kind == _GEOM.mjGEOM_CAPSULE:
        return np.hypot(across, np.maximum(along - size[1], 0)) < size[0]
    return np.zeros(len(points), bool)


def _skin(model: mujoco.MjModel, data: mujoco.MjData, geom: int, resolution: int) -> Cells:
    size, kind = model.geom_size[geom], int(model.geom_type[geom])
    if not int(_GEOM.mjGEOM_SPHERE) <= kind <= int(_GEOM.mjGEOM_BOX):
        raise sizes.type_error(model, geom)
    sizes.check_size(model, geom)
    if kind in (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_ELLIPSOID):
        return tessellation.ellipsoid(tuple(sizes.half_extents(model, geom)), resolution)
    if kind == _GEOM.mjGEOM_CAPSULE:
        return tessellation.capsule(size[0], size[1], resolution)
    if kind == _GEOM.mjGEOM_BOX:
        return tessellation.box(tuple(size), resolution)
    # A wheel or roller turns about its own z axis on a hinge.
    is_own = model.jnt_bodyid == model.body_weldid[model.geom_bodyid[geom]]
    axes = data.xaxis[is_own & (model.jnt_type == _HINGE)]
    spins = bool((abs(axes @ data.geom_xmat[geom, 2::3]) > 0.99).any())
    return tessellation.cylinder(size[0], size[1], resolution, spins)
