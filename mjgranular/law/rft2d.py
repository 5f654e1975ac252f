"""Two-dimensional resistive force theory of Li, Zhang and Goldman, with an out-of-plane part."""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.elementary import exponential, logarithm
from mjgranular.kernel.vector import vector
from mjgranular.law.law import constants_of, register_law
from mjgranular.law.rft import RftLaw
from mjgranular.medium import Medium, get_medium
from mjgranular.medium.file import FOURIER_KEYS, GENERIC_FOURIER

PER_GRAVITY = 1e6 / 9.81  # N/cm^3, as measured at 9.81 m/s^2, in N/m^3 over gravity
# Horizontal part of the normal below which an element counts as level: of Treers et al.
_LEVEL = 1e-3
# Least sideways part of a motion in the derivative, which is singular at zero. Chosen.
_SLIGHT = 1e-6
# Of Treers et al.: both shares are zero at zero velocity.
_ATANH_LEAST, _TANH_LEAST = math.atanh(0.973746396532650), math.tanh(1.60910808139526)


@partial(compiled, inline=True)
def in_plane_slope(v):
    """Return the in-plane response scale of Treers et al. for that velocity part; and its slope."""
    bend = min(1.61146827229181 * v - 0.973746396532650, 0.9999999)
    more = 1.0 + bend
    inverse = 1.0 / (more * (1.0 - bend))
    atanh = 0.5 * logarithm(more * more * inverse)
    gain = 1.99392673405210 / 5.81083560370960
    return gain * (atanh + _ATANH_LEAST), gain * 1.61146827229181 * inverse


@partial(compiled, inline=True)
def sideways_slope(v):
    """Return the sideways response scale of Treers et al. for that velocity part; and its slope."""
    tanh = 1.0 - 2.0 / (1.0 + exponential(2.0 * (3.62263982880971 * v - 1.60910808139526)))
    gain = 0.440850096954369 / 0.832324700111401
    return gain * (tanh + _TANH_LEAST), gain * 3.62263982880971 * (1.0 - tanh * tanh)


@partial(compiled, inline=True)
def planar_response(law, sin_b, cos_b, sin_g, cos_g):
    """Return alpha_z and alpha_x of Li et al. for tilt b and attack g [N/cm^3], with derivatives.

    The Fourier terms of 2b and g, written in products of their sines and cosines. Each number is
    followed by its derivatives by g and by b.
    """
    cos_2b, sin_2b = cos_b * cos_b - sin_b * sin_b, 2.0 * sin_b * cos_b
    s, c = sin_2b * cos_g, cos_2b * sin_g
    sin_p, sin_m = s + c, c - s  # of 2b + g and of -2b + g
    s, c = sin_2b * sin_g, cos_2b * cos_g
    cos_p, cos_m = c - s, c + s
    up = law.A00 + law.A10 * cos_2b + law.B11 * sin_p + law.B01 * sin_g + law.Bm11 * sin_m
    up_g = law.B11 * cos_p + law.B01 * cos_g + law.Bm11 * cos_m
    up_b = 2.0 * (law.B11 * cos_p - law.Bm11 * cos_m - law.A10 * sin_2b)
    back = law.C11 * cos_p + law.C01 * cos_g + law.Cm11 * cos_m + law.D10 * sin_2b
    back_g = -(law.C11 * sin_p + law.C01 * sin_g + law.Cm11 * sin_m)
    back_b = 2.0 * (law.Cm11 * sin_m - law.C11 * sin_p + law.D10 * cos_2b)
    return up, up_g, up_b, back, back_g, back_b


@partial(compiled, inline=True)
def level_response(law, rise, down):
    """Return the resistance of a level element, which is the same in all horizontal directions.

    Given are v.z and n.z, which is 1 or -1 except for rounding. Returned are the resistance along
    the motion over its horizontal part, and alpha_z [N/cm^3], each with its derivatives by v.z and
    n.z.
    """
    square = down * down
    flat, turn = law.C01 + (law.C11 + law.Cm11) * square, law.B01 + (law.B11 + law.Bm11) * square
    flat_d = 2.0 * down * (law.C11 + law.Cm11)
    up_d = 2.0 * down * (law.A10 - (law.B11 + law.Bm11) * rise)
    return flat, 0.0, flat_d, law.A00 + law.A10 * square - turn * rise, -turn, up_d


