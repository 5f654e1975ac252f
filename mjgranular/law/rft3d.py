"""Three-dimensional resistive force theory of Agarwal, Goldman and Kamrin."""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import vector
from mjgranular.law.law import register_law
from mjgranular.law.raised import CONE_FORMS, FRICTION_CUBIC, shear_constants
from mjgranular.law.rft import RftLaw
from mjgranular.medium import Medium

# Agarwal et al. 2023, supplementary table: coefficients of the monomials of x1, x2, x3 in the order
# 1, x1, x2, x3, x1^2, x2^2, x3^2, x1 x2, x2 x3, x3 x1, x1^3, x2^3, x3^3, x1 x2^2, x2 x1^2, x2 x3^2,
# x3 x2^2, x3 x1^2, x1 x3^2, x1 x2 x3. Two public codes differ in one number each (-0.20770 for
# c3[15], 0.18589 for c2[16]); these are the published ones.
# fmt: off
C1 = (0.00212, -0.02320, -0.20890, -0.43083, -0.00259, 0.48872, -0.00415, 0.07204, -0.02750,
      -0.08772, 0.01992, -0.45961, 0.40799, -0.10107, -0.06576, 0.05664, -0.09269, 0.01892,
      0.01033, 0.15120)
C2 = (-0.06796, -0.10941, 0.04725, -0.06914, -0.05835, -0.65880, -0.11985, -0.25739, -0.26834,
      0.02692, -0.00736, 0.63758, 0.08997, 0.21069, 0.04748, 0.20406, 0.18519, 0.04934,
      0.13527, -0.33207)
C3 = (-0.02634, -0.03436, 0.45256, 0.00835, 0.02553, -1.31290, -0.05532, 0.06790, -0.16404,
      0.02287, 0.02927, 0.95406, -0.00131, -0.11028, 0.01487, -0.02730, 0.10911, -0.04097,
      0.07881, -0.27519)
# fmt: on

LEVEL_PLATE = 0.87574
"""|a_z| of the generic response, for a level plate that moves straight down."""

UPRIGHT = 1e-6
"""A wall whose normal points up by less counts as upright. Chosen: there the fit jumps by a fifth
of the force, and rounding, in single precision too, must not decide."""


@partial(compiled, inline=True)
def polynomial_slope(c, x1, x2, x3, x22, x33, x23):
    """Return one of the three functions, and its three derivatives.

    It is a polynomial in x1 = -v.z whose coefficients are polynomials in x2 = -m.z and x3 = m.v
    with their own derivatives; x22, x33 and x23 are products that all three functions share.
    """
    a2 = c[4] + c[14] * x2 + c[17] * x3
    a1 = (c[1] + c[7] * x2 + c[9] * x3) + (c[13] * x22 + c[18] * x33 + c[19] * x23)
    a0 = (c[2] + c[5] * x2 + c[8] * x3) + (c[11] * x22 + c[15] * x33 + c[16] * x23)
    a0 = (c[0] + x3 * (c[3] + c[6] * x3 + c[12] * x33)) + x2 * a0
    a1_2 = c[7] + 2.0 * c[13] * x2 + c[19] * x3
    a1_3 = c[9] + 2.0 * c[18] * x3 + c[19] * x2
    a0_2 = (c[2] + 2.0 * c[5] * x2 + c[8] * x3) + (
        3.0 * c[11] * x22 + c[15] * x33 + 2.0 * c[16] * x23
    )
    a0_3 = (c[3] + 2.0 * c[6] * x3 + c[8] * x2) + (
        3.0 * c[12] * x33 + c[16] * x22 + 2.0 * c[15] * x23
    )
    top = c[10] * x1
    return (
        a0 + x1 * (a1 + x1 * (a2 + top)),
        a1 + x1 * (2.0 * a2 + 3.0 * top),
        a0_2 + x1 * (a1_2 + x1 * c[14]),
        a0_3 + x1 * (a1_3 + x1 * c[17]),
    )


