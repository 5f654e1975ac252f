"""Daylight, sky and sand for a model."""

import mujoco
import numpy as np

from mjgranular.relief import Memory
from mjgranular.render import add_skin
from mjgranular.render.material import add_material, paint, radius_of
from mjgranular.render.skin import BLOCK, lines_of, stride_of
from mjgranular.surface import Bed, HeightField, Surface

_SUN = "mjgranular_sun"
_SKY, _HORIZON = [0.34, 0.54, 0.82], [0.97, 0.97, 0.96]
_SHADOWS = 2048  # pixels along an edge of the map of shadows
# Radius of the shadowed region, in radii of the moving parts. At the edge of MuJoCo's shadow map
# surfaces that cast shadows are speckled: the moving parts must be in its middle.
_SHADOWED = 6.0
_SUNSHINE = np.array([-0.70, 0.26, -0.66])  # 41 degrees high, to the side of the default view


def add_scenery(spec: mujoco.MjSpec, surface: Surface) -> None:
    """Add daylight and the material of sand, but no geom.

    A bed or height field without a color becomes sand; an infinite plane is not a geom, and is
    drawn into the scene (`engine.looks`, or by the plugin).
    """
    add_daylight(spec)
    material = add_material(spec)
    if isinstance(surface, Bed | HeightField) and (bed := spec.geom(surface.geom)):
        paint(bed, material)


def add_daylight(spec: mujoco.MjSpec) -> None:
    """Add a sun and a sky.

    Lights of the model are switched off: lights for a laboratory floor make sand too dark or too
    bright. The sun is low enough to show relief, casts the only shadows, and follows the model.
    `place_sun` sharpens the shadows once the model is compiled.
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
    used = {name for material in spec.materials for name in material.textures}
    for texture in list(spec.textures):
        if texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            if texture.name and texture.name in used:
                texture.type = mujoco.mjtTexture.mjTEXTURE_CUBE
            else:
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


def add_cut_scenery(spec: mujoco.MjSpec, reach: float, memory: Memory | None) -> None:
    """Add daylight to the model of a link, and extend its bed, which is cut open, to the horizon.

    `reach` is the largest extent of the link [m]. With memory the tracks are drawn.
    """
    add_daylight(spec)
    spec.delete(spec.geom("table"))
    spec.stat.extent = 3 * reach  # else that of the bed, with a coarse depth buffer
    bed, half = spec.geom("bed"), 15 * reach
    front = bed.pos[1] - bed.size[1]
    bed.size = [half] * 3  # a cube: MuJoCo stretches the texture of other boxes
    bed.pos = [0.0, front + half, -half]
    if memory is not None:
        _add_cut_prints(spec, bed, memory)


def _add_cut_prints(spec: mujoco.MjSpec, bed: mujoco.MjsGeom, memory: Memory) -> None:
    """Add the skin for tracks, and reduce the bed to what it draws; boxes draw the rest."""
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
    """Restrict the shadows of a model with scenery to the moving parts."""
    sun = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_LIGHT, _SUN)
    if sun < 0:
        return
    reach = _SHADOWED * radius_of(model)
    model.vis.map.shadowclip = reach / model.stat.extent
    model.light_pos[sun] = model.light_poscom0[sun] = -reach * _SUNSHINE
