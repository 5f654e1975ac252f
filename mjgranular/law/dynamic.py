"""Resistive force theory for feet and bodies as fast as robots move.

The quasi-static laws with everything that sand in motion adds, each with its published constant:
lambda of the inertial term, an added mass, stagnant sand under flat faces and friction that grows
with the rate of shear (docs/laws/rft.md, docs/validity.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

from mjgranular.law.law import constants_of, register_law
from mjgranular.law.raised import RATE, cone_under
from mjgranular.law.rft2d import Rft2dLaw
from mjgranular.law.rft3d import Rft3dLaw
from mjgranular.law.validity import Finding, findings_of
from mjgranular.medium import Medium, get_medium

INERTIA = 1.1
"""lambda: S. Agarwal, A. Karsai, D. I. Goldman, K. Kamrin, Sci. Adv. 7 eabe0631 (2021)."""

ADDED = 2.5
"""kappa: chosen by two drops of a ball in simulated grains (docs/validity.md)."""

FRICTION = 0.6
"""Internal friction where a law has none, for the cone: of dry sands, 31 degrees; chosen."""

_CITATION = (
    "; inertial term: S. Agarwal, A. Karsai, D. I. Goldman, K. Kamrin, Sci. Adv. 7 eabe0631 "
    "(2021); added mass after J. Aguilar, D. I. Goldman, Nature Physics 12, 278 (2016); stagnant "
    "sand: W. Kang, Y. Feng, C. Liu, R. Blumenfeld, Nature Communications 9, 1101 (2018)"
)


@register_law
@dataclass(frozen=True)
class DynamicRft3dLaw(Rft3dLaw):
    """`Rft3dLaw` with what sand in motion adds, all of it switched on.

    A medium's constants for `rft3d` serve it. Its cone follows from the internal friction, the
    grain size is the medium's (without one there is no `rate`), and `scale` takes off what the
    cone adds to a plate that is as deep as wide, since the published stiffness is force over depth
    (chosen: at which depths plates were pushed is not printed with it). A slow push tells better:
    `mjgranular fit`.
    """

    name: ClassVar[str] = "rft3d_dynamic"
    title: ClassVar[str] = "resistive force theory in 3D for fast motion"
    citation: ClassVar[str] = (
        f"{Rft3dLaw.citation.partition(';')[0]}{_CITATION}; friction by rate of shear: P. Jop, "
        "Y. Forterre, O. Pouliquen, Nature 441, 727 (2006)"
    )

    inertia: float = INERTIA
    added: float = ADDED
    rate: float = RATE

    @property
    def findings(self) -> tuple[Finding, ...]:
        return findings_of(self.name)

    @classmethod
    def from_medium(cls, medium: Medium | str) -> Self:
        medium = get_medium(medium)
        own = cls.name in medium.constants
        constants = constants_of(cls, medium, cls.name if own else Rft3dLaw.name)
        if not own:
            constants = {**constants, **_cone(constants, constants["internal_friction"])}
        if medium.grain is not None:
            constants = {"grain": medium.grain.value, **constants}
        return cls(**constants)


@register_law
@dataclass(frozen=True)
class DynamicRft2dLaw(Rft2dLaw):
    """`Rft2dLaw` with what sand in motion adds, all of it switched on.

    A medium's constants for `rft2d` serve it. Its coefficients know no internal friction: the cone
    is that of dry sand, and there is no friction by rate of shear. They are slopes of force against
    depth, which a cone does not change.
    """

    name: ClassVar[str] = "rft2d_dynamic"
    title: ClassVar[str] = "resistive force theory of 2D plates, split for 3D, for fast motion"
    citation: ClassVar[str] = f"{Rft2dLaw.citation}{_CITATION}"

    inertia: float = INERTIA
    added: float = ADDED
    cone: float = cone_under(FRICTION)

    @property
    def findings(self) -> tuple[Finding, ...]:
        return findings_of(self.name)

    @classmethod
    def from_medium(cls, medium: Medium | str) -> Self:
        medium = get_medium(medium)
        name = cls.name if cls.name in medium.constants else Rft2dLaw.name
        return cls(**{"density": medium.density.value, **constants_of(cls, medium, name)})


def _cone(constants: dict[str, Any], friction: float) -> dict[str, float]:
    """The cone of a friction, and a scale that takes it off where a plate is as deep as wide."""
    cone = cone_under(friction)
    return {"cone": cone, "scale": constants.get("scale", 1.0) / (1.0 + cone)}
