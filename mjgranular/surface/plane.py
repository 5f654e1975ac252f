"""An infinite plane of sand, level or sloping."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular._util.checks import is_finite
from mjgranular.errors import InputError, shown
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import dot, read_vector
from mjgranular.surface.place import tilt_of
from mjgranular.surface.surface import Surface

PLANE_DTYPE = np.dtype([("normal", np.float64, (3,)), ("offset", np.float64)])


@partial(compiled, inline=True)
def plane_probe(plane, point):
    """Return a point's depth below the plane along its normal [m], negative above; the normal."""
    normal = read_vector(plane.normal, 0)
    return plane.offset - dot(normal, point), normal


@dataclass(frozen=True)
class Plane(Surface):
    """An infinite plane of sand.

    Attributes:
        height: world z of the surface above the world's origin [m].
        slope: angle from the horizontal [rad], below pi/2. Gravity is that of the model and does
            not rotate with it.
        uphill: direction of steepest ascent, as an angle from the x axis about z [rad].

    Raises:
        InputError: a value that is not finite, a slope outside (-pi/2, pi/2), or a direction of
            more than one turn.
    """

    probe: ClassVar[Any] = plane_probe
    is_plane: ClassVar[bool] = True

    height: float = 0.0
    slope: float = 0.0
    uphill: float = 0.0

    def __post_init__(self) -> None:
        for name in ("height", "slope", "uphill"):
            value = getattr(self, name)
            if not is_finite(value):
                raise InputError(f"the plane's {name} must be finite, not {shown(value)}")
        if abs(self.slope) >= math.pi / 2:
            raise InputError(
                f"the plane's slope must be less than 90 degrees (pi/2 = 1.5708 rad), "
                f"not {self.slope:.4f} rad"
            )
        if abs(self.uphill) > 2 * math.pi:
            raise InputError(
                f"the plane's uphill is an angle in radians, from -2 pi to 2 pi, not "
                f"{self.uphill:g}: {self.uphill:g} degrees are {math.radians(self.uphill):.4g}"
            )

    @property
    def normal(self) -> np.ndarray:
        """Unit normal out of the sand, world frame, shape (3,)."""
        s = math.sin(self.slope)
        return np.array(
            [-s * math.cos(self.uphill), -s * math.sin(self.uphill), math.cos(self.slope)]
        )

    @property
    def offset(self) -> float:
        """Distance of the surface from the world's origin along the normal [m]."""
        return self.height * math.cos(self.slope)

    def record(self, model: mujoco.MjModel) -> np.ndarray:
        plane = np.zeros(1, PLANE_DTYPE)
        plane["normal"] = self.normal
        plane["offset"] = self.offset
        return plane

    def lift(self, model: mujoco.MjModel) -> Mapping[str, np.ndarray]:
        return {"offset": np.ones(())}

    def tilt(self, model: mujoco.MjModel) -> float:
        return tilt_of(self.normal, model)
