"""A measured body: shape, size and mass, as for the projectiles of the package."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

from mjgranular._util.checks import is_finite
from mjgranular.errors import InputError, UnknownNameError
from mjgranular.models import Projectile
from mjgranular.models.projectile import Shape

_STEEL = 7850.0  # default density of a body that is moved, not dropped [kg/m^3]


@dataclass(frozen=True)
class Body:
    """A body of one of the shapes of `models.Projectile`, SI units.

    Attributes:
        shape: sphere, capsule, cylinder, box, plate, ellipsoid or link.
        diameter: size across the axis [m]; thickness of a plate.
        length: size along the axis [m]; side of a plate; not used for a sphere.
        mass: mass [kg]; a dropped body needs mass or density.
        density: [kg/m^3].

    Raises:
        UnknownNameError: no such shape.
        InputError: a size or mass that is not positive, or both mass and density.
    """

    shape: Shape
    diameter: float
    length: float | None = None
    mass: float | None = None
    density: float | None = None

    def __post_init__(self) -> None:
        if self.shape not in get_args(Shape):
            raise UnknownNameError("shape of a body", self.shape, get_args(Shape))
        if self.length is None and self.shape != "sphere":
            what = "its side" if self.shape == "plate" else "along its axis"
            raise InputError(f"a {self.shape} needs a length, {what} [m]")
        if self.mass is not None and self.density is not None:
            raise InputError("a body has a mass or a density, got both")
        for name in ("diameter", "length", "mass", "density"):
            value = getattr(self, name)
            if value is not None and not (is_finite(value) and value > 0):
                raise InputError(f"the body's {name} must be positive and finite, not {value}")
        _ = self.projectile

    @property
    def is_heavy(self) -> bool:
        """Whether its weight is known."""
        return self.mass is not None or self.density is not None

    @property
    def projectile(self) -> Projectile:
        """The body as a projectile."""
        length = self.diameter if self.length is None else self.length
        plain = Projectile(length, self.diameter, 1.0, self.shape)
        density = self.density or _STEEL
        if self.mass is not None:
            density = self.mass / plain.mass
        return Projectile(length, self.diameter, density, self.shape)

    @property
    def size(self) -> float:
        """Largest extent [m]."""
        return max(self.diameter, 0.0 if self.length is None else self.length)

    def describe(self) -> str:
        """Return a short description."""
        size = f"{self.diameter * 1e3:g} mm"
        if self.length is not None and self.shape != "sphere":
            size = f"{self.length * 1e3:g} x {size}"
        weight = f", {self.projectile.mass * 1e3:.3g} g" if self.is_heavy else ""
        return f"{self.shape} of {size}{weight}"

    def heavier(self, factor: float) -> Body:
        """Return the same body with its mass multiplied by `factor`."""
        return Body(self.shape, self.diameter, self.length, self.projectile.mass * factor)
