"""How sand looks: its material, and the rectangles that an endless plane of it is drawn with.

Nothing here is a geom of a model: what is drawn is added to scenes, so that a model has the bodies
and geoms, in the order, that it has without sand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

MATERIAL = "mjgranular_sand"
"""Name of the material and of its texture."""

TILE = 0.5
"""Edge of the picture of grains on geoms [m]; grains of 2 mm. Chosen."""

COLOUR = (0.83, 0.71, 0.53, 1.0)
"""Of sand in a model without the material."""

NOT_SHOWN = 5
"""Geom group of what is not to be seen."""

_DARK, _BRIGHT, _DARK_SHARE = (0.66, 0.53, 0.36), (0.90, 0.79, 0.60), 0.3
_PIXELS = 256  # along an edge of the picture
_HAIR = 2e-3  # of the radius: ground of the model's own this near hides the sand
_PARALLEL = 0.999  # cosine of the angle between faces that hide each other
_SHOWN = 3  # geom groups that viewers and renderers show unless told otherwise: those before it
_DEFAULT = (0.5, 0.5, 0.5, 1.0)  # colour of a geom that nobody has coloured


def _tiles() -> np.ndarray:
    """Rectangles side by side, small in the middle: light is computed at their corners.

    Returns:
        Middle and half the edges of each, along both axes of the plane, shape (n, 4).
    """
    corners = np.array([-64.0, -10.0, -3.0, -1.0, 0.0, 1.0, 3.0, 10.0, 64.0])
    middles, halves = (corners[1:] + corners[:-1]) / 2, np.diff(corners) / 2
    grid = [
        (x, y, a, b)
        for x, a in zip(middles, halves, strict=True)
        for y, b in zip(middles, halves, strict=True)
    ]
    return np.array(grid)


TILES = _tiles()
"""Of a plane, in units of twice the radius of what moves."""


def add_material(spec: mujoco.MjSpec, *, tile: float = TILE) -> str:
    """Adds the material of sand to a model that has it not; its name.

    Args:
        spec: the model to be.
        tile: edge of the picture of grains [m].
    """
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
        material.texrepeat = [2 / tile, 2 / tile]  # MuJoCo repeats it over half the edges
        material.texuniform = True
        material.specular = material.shininess = material.reflectance = 0.0
    return MATERIAL


def paint(geom: mujoco.MjsGeom, material: str) -> None:
    """Gives a geom that is sand its material, unless somebody has given it another look."""
    if not geom.material and np.allclose(geom.rgba, _DEFAULT):
        geom.material = material
        geom.rgba = [1.0, 1.0, 1.0, 1.0]


@dataclass(frozen=True)
class PlaneLook:
    """How a plane is drawn in a model.

    Attributes:
        material: id of its material; -1 for none.
        picture: id of the texture of grains; -1 for none.
        unit: of `TILES`, and edge of the picture [m], in steps of which they follow the model.
        lowered: so far under the surface they lie, where ground of the model's own lies in it [m].
    """

    material: int
    picture: int
    unit: float
    lowered: float

    @classmethod
    def of(
        cls, model: mujoco.MjModel, normal: np.ndarray, offset: float, radius: float
    ) -> PlaneLook | None:
        """How the plane of the points p with normal @ p = offset is drawn under a model.

        None where the model shows it by a geom of its own that makes no contact.

        Args:
            model: the model.
            normal: of the plane, upward, shape (3,).
            offset: of the plane [m].
            radius: of a ball around what moves [m]: grains are as large as can be told apart.
        """
        names = (model.material(number).name for number in range(model.nmat))
        found = next((k for k, name in enumerate(names) if name.endswith(MATERIAL)), -1)
        role = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
        hair = _HAIR * radius
        ground = _ground_at(model, normal, offset, hair)
        if any(not (model.geom_contype[geom] or model.geom_conaffinity[geom]) for geom in ground):
            return None
        return cls(
            material=found,
            picture=int(model.mat_texid[found, role]) if found >= 0 else -1,
            unit=2 * radius,
            lowered=hair if ground else 0.0,
        )

    @property
    def rgba(self) -> np.ndarray:
        """Colour that the material's picture is multiplied with, or all there is."""
        return np.array(COLOUR if self.material < 0 else (1.0, 1.0, 1.0, 1.0), np.float32)

    def add(
        self, scene: mujoco.MjvScene, normal: np.ndarray, offset: float, middle: np.ndarray
    ) -> None:
        """Adds the plane to a scene, about a point."""
        axes = axes_of(normal)
        # The plugin does the same in compiled code (`engine.draw`).
        place = axes.T @ middle
        place[:2] = np.floor(place[:2] / self.unit + 0.5) * self.unit
        place[2] = offset - self.lowered
        for x, y, half_x, half_y in TILES * self.unit:
            if scene.ngeom >= scene.maxgeom:
                return
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(
                geom,
                mujoco.mjtGeom.mjGEOM_PLANE,
                np.array([half_x, half_y, 0.1]),
                axes @ (place + np.array([x, y, 0.0])),
                axes.ravel(),
                self.rgba,
            )
            geom.matid, geom.texid = self.material, self.picture
            geom.texuniform, geom.texrepeat = 1, [2 / self.unit, 2 / self.unit]
            geom.specular = geom.shininess = geom.reflectance = 0.0
            geom.category = mujoco.mjtCatBit.mjCAT_DECOR
            scene.ngeom += 1


def axes_of(normal: np.ndarray) -> np.ndarray:
    """Axes of a plane in columns, the last its normal, which must point up."""
    along = np.array([normal[2], 0.0, -normal[0]]) / math.hypot(normal[0], normal[2])
    return np.column_stack([along, np.cross(normal, along), normal])


def boxes_of(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corners of the boxes along the world's axes around geoms [m], (n, 3)."""
    turns = data.geom_xmat[geoms].reshape(-1, 3, 3)
    middles = data.geom_xpos[geoms] + np.einsum("nij,nj->ni", turns, model.geom_aabb[geoms, :3])
    halves = np.einsum("nij,nj->ni", np.abs(turns), model.geom_aabb[geoms, 3:])
    return middles - halves, middles + halves


def moving_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Ids of the geoms that can move and are seen; without any, of all that can move, or of all."""
    moves = model.body_weldid[model.geom_bodyid] != 0
    alpha = model.geom_rgba[:, 3].copy()
    painted = model.geom_matid >= 0
    alpha[painted] = model.mat_rgba[model.geom_matid[painted], 3]
    for chosen in (moves & (alpha > 0) & (model.geom_group < _SHOWN), moves):
        if chosen.any():
            return np.flatnonzero(chosen)
    return np.arange(model.ngeom)


def radius_of(model: mujoco.MjModel) -> float:
    """Radius of a ball around what moves, where the model stands at `qpos0` [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    moving = moving_geoms(model)
    if not len(moving):
        return float(model.stat.extent)
    low, high = boxes_of(model, data, moving)
    size = float(np.linalg.norm(high.max(axis=0) - low.min(axis=0))) / 2
    return size if math.isfinite(size) and size > 0 else float(model.stat.extent)


def _ground_at(model: mujoco.MjModel, normal: np.ndarray, offset: float, near: float) -> list[int]:
    """Ids of planes, and of boxes with a face, that are fixed, seen and lie in a plane."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
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
