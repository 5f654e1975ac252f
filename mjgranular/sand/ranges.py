"""Values that computers take and no sand or simulation has: most likely slips of units."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.errors import RangeWarning, warn_user
from mjgranular.law import DepthVelocityLaw, DistributedLinkLaw, Law, LinkLaw
from mjgranular.law.rft import RftLaw
from mjgranular.surface import Plane, Surface

_DENSITIES = (10.0, 25000.0)
"""Of sand [kg/m^3]: from snow to tungsten powder, as a medium's. In g/cm^3 it is 0.01 to 25."""

_LONGEST_STEP = 0.1
"""[s]. MuJoCo's own models have 1 to 10 ms, and what falls 1 cm into sand is at rest after 50 ms.
Someone who gives milliseconds gives 1 or more."""

_DEEPEST_START = 1.0
"""Of the highest point of all that meets the sand [m]. A robot is buried by hand; laws hold to some
widths of a body. A height in millimetres, or with the wrong sign, is further off."""

_OF_SAND = (LinkLaw, DistributedLinkLaw, RftLaw, DepthVelocityLaw)
"""Laws of which that is known: one of a user's own may be of mud, or of a lake."""


def warn_of_ranges(model: mujoco.MjModel, geoms: Sequence[int], law: Law, surface: Surface) -> None:
    """Warns of a density, a time step and a start that are beyond all sense.

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
    depth = _depth_of_all(model, geoms, surface)
    if isinstance(law, _OF_SAND) and depth > _DEEPEST_START:
        warn_user(
            f"all that meets the sand starts {depth:.3g} m and more under its surface, with the "
            "model as it stands (qpos0): lengths are in metres, and z is up; raise the model or "
            "lower the surface",
            RangeWarning,
        )


def _depth_of_all(model: mujoco.MjModel, geoms: Sequence[int], surface: Surface) -> float:
    """A depth that every point of the geoms has at least, where the model stands at qpos0 [m]."""
    if not isinstance(surface, Plane):
        return -math.inf
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    heights = data.geom_xpos[geoms] @ surface.normal
    top = heights + model.geom_rbound[geoms]
    return float(np.min(surface.height * surface.normal[2] - top))
