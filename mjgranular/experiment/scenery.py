"""Scenery that makes a user's model look as if it were on sand."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjgranular.surface import Plane

_BED = "mjgranular_bed"


def add_bed(spec: mujoco.MjSpec, surface: Plane) -> None:
    """Adds a sand-coloured slab below a plane surface, to be seen and not to be touched.

    A model without a light gets one, from above and aside, so that relief shows.
    """
    if not spec.lights:
        spec.worldbody.add_light(
            name=_BED,
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=[0.0, 0.0, 4.0],
            dir=[0.4, 0.3, -1.0],
            ambient=[0.3, 0.3, 0.3],
            diffuse=[0.6, 0.6, 0.6],
            castshadow=True,
        )
    if all(t.type != mujoco.mjtTexture.mjTEXTURE_SKYBOX for t in spec.textures):
        spec.add_texture(
            name="mjgranular_sky",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=[0.95, 0.96, 0.97],
            rgb2=[0.76, 0.82, 0.88],
            width=128,
            height=128,
        )
    spec.add_texture(
        name=_BED,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        mark=mujoco.mjtMark.mjMARK_RANDOM,
        rgb1=[0.80, 0.69, 0.50],
        markrgb=[0.58, 0.46, 0.30],
        random=0.3,
        width=512,
        height=512,
    )
    material = spec.add_material(name=_BED)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = _BED
    material.texrepeat = [4, 4]
    material.texuniform = True
    half, thick = 3.0, 0.05
    position = -thick * surface.normal
    position[2] += surface.height
    # From z to the normal: a turn about the horizontal axis across the slope. A quaternion, since
    # angles are read in the unit of the model's compiler.
    half_turn = surface.slope / 2
    across = np.array([math.sin(surface.uphill), -math.cos(surface.uphill), 0.0])
    # In a body of its own, behind all others: geoms of the model keep their numbers.
    spec.worldbody.add_body(name=_BED).add_geom(
        name=_BED,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[half, half, thick],
        pos=position,
        quat=[math.cos(half_turn), *(math.sin(half_turn) * across)],
        material=_BED,
        contype=0,
        conaffinity=0,
        group=1,
    )
