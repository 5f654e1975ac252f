"""Scenery that makes a user's model look as if it were on sand by day."""

from __future__ import annotations

import mujoco
import numpy as np

from mjgranular.prints import add_skin
from mjgranular.prints.look import add_material, paint, radius_of
from mjgranular.prints.skin import BLOCK, lines_of, stride_of
from mjgranular.relief import Memory
from mjgranular.surface import Bed, HeightField, Surface

_SUN = "mjgranular_sun"
_SKY, _HORIZON = [0.46, 0.63, 0.84], [0.88, 0.91, 0.93]
_SHADOWS = 2048  # pixels along an edge of the map of shadows
# Radii of what moves. MuJoCo looks shadows up by a pixel off at the edge of its map, which speckles
# what casts shadows there: what is looked at lies in the middle.
_SHADOWED = 6.0
_SUNSHINE = np.array([-0.70, 0.26, -0.66])  # 41 degrees high, beside whoever looks by default


def add_scenery(spec: mujoco.MjSpec, surface: Surface) -> None:
    """Adds daylight, a sky and the material of sand, and no geom.

    Lights of the model's own are switched off: one that lights a laboratory's floor leaves sand
    dark or burns it out. The sun stands low enough for relief to show, casts the only shadows, and
    follows the model. A bed or height field that nobody has coloured becomes sand; an endless plane
    is no geom and is drawn into the scene (`look.PlaneLook`, or by the plugin).

    Args:
        spec: the model to be; it is changed.
        surface: of the sand.
    """
    if known := spec.light(_SUN):  # a model that was written with its scenery
        spec.delete(known)
    for light in spec.lights:
        light.active = False
    spec.worldbody.add_light(
        name=_SUN,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM,
        dir=_SUNSHINE,
        ambient=[0.0, 0.0, 0.0],
        diffuse=[0.80, 0.77, 0.70],
        specular=[0.15, 0.15, 0.15],
        castshadow=True,
    )
    head = spec.visual.headlight
    head.active = 1
    head.ambient, head.diffuse, head.specular = [0.36, 0.37, 0.40], [0.12] * 3, [0.05] * 3
    for texture in list(spec.textures):
        if texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            spec.delete(texture)
    spec.add_texture(
        name="mjgranular_sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=_SKY,
        rgb2=_HORIZON,
        width=128,
        height=128,
    )
    spec.visual.rgba.haze = [*_HORIZON, 1.0]
    spec.visual.quality.shadowsize = _SHADOWS
    material = add_material(spec)
    if isinstance(surface, Bed | HeightField) and (bed := spec.geom(surface.geom)):
        paint(bed, material)


def add_cut_prints(spec: mujoco.MjSpec, memory: Memory | None) -> None:
    """Adds what prints are drawn with to a link's or a chain's model, whose bed is cut open.

    Of the bed no more is left than what is drawn with prints; the rest becomes boxes beside it.

    Args:
        spec: the model to be.
        memory: of the sand; None for sand that has no prints.
    """
    if memory is None:
        return
    bed = spec.geom("bed")
    add_skin(spec, memory, bed.material, thickness=2 * float(bed.size[2]))
    reach = (lines_of(memory) - 4 * BLOCK - 1) * stride_of(memory) * memory.cell / 2
    front, back = bed.pos[1] - bed.size[1], bed.pos[1] + bed.size[1]
    end, wide = float(bed.size[0]), min(reach, float(bed.size[0]))
    deep = min(front + 2 * reach, back)
    beside = [((-end, -wide), (front, back)), ((wide, end), (front, back))]
    for (left, right), (near, far) in (*beside, ((-wide, wide), (deep, back))):
        if right - left > 1e-6 and far - near > 1e-6:
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=[(left + right) / 2, (near + far) / 2, bed.pos[2]],
                size=[(right - left) / 2, (far - near) / 2, bed.size[2]],
                material=bed.material,
                contype=0,
                conaffinity=0,
                group=bed.group,
            )
    bed.size[:2], bed.pos[1] = (wide, (deep - front) / 2), (front + deep) / 2


def place_sun(model: mujoco.MjModel) -> None:
    """Has the sun of a model with scenery cast the shadows of what moves, and no others."""
    sun = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_LIGHT, _SUN)
    if sun < 0:
        return
    reach = _SHADOWED * radius_of(model)
    model.vis.map.shadowclip = reach / model.stat.extent
    model.light_pos[sun] = model.light_poscom0[sun] = -reach * _SUNSHINE
