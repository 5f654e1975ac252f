"""Values that computers take and no sand or simulation has: most likely slips of units."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.errors import RangeWarning, warn_user
from mjgranular.law import DepthVelocityLaw, DistributedLinkLaw, Law, LinkLaw
from mjgranular.law.rft import RftLaw
from mjgranular.shape.sizes import LARGEST, geom_name
from mjgranular.surface import Plane, Surface

_DENSITIES = (10.0, 25000.0)
"""Of sand [kg/m^3]: from snow to tungsten powder, as a medium's. In g/cm^3 it is 0.01 to 25."""

_LONGEST_STEP = 0.1
"""[s]. MuJoCo's own models have 1 to 10 ms, and what falls 1 cm into sand is at rest after 50 ms.
Someone who gives milliseconds gives 1 or more."""

_DEEPEST_START = 1.0
"""Of the highest point of all that meets the sand [m]. A robot is buried by hand; laws hold to some
widths of a body. A height in millimetres, or with the wrong sign, is further off."""

_LONGEST = 10.0
"""Of a geom that meets the sand [m], across. Chosen: an excavator has 10 m. What was drawn in
millimetres has more."""

_LIGHTEST = 5.0
"""Mean of all that meets the sand [kg/m^3]. Chosen: foam has 15 and more. In g/cm^3 water has 1,
and steel 7.8."""

_STEEPEST = math.radians(75)
"""Of gravity against the way into a plane of sand. Chosen: sand slides from 35 degrees on, and
where gravity is along y, it is 90."""

_OF_SAND = (LinkLaw, DistributedLinkLaw, RftLaw, DepthVelocityLaw)
"""Laws of which that is known: one of a user's own may be of mud, or of a lake."""


def warn_of_ranges(model: mujoco.MjModel, geoms: Sequence[int], law: Law, surface: Surface) -> None:
    """Warns of densities, sizes, a time step and a start that are beyond all sense.

    Args:
        model: the model.
        geoms: ids of the geoms that meet the sand.
        law: with its constants.
        surface: where the sand is; a start is judged under a plane alone.
    """
    density = getattr(law, "density", None)
    low, high = _DENSITIES
    if isinstance(density, (int, float)) and density > 0 and not low <= density <= high:
        likely = (
            f"{density:g} g/cm^3 is {1000 * density:g} kg/m^3"
            if low <= 1000 * density <= high
            else "densities are in kg/m^3"
        )
        warn_user(
            f"the law {law.name!r} has a density of {density:g} kg/m^3, and sand has {low:g} to "
            f"{high:g}: {likely}",
            RangeWarning,
        )
    timestep = model.opt.timestep
    if timestep > _LONGEST_STEP:
        warn_user(
            f"the time step is {timestep:g} s, in which what falls is far below the sand before it "
            f"is met: {timestep:g} ms is {timestep / 1000:g} s",
            RangeWarning,
        )
    _warn_of_bodies(model, geoms)
    _warn_of_gravity(model, surface)
    depth = _depth_of_all(model, geoms, surface)
    if isinstance(law, _OF_SAND) and depth > _DEEPEST_START:
        warn_user(
            f"all that meets the sand starts {depth:.3g} m and more under its surface, with the "
            "model as it stands (qpos0): lengths are in metres, and z is up; raise the model or "
            "lower the surface",
            RangeWarning,
        )


def _warn_of_gravity(model: mujoco.MjModel, surface: Surface) -> None:
    """Warns of gravity that does not pull into the sand."""
    gravity = model.opt.gravity
    strength = float(np.linalg.norm(gravity))
    if not isinstance(surface, Plane) or strength == 0.0:
        return
    down = min(1.0, max(-gravity[2], -float(gravity @ surface.normal)) / strength)
    off = math.acos(max(-1.0, down))  # a wall of sand that was asked for is one
    if off > _STEEPEST:
        components = ", ".join(f"{component:g}" for component in gravity)
        warn_user(
            f"gravity, ({components}) m/s^2, is {math.degrees(off):.0f} degrees off the way into "
            "the sand: z is up, and gravity 0 0 -9.81 on level ground",
            RangeWarning,
        )


def _warn_of_bodies(model: mujoco.MjModel, geoms: Sequence[int]) -> None:
    """Warns of what is drawn in millimetres, or weighed in g/cm^3."""
    if not (model.geom_size[list(geoms)] < LARGEST).all():
        return  # refused where elements are made
    largest = max(geoms, key=lambda geom: model.geom_rbound[geom])
    across = 2 * float(model.geom_rbound[largest])
    if across > _LONGEST:
        warn_user(
            f"geom {geom_name(model, largest)} is {across:.3g} m across: lengths are in metres, "
            f"and {across:.3g} mm is {across / 1000:.3g} m",
            RangeWarning,
        )
    volumes = [_volume(model, geom) for geom in geoms]
    bodies = sorted({int(model.geom_bodyid[geom]) for geom in geoms})
    mass = float(model.body_mass[bodies].sum())
    if all(volumes) and 0.0 < mass < _LIGHTEST * sum(volumes):
        density = mass / sum(volumes)
        warn_user(
            f"all that meets the sand weighs {mass:.3g} kg, on the mean {density:.3g} kg/m^3, less "
            f"than any solid: {density:.3g} g/cm^3 is {1000 * density:.4g} kg/m^3",
            RangeWarning,
        )


def _volume(model: mujoco.MjModel, geom: int) -> float:
    """Volume of a geom [m^3]; 0 where it is not known, of meshes above all."""
    x, y, z = model.geom_size[geom].tolist()
    kinds = mujoco.mjtGeom
    ball = 4 / 3 * math.pi
    kind = model.geom_type[geom]
    if kind == kinds.mjGEOM_SPHERE:
        return ball * x**3
    if kind == kinds.mjGEOM_CAPSULE:
        return ball * x**3 + 2 * math.pi * x**2 * y
    if kind == kinds.mjGEOM_CYLINDER:
        return 2 * math.pi * x**2 * y
    if kind == kinds.mjGEOM_ELLIPSOID:
        return ball * x * y * z
    return 8 * x * y * z if kind == kinds.mjGEOM_BOX else 0.0


def _depth_of_all(model: mujoco.MjModel, geoms: Sequence[int], surface: Surface) -> float:
    """A depth that every point of the geoms has at least, where the model stands at qpos0 [m]."""
    if not isinstance(surface, Plane):
        return -math.inf
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    heights = data.geom_xpos[geoms] @ surface.normal
    top = heights + model.geom_rbound[geoms]
    return float(np.min(surface.height * surface.normal[2] - top))
