"""The link law of Lee and Marghitu: static resistance by depth, drag by velocity squared.

The paper writes it for a link in a vertical plane. In three dimensions, with n the normal of the
surface: "vertical" is along n; "horizontal" is along the surface, and the horizontal static force
opposes the direction of the tangential velocity of E, the centroid of the immersed part; the angle
in the reference area is that between the rod's axis and the velocity of E; the immersed length is
at most that of the rod; the deeper end of the rod is its end T. In the plane this is the paper's
law.

There are two forms: lumped, the paper's own, with one force on the whole rod; and distributed, with
the same totals in pure translation but spread along the axis, which also resists rotation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.law.kernel import LawKernel
from mjgranular.law.law import Law, constants_of, register_law
from mjgranular.law.link_kernel import (
    LINK_DTYPE,
    LINK_KEYS,
    distributed_limits,
    link_kernel,
    lumped_limits,
)
from mjgranular.law.validity import Limit
from mjgranular.medium import Medium
from mjgranular.shape import cut_rods, rods_from_model
from mjgranular.surface import Surface

_LINK_PAPER = (
    "S. Lee, D. B. Marghitu, Stopping Time for a Planar Link in Contact with a Granular Material, "
    "eqs. (2), (5)-(11)"
)


class _LinkForm(Law):
    """Base of both forms of the law: coefficients, and a kernel over rods."""

    limits: ClassVar[Any]
    # Not `density`, which the whole law is proportional to: strength and density are separate.
    strength_keys: ClassVar[tuple[str, ...]] = ("eta_h", "eta_v")
    density_keys: ClassVar[tuple[str, ...]] = ("eta_d",)
    validity: ClassVar[tuple[Limit, ...]] = (
        Limit("slope", math.radians(10), "written for a level surface; 10 degrees is chosen"),
    )

    def __post_init__(self) -> None:
        self.check_not_negative(*LINK_KEYS)

    @classmethod
    def from_medium(cls, medium: Medium | str) -> Self:
        return cls(**constants_of(cls, medium, LinkLaw.name))

    def parameters(self, medium: Medium) -> np.ndarray:
        parameters = np.zeros(1, LINK_DTYPE)
        for key in LINK_KEYS:
            parameters[key] = getattr(self, key)
        parameters["density"] = medium.density.value
        return parameters

    def kernel(self, surface: Surface) -> LawKernel:
        return link_kernel(type(self).limits, surface.probe_kernel())


@register_law
@dataclass(frozen=True)
class LinkLaw(_LinkForm):
    r"""The lumped link law: one force on each rod, at the centroid E of its immersed part.

    $$
    F = -\eta_d \rho_g A_r |v_E| v_E
        - \operatorname{sign}(v_n)\, \eta_v (y_T/d)^\lambda g \rho_g V\, n
        - \eta_h g \rho_g y_T^2 d\, v_t / |v_t|
    $$

    The force acts at E: rotation about E is not resisted.

    Attributes:
        eta_d: dynamic (drag) coefficient, eq. (2).
        eta_h: horizontal static coefficient, eq. (10).
        eta_v: vertical static coefficient, eq. (11).
        exponent: exponent lambda of the vertical static force, eq. (11).

    Raises:
        InputError: a coefficient that is negative or not finite.
    """

    name: ClassVar[str] = "link"
    title: ClassVar[str] = "slender link, lumped: static force by depth, drag by speed squared"
    citation: ClassVar[str] = _LINK_PAPER
    limits: ClassVar[Any] = lumped_limits

    eta_d: float
    eta_h: float
    eta_v: float
    exponent: float

    def elements(
        self, model: mujoco.MjModel, geoms: Sequence[int], resolution: int | None = None
    ) -> np.ndarray:
        return rods_from_model(model, geoms)


@register_law
@dataclass(frozen=True)
class DistributedLinkLaw(_LinkForm):
    r"""The link law spread along the axis: resists rotation too, and a link can come to rest.

    $$
    dF = -\eta_d \rho_g d\, |u \times v| v\, ds
         - \operatorname{sign}(v_n) (1 + \lambda) \eta_v (y/d)^\lambda g \rho_g
           \tfrac{\pi d^2}{4}\, n\, ds
         - 2 \eta_h g \rho_g y\, d \cos q\, v_t / |v_t|\, ds
    $$

    In pure translation its sum is that of `LinkLaw`.

    Attributes:
        eta_d: dynamic (drag) coefficient.
        eta_h: horizontal static coefficient.
        eta_v: vertical static coefficient.
        exponent: exponent lambda of the vertical static force.
        pieces: number of pieces each rod is cut into; 20 is chosen, not measured.

    Raises:
        InputError: a coefficient that is negative or not finite, or no piece.
    """

    name: ClassVar[str] = "link_distributed"
    title: ClassVar[str] = "slender link, spread along its axis: resists rotation too"
    citation: ClassVar[str] = f"{_LINK_PAPER}; differentiated along the axis"
    limits: ClassVar[Any] = distributed_limits

    eta_d: float
    eta_h: float
    eta_v: float
    exponent: float
    pieces: int = 20

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.pieces < 1:
            raise InputError(f"DistributedLinkLaw: pieces must be at least 1, not {self.pieces}")

    def elements(
        self, model: mujoco.MjModel, geoms: Sequence[int], resolution: int | None = None
    ) -> np.ndarray:
        pieces = self.pieces if resolution is None else resolution
        return cut_rods(rods_from_model(model, geoms), pieces)

    def kernel(self, surface: Surface) -> LawKernel:
        probe, ceiling = surface.probe_kernel(), surface.ceiling_kernel()
        return link_kernel(type(self).limits, probe, ceiling, lanes=4)
