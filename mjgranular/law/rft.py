"""What the two laws of resistive force theory share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.law.facet_kernel import facet_kernel
from mjgranular.law.kernel import LawKernel
from mjgranular.law.law import Law
from mjgranular.law.validity import Limit
from mjgranular.shape import facets_from_model
from mjgranular.surface import Surface


class RftLaw(Law):
    """Resistive force theory: a stress on every leading facet, linear in its depth.

    Attributes:
        stress: kernel, see `facet_kernel`.
        slope: kernel `slope(law, g, rise, down, lead)`: the same stress from the cosines u.z, n.z
            and n.u of its unit vectors, as a strength [N/m^3] and the factors of n, u and z,
            `strength (alpha n + beta u + gamma z)`, with the factors' derivatives by u.z, by n.z
            and by n.u: 1 + 3 + 9 numbers. None to have derivatives from differences, which takes
            up to twice as long.
        inertia: lambda of the dynamic term.
        rise: whether the surface behind a turning body is lowered.
    """

    stress: ClassVar[Any]
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

    inertia: float
    rise: bool

    def check_options(self) -> None:
        """Refuses options without meaning."""
        if not (math.isfinite(self.inertia) and self.inertia >= 0):
            raise InputError(
                f"{type(self).__name__}: inertia must be finite and not negative, "
                f"not {self.inertia}"
            )

    def elements(
        self, model: mujoco.MjModel, geoms: Sequence[int], resolution: int | None = None
    ) -> np.ndarray:
        if resolution is None:
            return facets_from_model(model, geoms)
        return facets_from_model(model, geoms, resolution)

    def kernel(self, surface: Surface) -> LawKernel:
        law, place = type(self), type(surface)
        return facet_kernel(law.stress, place.probe, law.slope, place.level)