@partial(compiled, inline=True)
def rft2d_slope(law, g, rise, down, lead):
    """Return the resistance for unit area and depth, by the cosines: see `RftLaw.slope`.

    The plane is that of the element's normal n and the vertical z, as in Treers et al. 2021, with e
    along the horizontal part of n; a level element takes the plane of its motion instead. The
    velocity splits into its part in the plane, which is resisted as in two dimensions, and its
    sideways part, which meets the resistance of a plate dragged along itself. In the plane (e, z):
    n = (sin b, -cos b), v = (cos g, -sin g) and the response (-alpha_x, alpha_z).

    First come the factors of e, v and z and their derivatives by v_e, by v.z and by the tilt b;
    then e = (n - down z) / sin b is inserted. The suffix of a name is the variable of the
    derivative: e for v_e, r for v.z, d for n.z, l for n.v, g for the attack, b for the tilt.
    """
    sin_b, cos_b = math.sqrt(max(1.0 - down * down, 0.0)), -down
    per = 1.0 / max(sin_b, _LEVEL)
    v_e = (lead - down * rise) * per
    square = v_e * v_e + rise * rise
    in_plane = math.sqrt(square)
    # Motion nearly in the plane has almost no sideways part, whatever its change.
    sideways = math.sqrt(max(1.0 - square, _SLIGHT * _SLIGHT))
    inverse = 1.0 / max(in_plane, 1e-12)
    cos_g, sin_g = v_e * inverse, -rise * inverse
    up, up_g, up_b, back, back_g, back_b = planar_response(law, sin_b, cos_b, sin_g, cos_g)

    # In the plane: its share k; and k times the attack's derivatives.
    k, k_v = in_plane_slope(in_plane)
    turn = k * inverse
    k_e, k_r, g_e, g_r = k_v * cos_g, -k_v * sin_g, -turn * sin_g, -turn * cos_g
    # Sideways: the resistance w per unit motion.
    w, w_v = sideways_slope(sideways)
    inverse = 1.0 / sideways
    w *= law.side * inverse
    turn = (w - law.side * w_v) * inverse * inverse
    w_e, w_r = turn * v_e, turn * rise
    e, z = w * v_e - k * back, w * rise + k * up
    e_e, e_r = w + w_e * v_e - k_e * back - g_e * back_g, w_r * v_e - k_r * back - g_r * back_g
    z_e, z_r = w_e * rise + k_e * up + g_e * up_g, w + w_r * rise + k_r * up + g_r * up_g
    # From v_e, v.z and b to the cosines.
    by_r, by_d = -down * per, (v_e * down * per - rise) * per
    n, u = e * per, -w
    n_l, n_r = e_e * per * per, (e_r + e_e * by_r) * per
    n_d = (e_e * by_d + (n * down - k * back_b) * per) * per
    u_l, u_r, u_d = -w_e * per, -(w_r + w_e * by_r), -w_e * by_d
    z_l, z_r = z_e * per - n_l * down, z_r + z_e * by_r - n_r * down
    z_d = k * up_b * per + z_e * by_d - n_d * down - n
    z -= n * down
    if sin_b < _LEVEL:  # takes the plane of its motion
        flat, flat_r, flat_d, up, up_r, up_d = level_response(law, rise, down)
        n, u, z = 0.0, -flat, up + flat * rise
        n_l, u_l, z_l, n_r, n_d = 0.0, 0.0, 0.0, 0.0, 0.0
        u_r, u_d = -flat_r, -flat_d
        z_r, z_d = up_r + flat + flat_r * rise, up_d + flat_d * rise
    by_rise, by_down = vector(n_r, u_r, z_r), vector(n_d, u_d, z_d)
    return law.scale * g, vector(n, u, z), by_rise, by_down, vector(n_l, u_l, z_l)


