"""The media that come with the package."""

import csv
import math
from pathlib import Path

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


def _measured(row: dict[str, str]) -> Medium:
    """Register a medium of Li, Zhang and Goldman 2013 from a row of `li_2013.csv`.

    Its title with a lower-case first letter is its name in their tables, which give 2500 to 2600
    kg/m^3 for grains of glass: the row has the mean. `plate` is the measured alpha_z of a level
    plate pushed straight down, where the Fourier series is 5 to 28 % softer. The default law is the
    one that was validated for fast motion (docs/validity.md), not the table for plates.
    """
    title = row["title"]
    grains, fraction = float(row["grains [kg/m^3]"]), float(row["fraction"])
    repose, plate = float(row["repose [degrees]"]), float(row["plate [N/cm^3]"])
    bulk = Quantity(
        grains * fraction,
        "kg/m^3",
        f"{_LI} S1: grains of {grains:g} kg/m^3 fill {fraction:g} of the bed",
    )
    mu = math.tan(math.radians(repose))
    generic = LEVEL_PLATE * bulk.value * 9.81 * float(FRICTION_CUBIC(mu))
    is_measured = row["its source"] == "measured"
    medium = Medium(
        name=row["name"],
        title=title,
        density=bulk,
        grain=Quantity(float(row["grain [m]"]), "m", f"{_LI} S1"),
        default_law="rft3d_dynamic",
        constants={
            "rft2d": _fourier(
                tuple(float(row[key]) for key in FOURIER_KEYS), title[0].lower() + title[1:]
            ),
            "rft2d_measured": {"density": bulk},
            "rft3d": {
                "density": bulk,
                "internal_friction": Quantity(
                    mu, "", f"{_LI} S1: tangent of the angle of repose, {repose:g} degrees"
                ),
                "surface_friction": Quantity(
                    float(row["surface friction"]),
                    "",
                    f"{_LI} S1: aluminum on poppy seeds" if is_measured else _CHOSEN,
                ),
                "scale": Quantity(
                    1e6 * plate / generic,
                    "",
                    f"{_LI} S3: alpha_z of a level plate pushed down, {plate:g} N/cm^3",
                ),
            },
        },
    )
    return register_medium(medium)


with Path(__file__).with_name("li_2013.csv").open(encoding="utf-8") as _file:
    for _row in csv.DictReader(_file):
        _measured(_row)


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
