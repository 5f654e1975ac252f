"""The media that come with the package."""

from __future__ import annotations

import math

from mjgranular.medium.known import register_medium
from mjgranular.medium.medium import Medium, Quantity
from mjgranular.medium.stiffness import FRICTION_CUBIC, LEVEL_PLATE

_LINK_PAPER = (
    "Lee and Marghitu, Stopping Time for a Planar Link in Contact with a Granular Material"
)
_LI = "Li, Zhang, Goldman, Science 339, 1408 (2013), supplementary table"
_KATSURAGI = "Katsuragi, Durian, Nature Physics 3, 420 (2007)"
_AGARWAL = "Agarwal, Goldman, Kamrin, PNAS 120 (2023), doi 10.1073/pnas.2214017120"
_CHOSEN = "chosen, not measured"

FOURIER_KEYS = ("A00", "A10", "B11", "B01", "Bm11", "C11", "C01", "Cm11", "D10")
GENERIC_FOURIER = (0.206, 0.169, 0.212, 0.358, 0.055, -0.124, 0.253, 0.007, 0.088)


def _fourier(values: tuple[float, ...], which: str) -> dict[str, Quantity]:
    source = f"{_LI} S2: {which}"
    return {
        key: Quantity(value, "N/cm^3", source)
        for key, value in zip(FOURIER_KEYS, values, strict=True)
    }


play_sand = register_medium(
    Medium(
        name="play_sand",
        title="Play sand (Quikrete 1113-51)",
        # The paper uses the density of quartz grains, not of a bed with air between them. Its
        # coefficients assume that value, so it is kept.
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
                "scale": Quantity(0.33, "", f"{_LI} S2: scale factor used for glass beads"),
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

# Their default law is the one that was validated for fast motion (docs/validity.md), although the
# measurements are the table for plates.


def _measured(
    name: str,
    title: str,
    *,
    density: tuple[float, float],
    repose: float,
    plate: float,
    fourier: tuple[float, ...],
    grain: float,
    surface_friction: Quantity,
) -> Medium:
    """Register a medium of Li, Zhang and Goldman 2013.

    Args:
        name: its name.
        title: its title; with a lower-case first letter, its name in their tables.
        density: density of the grains [kg/m^3] and volume fraction of the bed.
        repose: angle of repose [degrees].
        plate: measured alpha_z of a level plate pushed straight down [N/cm^3]. The Fourier series
            is 5 to 28 % softer there.
        fourier: coefficients of the series [N/cm^3].
        grain: diameter of a grain [m].
        surface_friction: friction coefficient of a body on the grains.
    """
    bulk = Quantity(
        density[0] * density[1],
        "kg/m^3",
        f"{_LI} S1: grains of {density[0]:g} kg/m^3 fill {density[1]:g} of the bed",
    )
    mu = math.tan(math.radians(repose))
    generic = LEVEL_PLATE * bulk.value * 9.81 * float(FRICTION_CUBIC(mu))
    medium = Medium(
        name=name,
        title=title,
        density=bulk,
        grain=Quantity(grain, "m", f"{_LI} S1"),
        default_law="rft3d_dynamic",
        constants={
            "rft2d": _fourier(fourier, title[0].lower() + title[1:]),
            "rft2d_measured": {"density": bulk},
            "rft3d": {
                "density": bulk,
                "internal_friction": Quantity(
                    mu, "", f"{_LI} S1: tangent of the angle of repose, {repose:g} degrees"
                ),
                "surface_friction": surface_friction,
                "scale": Quantity(
                    1e6 * plate / generic,
                    "",
                    f"{_LI} S3: alpha_z of a level plate pushed down, {plate:g} N/cm^3",
                ),
            },
        },
    )
    return register_medium(medium)


_ON_POPPY = Quantity(0.4, "", f"{_LI} S1: aluminum on poppy seeds")

poppy_seed_loose = _measured(
    "poppy_seed_loose",
    "Poppy seed, loosely packed",
    density=(1100.0, 0.58),
    repose=36.0,
    plate=0.351,
    fourier=(0.051, 0.047, 0.053, 0.083, 0.020, -0.026, 0.057, 0.000, 0.025),
    grain=0.0007,
    surface_friction=_ON_POPPY,
)

poppy_seed_close = _measured(
    "poppy_seed_close",
    "Poppy seed, closely packed",
    density=(1100.0, 0.62),
    repose=47.0,
    plate=0.558,
    fourier=(0.094, 0.092, 0.092, 0.151, 0.035, -0.039, 0.086, 0.018, 0.046),
    grain=0.0007,
    surface_friction=_ON_POPPY,
)

_ON_GLASS = Quantity(0.4, "", _CHOSEN)
# Density of grains: the table gives 2500 to 2600 for both sizes of beads; this is the mean.
_GLASS = 2550.0

glass_beads_loose = _measured(
    "glass_beads_loose",
    "Glass beads of 0.3 mm, loosely packed",
    density=(_GLASS, 0.58),
    repose=25.0,
    plate=0.24,
    fourier=(0.040, 0.030, 0.045, 0.077, 0.000, -0.031, 0.066, 0.000, 0.017),
    grain=0.00027,
    surface_friction=_ON_GLASS,
)

glass_beads_close = _measured(
    "glass_beads_close",
    "Glass beads of 0.3 mm, closely packed",
    density=(_GLASS, 0.62),
    repose=35.0,
    plate=0.40,
    fourier=(0.081, 0.063, 0.078, 0.133, 0.024, -0.050, 0.087, 0.000, 0.033),
    grain=0.00027,
    surface_friction=_ON_GLASS,
)

glass_beads_3mm_close = _measured(
    "glass_beads_3mm_close",
    "Glass beads of 3 mm, closely packed",
    density=(_GLASS, 0.63),
    repose=21.0,
    plate=0.29,
    fourier=(0.045, 0.031, 0.046, 0.084, 0.012, -0.031, 0.060, 0.000, 0.015),
    grain=0.0032,
    surface_friction=_ON_GLASS,
)


def _natural(name: str, title: str, plate: float) -> Medium:
    """Register a medium by one measurement: a level plate pushed down [N/cm^3]."""
    medium = Medium(
        name=name,
        title=title,
        density=Quantity(1550.0, "kg/m^3", f"{_CHOSEN}: that of quikrete_medium"),
        default_law="rft2d_dynamic",
        constants={
            "rft2d": {
                **_fourier(GENERIC_FOURIER, "generic set"),
                "scale": Quantity(plate, "", f"{_LI}s: alpha_z of a level plate in N/cm^3"),
            }
        },
    )
    return register_medium(medium)


yuma_sand = _natural("yuma_sand", "Sand of Yuma", 0.691)
twentynine_palms_sand = _natural("twentynine_palms_sand", "Sand of 29 Palms", 0.888)