@partial(compiled, inline=True)
def rft3d_slope(law, g, rise, down, lead):
    """Return the resistance for unit area and depth, by the cosines: see `RftLaw.slope`.

    In the paper's local frame (r, theta, z) the generic response for a plate is f1 m + f2 v - f3 z
    with m = (sin b cos psi, sin b sin psi, -cos b) and v = (cos g, 0, -sin g), so that no angles
    are needed: x1 = -v.z, x2 = -m.z, x3 = m.v. The fit describes plates, with tilt b between -90
    and 90 degrees: of a plate's two normals m = +-n is the one that points down. The tangential
    part of the response is t = f2 v - f3 z - tau m.

    In 0.05 % of directions the fit would add energy. There the tangential part is reduced to
    zero power, so that the law is dissipative and continuous.
    """
    flip = -1.0 if down > UPRIGHT else 1.0
    x1, x2, x3 = -rise, -flip * down, flip * lead
    x22, x33, x23 = x2 * x2, x3 * x3, x2 * x3
    f, f_1, f_2, f_3 = polynomial_slope(C1, x1, x2, x3, x22, x33, x23)
    p, p_1, p_2, p_3 = polynomial_slope(C2, x1, x2, x3, x22, x33, x23)
    q, q_1, q_2, q_3 = polynomial_slope(C3, x1, x2, x3, x22, x33, x23)
    tau = p * x3 + q * x2
    t_1, t_2, t_3 = p_1 * x3 + q_1 * x2, p_2 * x3 + q_2 * x2 + q, p_3 * x3 + q_3 * x2 + p
    along = f + tau
    normal, sign = abs(along), math.copysign(1.0, along)
    n_1, n_2, n_3 = sign * (f_1 + t_1), sign * (f_2 + t_2), sign * (f_3 + t_3)
    # The tangential part's products with v and with z, of which m has none.
    v_along = p + q * x1
    along_v, z_along = v_along - tau * x3, q + p * x1
    square = max(p * v_along + q * z_along - tau * tau, 0.0)
    tangential = math.sqrt(square)
    # The share of it that is kept, a quotient.
    top, bottom = 1.0, 1.0
    limited = tangential > law.friction * normal
    if limited:
        top, bottom = law.friction * normal, tangential
    against = max(normal * lead, 0.0)
    cut = top * along_v > against * bottom
    if cut:
        top, bottom = against, along_v
    inverse = 1.0 / bottom
    share = top * inverse
    # Its derivatives: that of the numerator is c times the normal part's, except for d; that of the
    # denominator is a sum of those of p, q and tau.
    c, d, by_p, by_q, by_tau = 0.0, 0.0, 0.0, 0.0, 0.0
    if limited:
        c = law.friction
        by_p, by_q, by_tau = inverse * v_along, inverse * z_along, inverse * tau
    if cut:
        c, d, by_p, by_q, by_tau = max(lead, 0.0), (normal if lead > 0.0 else 0.0), 1.0, x1, x3
    w = share * inverse
    c, by_p, by_q, by_tau = inverse * c, w * by_p, w * by_q, w * by_tau
    s_1 = c * n_1 - by_p * p_1 - by_q * q_1 + by_tau * t_1
    s_2 = c * n_2 - by_p * p_2 - by_q * q_2 + by_tau * t_2
    s_3 = c * n_3 - by_p * p_3 - by_q * q_3 + by_tau * t_3
    # And those by the cosines within it.
    s_1 -= w * (q if cut else (p * q * inverse if limited else 0.0))
    if cut:
        s_3 += w * tau + inverse * flip * d
    side = flip * share
    return (
        law.stiffness * g,
        vector(-normal - side * tau, share * p, -share * q),
        vector(
            n_1 + flip * (s_1 * tau + share * t_1), -(s_1 * p + share * p_1), s_1 * q + share * q_1
        ),
        vector(
            flip * n_2 + s_2 * tau + share * t_2,
            -flip * (s_2 * p + share * p_2),
            flip * (s_2 * q + share * q_2),
        ),
        vector(
            -flip * n_3 - (s_3 * tau + share * t_3),
            flip * (s_3 * p + share * p_3),
            -flip * (s_3 * q + share * q_3),
        ),
    )


