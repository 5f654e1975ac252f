"""Resistive force theory for feet and bodies at the speeds of robots.

The quasi-static laws plus all effects of moving sand, each with its published constant: lambda of
the inertial term, added mass, stagnant sand under flat faces, lateral strength, and friction that
grows with the shear rate (docs/laws/rft.md, docs/validity.md).
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Self

from mjgranular.law.lateral import lateral_strength, measured_slope
from mjgranular.law.law import constants_of, register_law
from mjgranular.law.raised import RATE, cone_under
from mjgranular.law.rft import RftLaw
from mjgranular.law.rft2d import Rft2dLaw
from mjgranular.law.rft3d import Rft3dLaw, rft3d_slope
from mjgranular.law.slip import SLIP
from mjgranular.law.validity import Finding, Limit, findings_of
from mjgranular.medium import Medium, get_medium

INERTIA = 1.1
"""lambda: S. Agarwal, A. Karsai, D. I. Goldman, K. Kamrin, Sci. Adv. 7 eabe0631 (2021)."""

ADDED = 2.5  # kappa: chosen by two drops of a ball in simulated grains (docs/validity.md)

FRICTION = 0.6
"""Internal friction for the cone, if a law has none: that of dry sands, 31 degrees; chosen."""

_CITATION = (
    "; inertial term: S. Agarwal, A. Karsai, D. I. Goldman, K. Kamrin, Sci. Adv. 7 eabe0631 "
    "(2021); added mass after J. Aguilar, D. I. Goldman, Nature Physics 12, 278 (2016); stagnant "
    "sand: W. Kang, Y. Feng, C. Liu, R. Blumenfeld, Nature Communications 9, 1101 (2018); lateral "
    "strength after R. Lancellotta, Geotechnique 52, 617 (2002)"
)

# The largest error of an estimate, in whole percents; chosen (docs/validity.md).
_WITHIN = 0.25


def _confirmed(name: str, inertial_number: float | None = None) -> tuple[Limit, ...]:
    """Return limits of a law: the speed and the width in grains for which it was confirmed.

    Without an inertial number, the greatest in the confirming runs, that limit is that of slow
    laws.
    """
    froude = 0.0
    for finding in sorted(findings_of(name), key=lambda finding: finding.froude):
        if round(finding.error, 2) > _WITHIN:
            break
        froude = finding.froude
    source = f"trajectories within {_WITHIN:.0%}: docs/validity.md"
    own = {"froude": froude, "inertial_number": inertial_number}
    return tuple(
        Limit(limit.measure, own[limit.measure], source) if own.get(limit.measure) else limit
        for limit in RftLaw.validity
    )


class _Dynamic(RftLaw):
    """Common part of the laws for fast motion: constants of the quasi-static laws, own findings."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        return findings_of(self.name)

    @classmethod
    def from_medium(cls, medium: Medium | str) -> Self:
        medium = get_medium(medium)
        constants = constants_of(cls, medium)
        cone = constants.get("cone", cone_under(constants.get("internal_friction", FRICTION)))
        scale = constants.get("scale", 1.0)
        if medium.key_for(cls.name) != cls.name or "scale" not in constants:
            scale /= 1.0 + cone  # the quasi-static law's stiffness is force over depth
        general = {"density": medium.density}
        if medium.grain is not None and cls.rate > 0:
            general["grain"] = medium.grain
        given = {name: quantity.value for name, quantity in general.items()}
        given = {**given, **constants, "cone": cone, "scale": scale}
        return cls(**{"lateral": cls.lateral_in(given), **given})

    @classmethod
    def lateral_in(cls, given: dict[str, Any]) -> float:
        """Return L of `law.lateral`, from the law's constants."""
        return 1.0 + given["cone"]


@register_law
@dataclass(frozen=True)
class DynamicRft3dLaw(_Dynamic, Rft3dLaw):
    """`Rft3dLaw` with all effects of moving sand switched on.

    It uses a medium's constants for `rft3d`: the cone follows from the internal friction, the grain
    size is the medium's (without one there is no `rate`), and `scale` removes what the cone adds to
    a plate as deep as wide, since published stiffness is force over depth (chosen: plates were
    pushed to about that). A calibration is more accurate: `mjgranular fit`.

    Only `from_medium` derives `cone` and `lateral` from a friction. If you set or change
    `internal_friction` alone, set them too (`law.raised.cone_under`, `law.lateral`).
    """

    name: ClassVar[str] = "rft3d_dynamic"
    title: ClassVar[str] = "resistive force theory in 3D for fast motion"
    citation: ClassVar[str] = (
        f"{Rft3dLaw.citation.partition(';')[0]}{_CITATION}; friction by rate of shear: P. Jop, "
        "Y. Forterre, O. Pouliquen, Nature 441, 727 (2006)"
    )

    slope: ClassVar[Any] = measured_slope(rft3d_slope)
    validity: ClassVar[tuple[Limit, ...]] = _confirmed("rft3d_dynamic", inertial_number=1.6)

    inertia: float = INERTIA
    added: float = ADDED
    cone: float = cone_under(FRICTION)
    rate: float = RATE
    lateral: float = (1.0 + cone_under(FRICTION)) * lateral_strength(FRICTION)
    slip: float = SLIP

    @classmethod
    def lateral_in(cls, given: dict[str, Any]) -> float:
        return super().lateral_in(given) * lateral_strength(given["internal_friction"])


@register_law
@dataclass(frozen=True)
class DynamicRft2dLaw(_Dynamic, Rft2dLaw):
    """`Rft2dLaw` with all effects of moving sand switched on.

    It uses a medium's constants for `rft2d` as `DynamicRft3dLaw` uses those for `rft3d`. They do
    not contain internal friction: the cone is that of dry sand, and no friction grows with shear.
    """

    name: ClassVar[str] = "rft2d_dynamic"
    title: ClassVar[str] = "resistive force theory of 2D plates, split for 3D, for fast motion"
    citation: ClassVar[str] = f"{Rft2dLaw.citation}{_CITATION}"

    validity: ClassVar[tuple[Limit, ...]] = _confirmed("rft2d_dynamic")

    inertia: float = INERTIA
    added: float = ADDED
    cone: float = cone_under(FRICTION)
    lateral: float = 1.0 + cone_under(FRICTION)
    slip: float = SLIP
