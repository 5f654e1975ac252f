"""An endless plane of sand, level or sloping."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular.errors import InputError, shown
from mjgranular.kernel.compiled import compiled
from mjgranular.surface.surface import Surface

PLANE_DTYPE = np.dtype([("normal", np.float64, (3,)), ("offset", np.float64)])


@compiled
def plane_probe(plane, x, y, z):
    """Depth of a point below the plane along its normal [m], negative above it; the normal."""
    nx, ny, nz = plane.normal[0], plane.normal[1], plane.normal[2]
    return plane.offset - (nx * x + ny * y + nz * z), nx, ny, nz


@compiled
def plane_level(plane, pose):
    """The plane in the frame of a body: its normal there, and the depth of the origin [m]."""
    nx, ny, nz = plane.normal[0], plane.normal[1], plane.normal[2]
    p, r = pose.position, pose.rotation
    return (
        r[0] * nx + r[3] * ny + r[6] * nz,
        r[1] * nx + r[4] * ny + r[7] * nz,
        r[2] * nx + r[5] * ny + r[8] * nz,
        plane.offset - (nx * p[0] + ny * p[1] + nz * p[2]),
    )


@dataclass(frozen=True)
class Plane(Surface):
    """An endless plane of sand.

    Attributes:
        height: world z of the surface above the world's origin [m].
        slope: angle against the horizontal [rad], below pi/2. Gravity is the model's own and does
            not turn with it.
        uphill: direction of steepest ascent, as an angle from the x axis about z [rad].

    Raises:
        InputError: a value that is not finite, or a slope outside (-pi/2, pi/2).
    """

    probe: ClassVar[Any] = plane_probe
    level: ClassVar[Any] = plane_level

    height: float = 0.0
    slope: float = 0.0
    uphill: float = 0.0

    def __post_init__(self) -> None:
        for name in ("height", "slope", "uphill"):
            value = getattr(self, name)
            if not isinstance(value, (int, float)) or not math.isfinite(value):
                raise InputError(f"the plane's {name} must be finite, not {shown(value)}")
        if abs(self.slope) >= math.pi / 2:
            raise InputError(
                f"the plane's slope must be less than 90 degrees (pi/2 = 1.5708 rad), "
                f"not {self.slope:.4f} rad"
            )

    @property
    def normal(self) -> np.ndarray:
        """Unit normal out of the sand, world frame, shape (3,)."""
        s = math.sin(self.slope)
        return np.array(
            [-s * math.cos(self.uphill), -s * math.sin(self.uphill), math.cos(self.slope)]
        )

    def record(self, model: mujoco.MjModel) -> np.ndarray:
        plane = np.zeros(1, PLANE_DTYPE)
        plane["normal"] = self.normal
        plane["offset"] = self.height * math.cos(self.slope)
        return plane

    def lift(self, model: mujoco.MjModel) -> Mapping[str, np.ndarray]:
        return {"offset": np.ones(())}

    def tilt(self, model: mujoco.MjModel) -> float:
        return abs(self.slope)
