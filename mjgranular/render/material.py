"""The material of sand, and the rectangles that draw an infinite plane of it.

Drawings are added to scenes, not to the model, which keeps its bodies and geoms and their order.
"""

import math

import mujoco
import numpy as np

from mjgranular.shape.sizes import data_at_start

MATERIAL = "mjgranular_sand"  # name of the material and of its texture

TILE = 0.5
"""Edge of the grain texture on geoms [m]; grains of 2 mm. Chosen."""

COLOR = (0.83, 0.71, 0.53, 1.0)  # color of sand in a model without the material
NOT_SHOWN = 5  # geom group that is hidden

DEFAULT = (0.5, 0.5, 0.5, 1.0)  # color of a geom whose color is not set
_DARK, _BRIGHT, _DARK_SHARE = (0.75, 0.62, 0.44), (0.88, 0.77, 0.58), 0.4
_PIXELS = 256  # along an edge of the texture
_PARALLEL = 0.999  # cosine of the largest angle between faces that hide each other
_SHOWN = 3  # number of geom groups that viewers and renderers show by default

_CORNERS = np.array([-64.0, -10.0, -3.0, -1.0, 0.0, 1.0, 3.0, 10.0, 64.0])
_MIDDLES, _HALVES = (_CORNERS[1:] + _CORNERS[:-1]) / 2, np.diff(_CORNERS) / 2
_GRID = [np.meshgrid(x, x, indexing="ij") for x in (_MIDDLES, _HALVES)]

TILES = np.stack([*_GRID[0], *_GRID[1]], axis=-1).reshape(-1, 4)
"""Rectangles of a plane, in units of twice the radius of what moves: center and half the edges of
each, along both axes. They are small in the center, as light is computed at their corners."""


def add_material(spec: mujoco.MjSpec, *, tile: float = TILE) -> str:
    """Add the material of sand to a model, unless it has it; return its name."""
    if spec.material(MATERIAL) is None:
        spec.add_texture(
            name=MATERIAL,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
            mark=mujoco.mjtMark.mjMARK_RANDOM,
            rgb1=_BRIGHT,
            markrgb=_DARK,
            random=_DARK_SHARE,
            width=_PIXELS,
            height=_PIXELS,
        )
        material = spec.add_material(name=MATERIAL)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = MATERIAL
        material.texrepeat = np.full(2, 2 / tile, np.float32)  # over half the edges
        material.texuniform = True
        material.specular = material.shininess = material.reflectance = 0.0
    return MATERIAL


def paint(geom: mujoco.MjsGeom, material: str) -> None:
    """Give a geom that is sand its material, unless it has its own color or material."""
    if not geom.material and np.allclose(geom.rgba, DEFAULT):
        geom.material = material
        geom.rgba = [1.0, 1.0, 1.0, 1.0]


def texture_of(model: mujoco.MjModel, material: int) -> int:
    """Return the id of the color texture of a material; -1 for none."""
    role = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
    return int(model.mat_texid[material, role]) if material >= 0 else -1


def boxes_of(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return lowest and highest corners of geoms' world-aligned bounding boxes [m], (n, 3)."""
    turns = data.geom_xmat[geoms].reshape(-1, 3, 3)
    middles = data.geom_xpos[geoms] + np.einsum("nij,nj->ni", turns, model.geom_aabb[geoms, :3])
    halves = np.einsum("nij,nj->ni", np.abs(turns), model.geom_aabb[geoms, 3:])
    return middles - halves, middles + halves


def moving_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Return ids of visible geoms that can move; else of all that can move, else of all."""
    moves = model.body_weldid[model.geom_bodyid] != 0
    alpha = model.geom_rgba[:, 3].copy()
    painted = model.geom_matid >= 0
    alpha[painted] = model.mat_rgba[model.geom_matid[painted], 3]
    for chosen in (moves & (alpha > 0) & (model.geom_group < _SHOWN), moves):
        if chosen.any():
            return np.flatnonzero(chosen)
    return np.arange(model.ngeom)


def radius_of(model: mujoco.MjModel) -> float:
    """Return the radius of a ball around what moves, at `qpos0` [m]."""
    data = data_at_start(model)
    moving = moving_geoms(model)
    if not len(moving):
        return float(model.stat.extent)
    low, high = boxes_of(model, data, moving)
    size = float(np.linalg.norm(high.max(axis=0) - low.min(axis=0))) / 2
    return size if math.isfinite(size) and size > 0 else float(model.stat.extent)


def ground_at(model: mujoco.MjModel, normal: np.ndarray, offset: float, near: float) -> list[int]:
    """Return ids of visible fixed planes, and boxes with a face, that are in a plane."""
    data = data_at_start(model)
    found = []
    planes, boxes = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_BOX)
    for geom in range(model.ngeom):
        kind, material = model.geom_type[geom], model.geom_matid[geom]
        rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
        fixed = model.body_weldid[model.geom_bodyid[geom]] == 0
        if not (fixed and rgba[3] > 0 and model.geom_group[geom] < _SHOWN):
            continue
        sides = data.geom_xmat[geom].reshape(3, 3).T
        if kind == planes:
            faces = [(sides[2], 0.0)]
        elif kind == boxes:
            both = zip(sides, model.geom_size[geom], strict=True)
            faces = [(sign * side, half) for side, half in both for sign in (-1.0, 1.0)]
        else:
            continue
        for face, half in faces:
            away = abs(normal @ (data.geom_xpos[geom] + half * face) - offset)
            if normal @ face > _PARALLEL and away <= near:
                found.append(geom)
    return found
