"""The media that come with the package."""

from __future__ import annotations

import math

from mjgranular.medium.known import register_medium
from mjgranular.medium.medium import Medium, Quantity
from mjgranular.medium.stiffness import FRICTION_CUBIC, LEVEL_PLATE

_LINK_PAPER = (
    "Lee and Marghitu, Stopping Time for a Planar Link in Contact with a Granular Material"
)
_LI = "Li, Zhang, Goldman, Science 339, 1408 (2013), supplementary table S1"
_KATSURAGI = "Katsuragi, Durian, Nature Physics 3, 420 (2007)"
_AGARWAL = "Agarwal, Goldman, Kamrin, PNAS 120 (2023), doi 10.1073/pnas.2214017120"
_CHOSEN = "chosen, not measured"

FOURIER_KEYS = ("A00", "A10", "B11", "B01", "Bm11", "C11", "C01", "Cm11", "D10")
GENERIC_FOURIER = (0.206, 0.169, 0.212, 0.358, 0.055, -0.124, 0.253, 0.007, 0.088)
_POPPY_LOOSE = (0.051, 0.047, 0.053, 0.083, 0.020, -0.026, 0.057, 0.000, 0.025)
_POPPY_CLOSE = (0.094, 0.092, 0.092, 0.151, 0.035, -0.039, 0.086, 0.018, 0.046)


def _fourier(values: tuple[float, ...], which: str) -> dict[str, Quantity]:
    source = f"{_LI}: {which}"
    return {
        key: Quantity(value, "N/cm^3", source)
        for key, value in zip(FOURIER_KEYS, values, strict=True)
    }


play_sand = register_medium(
    Medium(
        name="play_sand",
        title="Play sand (Quikrete 1113-51)",
        # The value the paper uses is that of quartz grains rather than of a bed with air between
        # them. The coefficients belong to it, so it is kept.
        density=Quantity(2500.0, "kg/m^3", f"{_LINK_PAPER}, section 4"),
        default_law="link",
        constants={
            "link": {
                "eta_d": Quantity(6.5, "", f"{_LINK_PAPER}, section 4: dynamic frictional force"),
                "eta_h": Quantity(8.0, "", f"{_LINK_PAPER}, section 4: horizontal static force"),
                "eta_v": Quantity(22.0, "", f"{_LINK_PAPER}, section 4: vertical static force"),
                "exponent": Quantity(1.1, "", f"{_LINK_PAPER}, section 4: lambda"),
            },
            "rft2d": {
                **_fourier(GENERIC_FOURIER, "generic set"),
                "scale": Quantity(3.75, "", "used by others for play sand, uncalibrated: a guess"),
            },
        },
    )
)

quikrete_medium = register_medium(
    Medium(
        name="quikrete_medium",
        title="Quikrete medium sand",
        density=Quantity(1550.0, "kg/m^3", f"{_AGARWAL}: critical bulk density rho_c"),
        default_law="rft3d_dynamic",
        constants={
            "rft3d": {
                "density": Quantity(1550.0, "kg/m^3", f"{_AGARWAL}: rho_c"),
                "internal_friction": Quantity(
                    math.tan(math.radians(34)), "", f"{_AGARWAL}: tangent of 34 degrees"
                ),
                "surface_friction": Quantity(0.4, "", _CHOSEN),
            },
        },
    )
)

glass_beads = register_medium(
    Medium(
        name="glass_beads",
        title="Glass beads, 250 to 350 um",
        density=Quantity(1520.0, "kg/m^3", f"{_KATSURAGI}: bulk density"),
        grain=Quantity(0.0003, "m", f"{_KATSURAGI}: middle of 250 to 350 um"),
        default_law="rft2d_dynamic",
        constants={
            "rft2d": {
                **_fourier(GENERIC_FOURIER, "generic set"),
                "scale": Quantity(0.33, "", f"{_LI}: scale factor used for glass beads"),
            },
            "depth_velocity": {
                "stiffness": Quantity(
                    1040.0 * 0.0692,
                    "N/m",
                    f"{_KATSURAGI}: k/m = 1040 s^-2, a steel sphere of 25.4 mm and 69.2 g only",
                ),
                "quadratic": Quantity(
                    0.0692 / 0.087, "kg/m", f"{_KATSURAGI}: m/d1, d1 = 0.087 m, the same sphere"
                ),
            },
        },
    )
)

# Their own law is the one that was confirmed on fast motion (docs/validity.md), though the table
# for plates is what was measured of them.
_POPPY_DENSITY = Quantity(638.0, "kg/m^3", f"{_CHOSEN}: the bulk density that public codes use")
_POPPY_FRICTION = 36  # degrees


def _rft3d_of(fourier: tuple[float, ...]) -> dict[str, Quantity]:
    """Constants of `rft3d` for poppy seeds: a level plate pushed down is resisted as measured."""
    density, mu = _POPPY_DENSITY.value, math.tan(math.radians(_POPPY_FRICTION))
    flat = 1e6 * sum(fourier[:5])  # alpha_z at tilt 0, attack 90 degrees [N/m^3]
    published = density * 9.81 * float(FRICTION_CUBIC(mu))
    return {
        "density": _POPPY_DENSITY,
        "internal_friction": Quantity(mu, "", f"{_CHOSEN}: tangent of {_POPPY_FRICTION} degrees"),
        "surface_friction": Quantity(0.4, "", _CHOSEN),
        "scale": Quantity(
            flat / (LEVEL_PLATE * published), "", f"{_LI}: alpha_z of a level plate pushed down"
        ),
    }


poppy_seed_loose = register_medium(
    Medium(
        name="poppy_seed_loose",
        title="Poppy seed, loosely packed",
        density=_POPPY_DENSITY,
        default_law="rft3d_dynamic",
        constants={
            "rft2d": _fourier(_POPPY_LOOSE, "loosely packed poppy seed"),
            "rft3d": _rft3d_of(_POPPY_LOOSE),
        },
    )
)

poppy_seed_close = register_medium(
    Medium(
        name="poppy_seed_close",
        title="Poppy seed, closely packed",
        density=_POPPY_DENSITY,
        default_law="rft3d_dynamic",
        constants={
            "rft2d": _fourier(_POPPY_CLOSE, "closely packed poppy seed"),
            "rft3d": _rft3d_of(_POPPY_CLOSE),
        },
    )
)
