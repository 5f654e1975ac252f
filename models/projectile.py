"""Other bodies in place of the link, to compare drops with experiments."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import mujoco

from mjgranular._util.checks import check_name
from mjgranular.models.link import Link
from mjgranular.sand.spec import LAW_TEXT

Shape = Literal["link", "sphere", "box", "cylinder", "capsule", "ellipsoid", "plate"]


@dataclass(frozen=True)
class Projectile(Link):
    """A body of one geom that moves in the plane y = 0, with the link's joints and scenery.

    T is the lowest point of the body at release, fixed to the body.

    Attributes:
        length: height along the body's axis [m]; side of a plate; not used for a sphere.
        diameter: size across the axis [m]; thickness of a plate.
        density: [kg/m^3].
        shape: "link" is the paper's slender rod; other shapes have mass and inertia of the solid.

    Raises:
        UnknownNameError: no such shape.
        InputError: a size that is not positive and finite.
    """

    shape: Shape = "link"

    def __post_init__(self) -> None:
        check_name("body", self.shape, get_args(Shape))
        self._check_sizes(self.shape)

    @property
    def halves(self) -> tuple[float, float, float]:
        """Half extents along x, y, z of the body [m]."""
        radius, half = self.diameter / 2, self.length / 2
        if self.shape == "sphere":
            return radius, radius, radius
        if self.shape == "plate":
            return half, half, radius
        return radius, radius, half

    @property
    def solid(self) -> tuple[mujoco.mjtGeom, tuple[float, float, float]]:
        """Type and size of its geom."""
        kinds, (x, y, z) = mujoco.mjtGeom, self.halves
        return {
            "sphere": (kinds.mjGEOM_SPHERE, (x, 0.0, 0.0)),
            "ellipsoid": (kinds.mjGEOM_ELLIPSOID, (x, y, z)),
            "box": (kinds.mjGEOM_BOX, (x, y, z)),
            "plate": (kinds.mjGEOM_BOX, (x, y, z)),
            "cylinder": (kinds.mjGEOM_CYLINDER, (x, z, 0.0)),
        }.get(self.shape, (kinds.mjGEOM_CAPSULE, (x, z - x, 0.0)))

    @property
    def mass(self) -> float:
        return super().mass if self.shape == "link" else float(self._alone.body_mass[1])

    @property
    def inertia(self) -> float:
        return super().inertia if self.shape == "link" else float(self._alone.body_inertia[1, 1])

    @cached_property
    def _alone(self) -> mujoco.MjModel:
        """The solid on its own, of which MuJoCo computes mass and inertia."""
        spec, (kind, size) = mujoco.MjSpec(), self.solid
        spec.worldbody.add_body().add_geom(type=kind, size=size, density=self.density)
        return spec.compile()

    @property
    def reach(self) -> float:
        return max(self.halves) * 2

    def spec(self) -> mujoco.MjSpec:
        spec = super().spec()
        if self.shape == "link":
            return spec
        spec.delete(spec.text(LAW_TEXT))
        geom, body, alone = spec.geom("link"), spec.body("link"), self._alone
        geom.type, geom.size = self.solid
        body.mass, body.inertia = alone.body_mass[1], alone.body_inertia[1]
        spec.site("T").pos = [0, 0, -self.halves[2]]
        return spec

    def lowest(self, q: float) -> tuple[float, float]:
        x, _, z = self.halves
        # Downward direction in the frame of the body, rotated by q about -y.
        dx, dz = -math.sin(q), -math.cos(q)
        if self.shape == "link":
            return 0.0, -z
        if self.shape in ("sphere", "ellipsoid"):
            size = math.hypot(x * dx, z * dz)
            return x * x * dx / size, z * z * dz / size
        if self.shape in ("box", "plate", "cylinder"):
            return (math.copysign(x, dx) if abs(dx) > 1e-9 else 0.0), math.copysign(z, dz)
        return x * dx, math.copysign(z - x, dz) + x * dz
