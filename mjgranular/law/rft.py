"""Base of the two laws of resistive force theory."""

import math
from collections.abc import Sequence
from functools import cache
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular._util.checks import check_switch
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import dot
from mjgranular.law.facet import facet_kernel
from mjgranular.law.kernel import LawKernel
from mjgranular.law.lateral import lateral_slope
from mjgranular.law.law import Law, record_of
from mjgranular.law.raised import not_raised, raised_by_cone, raised_by_shear
from mjgranular.law.validity import Finding, Limit, findings_of
from mjgranular.shape import facets_from_model
from mjgranular.surface import Surface


@cache
def stress_of(slope: Any) -> Any:
    """Make the `stress` of a `slope` (`RftLaw`)."""

    @compiled
    def stress(law, g, n, u, z):
        strength, factors, _, _, _ = slope(law, g, dot(u, z), dot(n, z), dot(n, u))
        return strength * (factors.x * n + factors.y * u + factors.z * z)

    return stress


class RftLaw(Law):
    """Resistive force theory: a stress on every leading facet, linear in its depth.

    Attributes:
        stress: kernel `stress(law, g, n, u, z)` of the law's record, gravity [m/s^2], and unit
            vectors: outward normal, direction of motion, normal of the surface. Returns the
            resistance for unit area and depth [N/m^3], a vector. Derivatives are then finite
            differences. Not needed if there is a `slope`, which takes half the time.
        slope: kernel `slope(law, g, rise, down, lead)`: the same stress from the cosines u.z, n.z
            and n.u, as a strength [N/m^3] and a vector of the factors of n, u and z, `strength
            (alpha n + beta u + gamma z)`; and the factors' derivatives by u.z, by n.z and by n.u,
            three vectors.
        density: bulk density, for `record` [kg/m^3].
        inertia: lambda of the dynamic term; the law's record has lambda rho [kg/m^3] (`record`).
        added: kappa of the added mass; a law without it omits the field.
        cone: mean depth of stagnant sand under flat faces, in widths (`law.raised`); optional.
        rate: rise of friction from slow flow to fast; optional.
        grain: diameter of a grain, which `rate` needs [m].
        lateral: factor L on lateral strength (`law.lateral`); 0 keeps `slope` unchanged.
        slip: skin that slides along itself takes along sand within this tangent of its normal
            (`law.slip`); 0 takes along all.
        rise: whether the surface behind a turning body is lowered.
    """

    stress: ClassVar[Any] = None
    slope: ClassVar[Any] = None
    density_keys: ClassVar[tuple[str, ...]] = ("inertia",)
    validity: ClassVar[tuple[Limit, ...]] = (
        Limit("froude", 0.4, "quasi-static RFT, Agarwal et al., Sci. Adv. 7 eabe0631 (2021)"),
        Limit("inertial_number", 0.1, "Agarwal et al., Sci. Adv. 7 eabe0631 (2021)"),
        Limit(
            "depth_over_width", 5.0, "depth of the order of the width; 5 is chosen, not measured"
        ),
        Limit("slope", math.radians(10), "20 degrees change drag by half; 10 is chosen"),
    )

    density: float
    inertia: float
    added: float = 0.0
    cone: float = 0.0
    rate: float = 0.0
    grain: float = 0.0
    lateral: float = 0.0
    slip: float = 0.0
    rise: bool

    @property
    def adds_mass(self) -> bool:
        return self.added > 0

    @property
    def findings(self) -> tuple[Finding, ...]:
        term = " added" if self.added > 0 else " inertia" if self.inertia > 0 else ""
        return findings_of(self.name + term)

    @property
    def raised(self) -> Any:
        """Return the kernel of the factor on static resistance (`law.raised`)."""
        if self.rate > 0 and self.grain > 0:
            return raised_by_shear
        return raised_by_cone if self.cone > 0 else not_raised

    def check_options(self, *more: str) -> None:
        """Check the options; `more` names other numbers that must not be negative."""
        check_switch(f"{type(self).__name__}: rise", self.rise)
        self.check_numbers(*more, "inertia", "added", "cone", "rate", "lateral", "slip")

    def record(self, **numbers: Any) -> np.ndarray:
        """Return the record of these numbers and of those that all kernels of facets read."""
        shared = ("added", "density", "rise", "cone", "lateral", "slip")
        numbers |= {name: getattr(self, name) for name in shared}
        return record_of(**numbers, inertia=self.inertia * self.density)

    def elements(
        self, model: mujoco.MjModel, geoms: Sequence[int], resolution: int | None = None
    ) -> np.ndarray:
        return facets_from_model(model, geoms, resolution)

    def kernel(self, surface: Surface) -> LawKernel:
        return self._kernel(surface, type(self).stress, self._slope)

    def kernel_of_forces(self, surface: Surface) -> LawKernel:
        slope = self._slope
        return self._kernel(surface, type(self).stress if slope is None else stress_of(slope))

    @property
    def _slope(self) -> Any:
        slope = type(self).slope
        return lateral_slope(slope) if self.lateral > 0 else slope

    def _kernel(self, surface: Surface, stress: Any, slope: Any = None) -> LawKernel:
        return facet_kernel(
            surface.probe_kernel(),
            stress=stress,
            slope=slope,
            is_plane=type(surface).is_plane,
            toward=surface.toward_kernel(),
            ceiling=surface.ceiling_kernel(),
            added=self.adds_mass,
            slips=self.slip > 0,
            raised=self.raised,
        )