@register_law
@dataclass(frozen=True)
class Rft3dLaw(RftLaw):
    r"""Three-dimensional resistive force theory: any surface element, any direction.

    $$
    \alpha = \xi_n \{ |a_n| (-n) + \min(\mu_s |a_n| / |a_t|, 1)\, a_t \},
    \qquad dF = \alpha |z|\, dA
    $$

    on leading elements below the surface, with the generic response `a` of the direction of motion
    and of the surface, and $\xi_n = \rho_c g (894 \mu^3 - 386 \mu^2 + 89 \mu)$.

    Attributes:
        density: critical bulk density rho_c [kg/m^3].
        internal_friction: mu, 0.3 to 0.9.
        surface_friction: mu_s between grains and the intruder.
        inertia: lambda of the dynamic term -n lambda rho v_n^2; 0 omits it. 1.1 is the value
            of Agarwal et al. 2021 for horizontal plates.
        added: kappa of the added mass: leading facets move a layer of sand that is kappa
            times as deep as their face is wide, deeper if it is long; 0 omits it.
        rise: lower the surface behind a turning body by r (r w^2/g), for wheels.
        scale: factor on the stiffness, from a calibration; see `calibrated`.
        cone: mean depth of the stagnant sand under flat faces, in their widths; 0 omits it.
        rate: rise of internal friction from slow flow to fast, Jop et al. 2006; 0 omits it.
        grain: diameter of a grain [m], which `rate` needs.
        lateral: L, factor on lateral strength (`law.lateral`); 0 omits it.
        slip: tangent within which skin that slides along itself takes sand along (`law.slip`);
            0 omits it.

    Raises:
        InputError: a value outside its range.
    """

    name: ClassVar[str] = "rft3d"
    title: ClassVar[str] = "resistive force theory in 3D: stress on surface elements"
    citation: ClassVar[str] = (
        "S. Agarwal, D. I. Goldman, K. Kamrin, Mechanistic framework for reduced-order models in "
        "soft materials: Application to three-dimensional granular intrusion, PNAS 120 (2023), "
        "doi 10.1073/pnas.2214017120; inertial term and surface correction: S. Agarwal, A. Karsai, "
        "D. I. Goldman, K. Kamrin, Sci. Adv. 7 eabe0631 (2021)"
    )
    slope: ClassVar[Any] = rft3d_slope
    strength_keys: ClassVar[tuple[str, ...]] = ("stiffness",)
    density_keys: ClassVar[tuple[str, ...]] = ("inertia", "density")

    density: float
    internal_friction: float
    surface_friction: float
    inertia: float = 0.0
    rise: bool = False
    scale: float = 1.0
    added: float = 0.0
    cone: float = 0.0
    rate: float = 0.0
    grain: float = 0.0
    lateral: float = 0.0
    slip: float = 0.0

    def __post_init__(self) -> None:
        self.check_numbers("internal_friction", high=2.0)
        self.check_numbers("grain", high=0.1)
        self.check_options("density", "surface_friction", "scale")

    @classmethod
    def calibrated(
        cls, medium: Medium, *, force: float, area: float, depth: float, gravity: float = 9.81
    ) -> Self:
        """Return the law with its stiffness calibrated by a flat plate pushed straight down.

        With a `cone` the plate is a square, pushed slowly.

        Args:
            medium: source of density and frictions.
            force: measured resistance [N].
            area: area of the plate [m^2].
            depth: depth of the plate [m].
            gravity: gravity at the measurement [m/s^2].
        """
        plain = cls.from_medium(medium)
        side = math.sqrt(area)
        raised = 1.0 + plain.cone * side / max(depth, CONE_FORMS * side)
        met = LEVEL_PLATE * area * depth * plain.stiffness * gravity * raised
        return replace(plain, scale=plain.scale * force / met)

    @property
    def stiffness(self) -> float:
        """xi_n / g [kg/m^3]: the cubic of the internal friction times density and scale."""
        return self.scale * self.density * float(FRICTION_CUBIC(self.internal_friction))

    def parameters(self, medium: Medium) -> np.ndarray:
        shear = shear_constants(self.density, self.grain, self.internal_friction, self.rate)
        return self.record(stiffness=self.stiffness, friction=self.surface_friction, **shear)
