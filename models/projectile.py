"""Other bodies in place of the link, to compare drops with experiments."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import mujoco

from mjgranular._util.checks import check_name
from mjgranular.models.link import Link
from mjgranular.sand.material import LAW_TEXT

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
    def mass(self) -> float:
        x, y, z = self.halves
        volume = {
            "sphere": 4 / 3 * math.pi * x * y * z,
            "ellipsoid": 4 / 3 * math.pi * x * y * z,
            "box": 8 * x * y * z,
            "plate": 8 * x * y * z,
            "capsule": math.pi * x * x * (2 * (z - x) + 4 / 3 * x),
        }.get(self.shape, 2 * math.pi * x * x * z)
        return self.density * volume

    @property
    def inertia(self) -> float:
        if self.shape == "link":
            return super().inertia
        return self._moments()[1]

    def _moments(self) -> tuple[float, float, float]:
        """Return moments of inertia about x, y and z through C [kg m^2]."""
        x, y, z = self.halves
        m = self.mass
        if self.shape in ("sphere", "ellipsoid"):
            return m / 5 * (y * y + z * z), m / 5 * (x * x + z * z), m / 5 * (x * x + y * y)
        if self.shape in ("box", "plate"):
            return m / 3 * (y * y + z * z), m / 3 * (x * x + z * z), m / 3 * (x * x + y * y)
        if self.shape == "cylinder":
            across = m * (3 * x * x + 4 * z * z) / 12
            return across, across, m * x * x / 2
        # A capsule: a cylinder of half height h, and hemispheres with their centers at its ends.
        h = z - x
        tube, ends = self.density * 2 * math.pi * x * x * h, self.density * 4 / 3 * math.pi * x**3
        across = tube * (3 * x * x + 4 * h * h) / 12
        across += ends * (2 / 5 * x * x + h * h + 3 / 4 * x * h)
        return across, across, tube * x * x / 2 + ends * 2 / 5 * x * x

    @property
    def reach(self) -> float:
        return max(self.halves) * 2

    def spec(self) -> mujoco.MjSpec:
        spec = super().spec()
        if self.shape == "link":
            return spec
        spec.delete(spec.text(LAW_TEXT))
        kinds = mujoco.mjtGeom
        x, y, z = self.halves
        geom = spec.geom("link")
        geom.type, geom.size = {
            "sphere": (kinds.mjGEOM_SPHERE, [x, 0, 0]),
            "ellipsoid": (kinds.mjGEOM_ELLIPSOID, [x, y, z]),
            "box": (kinds.mjGEOM_BOX, [x, y, z]),
            "plate": (kinds.mjGEOM_BOX, [x, y, z]),
            "cylinder": (kinds.mjGEOM_CYLINDER, [x, z, 0]),
            "capsule": (kinds.mjGEOM_CAPSULE, [x, z - x, 0]),
        }[self.shape]
        body = spec.body("link")
        body.mass = self.mass
        body.inertia = self._moments()
        spec.site("T").pos = [0, 0, -z]
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
