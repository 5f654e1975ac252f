"""Values that are valid numbers but implausible for sand: most likely wrong units."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.errors import RangeWarning, warn_user
from mjgranular.law import DepthVelocityLaw, DistributedLinkLaw, Law, LinkLaw
from mjgranular.law.rft import RftLaw
from mjgranular.relief.memory import REPOSE, Memory
from mjgranular.shape.select import body_name
from mjgranular.shape.sizes import LARGEST, geom_name, half_extents
from mjgranular.surface import Bed, Plane, Surface

_DENSITIES = (10.0, 25000.0)
"""Density of a medium [kg/m^3]: from snow to tungsten powder. In g/cm^3 it is 0.01 to 25."""

_LONGEST_STEP = 0.1
"""Time step [s]. MuJoCo's own models have 1 to 10 ms; a body that falls 1 cm into sand is at rest
after 50 ms. A value in milliseconds is 1 or more."""

_DEEPEST_START = 1.0
"""Depth of the highest point of all that meets the sand [m]. Laws hold to some widths of a body. A
height in millimeters, or with the wrong sign, is further off. For a robot the limit is half its
largest geom."""

_LONGEST = 10.0
"""Width of a geom that meets the sand [m]. Chosen: an excavator has 10 m. A geom drawn in
millimeters has more."""

_LIGHTEST = 5.0
"""Mean density of all that meets the sand [kg/m^3]. Chosen: foam has 15 and more. In g/cm^3 water
has 1, and steel 7.8."""

_STEEPEST = math.radians(75)
"""Angle between gravity and the way into a plane of sand. Chosen: sand slides from 35 degrees on;
with gravity along y it is 90."""

_ROUNDING = 1e-6
"""Tolerance for a slope equal to the angle of repose [rad]; chosen."""

_LEVEL = 1e-3
"""Vertical component of an axis up to which it counts as level; chosen."""

_OF_SAND = (LinkLaw, DistributedLinkLaw, RftLaw, DepthVelocityLaw)
"""Laws known to be of sand: a custom law may be of mud, or of a lake."""


def warn_of_ranges(
    model: mujoco.MjModel,
    geoms: Sequence[int],
    law: Law,
    surface: Surface,
    memory: Memory | None = None,
) -> None:
    """Warn of densities, sizes, a time step, a slope and a start that are implausible.

    Args:
        model: the model.
        geoms: ids of the geoms that meet the sand.
        law: the law with its constants.
        surface: where the sand is; a start is checked under a plane only.
        memory: memory of the sand, if any.
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
    _warn_of_slope(model, law, surface, memory)
    if memory is None:  # with one, `relief.advice` looks
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        warn_of_depth(model, data, geoms, law, surface, "with the model as it stands (qpos0)")


def warn_of_depth(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    geoms: Sequence[int],
    law: Law,
    surface: Surface,
    when: str,
) -> None:
    """Warn where bodies are too deep in a plane of sand to have been put there on purpose.

    Args:
        model: the model.
        data: the simulation, with current positions.
        geoms: ids of the geoms that meet the sand.
        law: the law; one that is not of sand is not checked.
        surface: where the sand is.
        when: describes the positions in `data`.
    """
    if not isinstance(surface, Plane) or not isinstance(law, _OF_SAND):
        return
    rows, normal = np.asarray(geoms), surface.normal
    tops = [
        np.abs(normal @ data.geom_xmat[geom].reshape(3, 3)) @ half_extents(model, geom)
        for geom in geoms
    ]
    depths = surface.offset - data.geom_xpos[rows] @ normal - tops
    depth = float(depths.min())
    if depth > _DEEPEST_START:
        warn_user(
            f"all that meets the sand starts {depth:.3g} m and more under its surface, {when}: "
            "lengths are in metres, and z is up; raise the model or lower the surface",
            RangeWarning,
        )
        return
    bodies = model.geom_bodyid[rows]
    roots = model.body_rootid[bodies]
    for root in np.unique(roots):
        mine = roots == root
        depth = float(depths[mine].min())
        is_robot = len(np.unique(model.body_weldid[bodies[mine]])) > 1
        if (
            is_robot
            and _may_rise(model, data, root)
            and depth > model.geom_rbound[rows[mine]].max()
        ):
            warn_user(
                f"robot {body_name(model, int(root))} is buried {depth:.3g} m and more under the "
                f"sand, {when}, and stays there: raise it, in MJCF by its pos, or lower the "
                f"surface by {depth:.3g} m and more",
                RangeWarning,
            )
            return


def _may_rise(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> bool:
    """Return True if a joint of the body lets it move up, unlike a swimmer in a level plane."""
    for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
        kind, axis = model.jnt_type[joint], data.xaxis[joint]
        is_slide = kind == mujoco.mjtJoint.mjJNT_SLIDE
        if kind == mujoco.mjtJoint.mjJNT_FREE or (is_slide and abs(axis[2]) > _LEVEL):
            return True
    return False


def _warn_of_slope(
    model: mujoco.MjModel, law: Law, surface: Surface, memory: Memory | None
) -> None:
    """Warn of a plane or bed that sand does not stay on.

    The angle of repose is the memory's, else that of the law's internal friction, else `REPOSE`.
    """
    gravity = model.opt.gravity
    if not isinstance(surface, (Plane, Bed)) or gravity[2] >= 0.0 or gravity[:2].any():
        return
    friction = getattr(law, "internal_friction", None)
    repose = REPOSE if friction is None else math.atan(friction)
    repose, slope = (repose if memory is None else memory.repose), surface.tilt(model)
    if slope > repose + _ROUNDING:
        warn_user(
            f"the sand slopes by {math.degrees(slope):.3g} degrees, and its angle of repose is "
            f"{math.degrees(repose):.3g}: it would flow down, and what stands on it here would not "
            "stay; slopes are in degrees on the command line and in radians elsewhere",
            RangeWarning,
        )


def _warn_of_gravity(model: mujoco.MjModel, surface: Surface) -> None:
    """Warn of gravity that does not pull into the sand."""
    gravity = model.opt.gravity
    strength = float(np.linalg.norm(gravity))
    if not isinstance(surface, Plane) or strength == 0.0:
        return
    down = min(1.0, max(-gravity[2], -float(gravity @ surface.normal)) / strength)
    off = math.acos(max(-1.0, down))  # a wall of sand is allowed if it was asked for
    if off > _STEEPEST:
        components = ", ".join(f"{component:g}" for component in gravity)
        warn_user(
            f"gravity, ({components}) m/s^2, is {math.degrees(off):.0f} degrees off the way into "
            "the sand: z is up, and gravity 0 0 -9.81 on level ground",
            RangeWarning,
        )


def _warn_of_bodies(model: mujoco.MjModel, geoms: Sequence[int]) -> None:
    """Warn of geoms drawn in millimeters, or with densities in g/cm^3."""
    if not (model.geom_size[list(geoms)] < LARGEST).all():
        return  # an error where the elements are made
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
    """Return the volume of a geom [m^3]; 0 where it is unknown, as for meshes."""
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
