"""What the two laws of resistive force theory share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.law.facet_kernel import facet_kernel
from mjgranular.law.law import Law
from mjgranular.shape import facets_from_model
from mjgranular.surface import Surface


class RftLaw(Law):
    """Resistive force theory: a stress on every leading facet, linear in its depth."""

    stress: ClassVar[Any]

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

    def kernel(self, surface: Surface, scene: np.dtype) -> Any:
        return facet_kernel(type(self).stress, surface.probe, scene)
