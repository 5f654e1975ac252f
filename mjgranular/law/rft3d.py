"""Three-dimensional resistive force theory of Agarwal, Goldman and Kamrin."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled
from mjgranular.law.law import constants_of, register_law
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

RFT3D_DTYPE = np.dtype(
    [(name, np.float64) for name in ("stiffness", "friction", "inertia", "rise")]
)


@partial(compiled, inline=True)
def polynomial(c, x1, x2, x3):
    """One of the three generic response functions."""
    return (
        c[0]
        + x1 * (c[1] + x1 * (c[4] + x1 * c[10] + x2 * c[14] + x3 * c[17]) + x2 * c[7] + x3 * c[9])
        + x2 * (c[2] + x2 * (c[5] + x2 * c[11] + x1 * c[13] + x3 * c[16]) + x3 * c[8])
        + x3 * (c[3] + x3 * (c[6] + x3 * c[12] + x2 * c[15] + x1 * c[18]))
        + c[19] * x1 * x2 * x3
    )


@partial(compiled, inline=True)
def polynomial_slope(c, x1, x2, x3):
    """One of the three functions, and its derivatives by x1 and by x3."""
    x23 = x2 * x3
    a0 = (
        c[0]
        + x2 * (c[2] + x2 * (c[5] + x2 * c[11]))
        + x3 * (c[3] + x3 * (c[6] + x3 * c[12] + x2 * c[15]) + x2 * (c[8] + x2 * c[16]))
    )
    a1 = c[1] + x2 * (c[7] + x2 * c[13]) + x3 * (c[9] + x3 * c[18]) + c[19] * x23
    a2 = c[4] + x2 * c[14] + x3 * c[17]
    by_x3 = (
        c[3]
        + x3 * (2.0 * (c[6] + x2 * c[15]) + 3.0 * x3 * c[12])
        + x2 * (c[8] + x2 * c[16] + x1 * c[19])
        + x1 * (c[9] + 2.0 * x3 * c[18] + x1 * c[17])
    )
    return (
        a0 + x1 * (a1 + x1 * (a2 + x1 * c[10])),
        a1 + x1 * (2.0 * a2 + 3.0 * x1 * c[10]),
        by_x3,
    )


@partial(compiled, inline=True)
def generic_response(nx, ny, nz, vx, vy, vz, zx, zy, zz):
    """The generic response a for a plate: `f1 m + f2 v - f3 z`.

    In the paper's local frame (r, theta, z), m = (sin b cos psi, sin b sin psi, -cos b) and
    v = (cos g, 0, -sin g), so the angles never need to be taken: x1 = -v.z, x2 = -m.z, x3 = m.v.
    The fit describes plates, with tilt b between -90 and 90 degrees: of a plate's two normals m is
    the one that points down.
    """
    down = nx * zx + ny * zy + nz * zz
    flip = -1.0 if down > 0.0 else 1.0
    x1 = -(vx * zx + vy * zy + vz * zz)
    x2 = abs(down)
    x3 = flip * (nx * vx + ny * vy + nz * vz)
    f1 = flip * polynomial(C1, x1, x2, x3)
    f2 = polynomial(C2, x1, x2, x3)
    f3 = polynomial(C3, x1, x2, x3)
    return f1 * nx + f2 * vx - f3 * zx, f1 * ny + f2 * vy - f3 * zy, f1 * nz + f2 * vz - f3 * zz


@partial(compiled, inline=True)
def rft3d_stress(law, g, nx, ny, nz, vx, vy, vz, zx, zy, zz):
    """Resistance for an area and a depth of one [N/m^3]."""
    ax, ay, az = generic_response(nx, ny, nz, vx, vy, vz, zx, zy, zz)
    along = ax * nx + ay * ny + az * nz
    tx, ty, tz = ax - along * nx, ay - along * ny, az - along * nz
    normal = abs(along)
    tangential = math.sqrt(tx * tx + ty * ty + tz * tz)
    share = 1.0
    if tangential > law.friction * normal:
        share = law.friction * normal / tangential
    # In one of 1,500 directions the fit would push the facet on. There the tangential part is cut
    # down to where the power is zero, so that the law is dissipative without a jump.
    against = normal * (nx * vx + ny * vy + nz * vz)
    along_v = tx * vx + ty * vy + tz * vz
    if share * along_v > against:
        share = against / along_v
    k = law.stiffness * g
    return (
        k * (share * tx - normal * nx),
        k * (share * ty - normal * ny),
        k * (share * tz - normal * nz),
    )


@partial(compiled, inline=True)
def rft3d_slope(law, g, nx, ny, nz, vx, vy, vz, zx, zy, zz):
    """The same, and its derivative by the direction v, row by row.

    With a = f1 n + f2 v - f3 z (flips included) and x1 = -v.z, x3 = +-n.v, the gradients of f are
    combinations of n and z; normal and tangential part, limit and cut follow by the chain rule.
    """
    down = nx * zx + ny * zy + nz * zz
    flip = -1.0 if down > 0.0 else 1.0
    along_z = vx * zx + vy * zy + vz * zz
    nv = nx * vx + ny * vy + nz * vz
    x1, x2, x3 = -along_z, abs(down), flip * nv
    f1, p11, p13 = polynomial_slope(C1, x1, x2, x3)
    f2, p21, p23 = polynomial_slope(C2, x1, x2, x3)
    f3, p31, p33 = polynomial_slope(C3, x1, x2, x3)
    f1, p11 = flip * f1, flip * p11
    p23, p33 = flip * p23, flip * p33
    ax = f1 * nx + f2 * vx - f3 * zx
    ay = f1 * ny + f2 * vy - f3 * zy
    az = f1 * nz + f2 * vz - f3 * zz
    along = f1 + f2 * nv - f3 * down
    tx, ty, tz = ax - along * nx, ay - along * ny, az - along * nz
    # The gradient of `along`, h = hn n - hz z; Dt = Da - n h = (v - nv n) g2 - (z - down n) g3
    # + f2 (1 - n n), with g = pn n - pz z.
    hn = p13 + nv * p23 - down * p33 + f2
    hz = p11 + nv * p21 - down * p31
    hx, hy, hz = hn * nx - hz * zx, hn * ny - hz * zy, hn * nz - hz * zz
    g2x, g2y, g2z = p23 * nx - p21 * zx, p23 * ny - p21 * zy, p23 * nz - p21 * zz
    g3x, g3y, g3z = p33 * nx - p31 * zx, p33 * ny - p31 * zy, p33 * nz - p31 * zz
    ex, ey, ez = vx - nv * nx, vy - nv * ny, vz - nv * nz
    qx, qy, qz = zx - down * nx, zy - down * ny, zz - down * nz
    t0, t1, t2 = ex * g2x - qx * g3x, ex * g2y - qx * g3y, ex * g2z - qx * g3z
    t3, t4, t5 = ey * g2x - qy * g3x, ey * g2y - qy * g3y, ey * g2z - qy * g3z
    t6, t7, t8 = ez * g2x - qz * g3x, ez * g2y - qz * g3y, ez * g2z - qz * g3z
    fx, fy, fz = f2 * nx, f2 * ny, f2 * nz
    t0, t1, t2 = t0 + f2 - fx * nx, t1 - fx * ny, t2 - fx * nz
    t3, t4, t5 = t3 - fy * nx, t4 + f2 - fy * ny, t5 - fy * nz
    t6, t7, t8 = t6 - fz * nx, t7 - fz * ny, t8 + f2 - fz * nz
    normal = abs(along)
    if along < 0.0:
        hx, hy, hz = -hx, -hy, -hz  # the gradient of `normal`
    tangential = math.sqrt(tx * tx + ty * ty + tz * tz)
    share, sx, sy, sz = 1.0, 0.0, 0.0, 0.0
    if tangential > law.friction * normal:
        share = law.friction * normal / tangential
        c, w = law.friction / tangential, share / (tangential * tangential)
        sx = c * hx - w * (tx * t0 + ty * t3 + tz * t6)
        sy = c * hy - w * (tx * t1 + ty * t4 + tz * t7)
        sz = c * hz - w * (tx * t2 + ty * t5 + tz * t8)
    against = normal * nv
    along_v = tx * vx + ty * vy + tz * vz
    if share * along_v > against:
        share = against / along_v
        c = 1.0 / along_v
        sx = c * (hx * nv + normal * nx - share * (tx + vx * t0 + vy * t3 + vz * t6))
        sy = c * (hy * nv + normal * ny - share * (ty + vx * t1 + vy * t4 + vz * t7))
        sz = c * (hz * nv + normal * nz - share * (tz + vx * t2 + vy * t5 + vz * t8))
    k = law.stiffness * g
    return (
        k * (share * tx - normal * nx),
        k * (share * ty - normal * ny),
        k * (share * tz - normal * nz),
        k * (share * t0 + tx * sx - nx * hx),
        k * (share * t1 + tx * sy - nx * hy),
        k * (share * t2 + tx * sz - nx * hz),
        k * (share * t3 + ty * sx - ny * hx),
        k * (share * t4 + ty * sy - ny * hy),
        k * (share * t5 + ty * sz - ny * hz),
        k * (share * t6 + tz * sx - nz * hx),
        k * (share * t7 + tz * sy - nz * hy),
        k * (share * t8 + tz * sz - nz * hz),
    )


@register_law
@dataclass(frozen=True)
class Rft3dLaw(RftLaw):
    r"""Three-dimensional resistive force theory: any surface element, any direction.

    .. math::
        \\alpha = \\xi_n \\{ |a_n| (-n) + \\min(\\mu_s |a_n| / |a_t|, 1)\\, a_t \\},
        \\qquad dF = \\alpha |z|\\, dA

    on leading elements below the surface, with the generic response `a` of the direction of motion
    and of the surface, and :math:`\\xi_n = \\rho_c g (894 \\mu^3 - 386 \\mu^2 + 89 \\mu)`.

    Attributes:
        density: critical bulk density rho_c [kg/m^3].
        internal_friction: mu, 0.3 to 0.9.
        surface_friction: mu_s between grains and the intruder.
        inertia: lambda of the dynamic term -n lambda rho v_n^2; 0 leaves it out. 1.1 is the value
            of Agarwal et al. 2021 for horizontal plates.
        rise: lower the surface behind a turning body by r (r w^2/g), for wheels.
        scale: factor on the stiffness, from a calibration; see `calibrated`.

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
    stress: ClassVar[Any] = rft3d_stress
    slope: ClassVar[Any] = rft3d_slope
    strength_keys: ClassVar[tuple[str, ...]] = ("stiffness",)

    density: float
    internal_friction: float
    surface_friction: float
    inertia: float = 0.0
    rise: bool = False
    scale: float = 1.0

    def __post_init__(self) -> None:
        self.check_options()
        for key, low, high in (
            ("density", 0.0, math.inf),
            ("internal_friction", 0.0, 2.0),
            ("surface_friction", 0.0, math.inf),
            ("scale", 0.0, math.inf),
        ):
            value = getattr(self, key)
            if not (math.isfinite(value) and low <= value <= high):
                raise InputError(
                    f"Rft3dLaw: {key} must be finite and from {low:g} to {high:g}, not {value}"
                )

    @classmethod
    def from_medium(cls, medium: Medium) -> Self:
        return cls(**constants_of(cls, medium))

    @classmethod
    def calibrated(
        cls, medium: Medium, *, force: float, area: float, depth: float, gravity: float = 9.81
    ) -> Self:
        """The law with its stiffness from one measurement: a flat plate pushed straight down.

        Args:
            medium: gives density and frictions.
            force: measured resistance [N].
            area: of the plate [m^2].
            depth: of the plate [m].
            gravity: where it was measured [m/s^2].
        """
        plain = cls.from_medium(medium)
        flat = 0.87574  # |a_z| for a horizontal plate moving down, from the fit
        scale = force / (flat * area * depth) / (plain.stiffness * gravity)
        return replace(plain, scale=scale)

    @property
    def stiffness(self) -> float:
        """xi_n / g [kg/m^3]: 894 mu^3 - 386 mu^2 + 89 mu times density and scale."""
        mu = self.internal_friction
        return self.scale * self.density * (894 * mu**3 - 386 * mu**2 + 89 * mu)

    def parameters(self, medium: Medium) -> np.ndarray:
        parameters = np.zeros(1, RFT3D_DTYPE)
        parameters["stiffness"] = self.stiffness
        parameters["friction"] = self.surface_friction
        parameters["inertia"] = self.inertia * self.density
        parameters["rise"] = self.rise
        return parameters