@register_law
@dataclass(frozen=True)
class Rft2dLaw(RftLaw):
    r"""Two-dimensional resistive force theory; out of the plane by the split of Treers et al.

    $$
    \begin{aligned}
    \alpha_z &= A_{00} + A_{10} \cos 2\beta + B_{11} \sin(2\beta + \gamma)
                + B_{01} \sin \gamma + B_{-11} \sin(-2\beta + \gamma) \\
    \alpha_x &= C_{11} \cos(2\beta + \gamma) + C_{01} \cos \gamma
                + C_{-11} \cos(-2\beta + \gamma) + D_{10} \sin 2\beta
    \end{aligned}
    $$

    on leading elements below the surface, dF = (g / 9.81 m/s^2) alpha |z| dA.

    Attributes:
        A00, A10, B11, B01, Bm11, C11, C01, Cm11, D10: Fourier coefficients [N/cm^3], as printed.
        density: bulk density, for the inertial term [kg/m^3].
        scale: factor zeta on the coefficients; for the generic set, the medium's.
        inertia: lambda of the dynamic term -n lambda rho v_n^2; 0 omits it.
        added: kappa of the added mass, see `Rft3dLaw`; 0 omits it.
        cone: mean depth of the stagnant sand under flat faces, in their widths; 0 omits it.
        lateral: L, factor on lateral strength (`law.lateral`); 0 omits it.
        slip: tangent within which skin that slides along itself takes sand along (`law.slip`);
            0 omits it.
        rise: lower the surface behind a turning body by r (r w^2/g), for wheels.

    Raises:
        InputError: a value that is not finite, or a negative scale, density or inertia.
    """

    name: ClassVar[str] = "rft2d"
    title: ClassVar[str] = "resistive force theory of 2D plates, split for 3D"
    citation: ClassVar[str] = (
        "C. Li, T. Zhang, D. I. Goldman, A terradynamics of legged locomotion on granular media, "
        "Science 339, 1408 (2013); out of the plane: L. K. Treers, C. Cao, H. S. Stuart, IEEE "
        "Robotics and Automation Letters 6 (2021), doi 10.1109/LRA.2021.3057052"
    )
    slope: ClassVar[Any] = rft2d_slope
    strength_keys: ClassVar[tuple[str, ...]] = ("scale",)
    density_keys: ClassVar[tuple[str, ...]] = ("inertia", "density")

    A00: float
    A10: float
    B11: float
    B01: float
    Bm11: float
    C11: float
    C01: float
    Cm11: float
    D10: float
    density: float = 0.0
    scale: float = 1.0
    inertia: float = 0.0
    rise: bool = False
    added: float = 0.0
    cone: float = 0.0
    lateral: float = 0.0
    slip: float = 0.0

    def __post_init__(self) -> None:
        self.check_options("density", "scale")
        if (self.inertia > 0 or self.added > 0) and self.density == 0:
            raise InputError(
                f"{type(self).__name__}: inertia of sand needs the bulk density [kg/m^3]"
            )
        self.check_numbers(*FOURIER_KEYS, low=-math.inf)

    @classmethod
    def from_medium(cls, medium: Medium | str) -> Self:
        medium = get_medium(medium)
        return cls(**{"density": medium.density.value, **constants_of(cls, medium)})

    @classmethod
    def generic(cls, scale: float, **options: Any) -> Self:
        """Return the law with the generic coefficients of Li et al., times `scale`."""
        coefficients = dict(zip(FOURIER_KEYS, GENERIC_FOURIER, strict=True))
        return cls(**coefficients, scale=scale, **options)

    def parameters(self, medium: Medium) -> np.ndarray:
        coefficients = {key: getattr(self, key) for key in FOURIER_KEYS}
        # A plate dragged along itself: alpha_x at tilt 0, attack 0.
        side = self.C11 + self.C01 + self.Cm11
        return self.record(**coefficients, side=side, scale=self.scale * PER_GRAVITY)
