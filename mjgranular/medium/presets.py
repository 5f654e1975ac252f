"""The media that come with the package."""

import csv
import math
from collections.abc import Iterator
from pathlib import Path

from mjgranular.medium.file import register_medium
from mjgranular.medium.medium import Medium, Quantity
from mjgranular.medium.stiffness import FRICTION_CUBIC, LEVEL_PLATE

_LI = "Li, Zhang, Goldman, Science 339, 1408 (2013), supplementary table"
_CHOSEN = "chosen, not measured"

FOURIER_KEYS = ("A00", "A10", "B11", "B01", "Bm11", "C11", "C01", "Cm11", "D10")
GENERIC_FOURIER = (0.206, 0.169, 0.212, 0.358, 0.055, -0.124, 0.253, 0.007, 0.088)

_MEDIA = {
    # The paper uses the density of quartz grains, not of a bed with air between them. Its
    # coefficients assume that value, so it is kept.
    "play_sand": ("Play sand (Quikrete 1113-51)", "link"),
    "quikrete_medium": ("Quikrete medium sand", "rft3d_dynamic"),
    "glass_beads": ("Glass beads, 250 to 350 um", "rft2d_dynamic"),
    "yuma_sand": ("Sand of Yuma", "rft2d_dynamic"),
    "twentynine_palms_sand": ("Sand of 29 Palms", "rft2d_dynamic"),
}
"""Title and default law of the media in `media.csv`, all but those of Li, Zhang and Goldman."""


def _rows(name: str) -> Iterator[dict[str, str]]:
    with Path(__file__).with_name(name).open(encoding="utf-8") as file:
        yield from csv.DictReader(file)


def _fourier(values: tuple[float, ...], which: str) -> dict[str, Quantity]:
    source = f"{_LI} S2: {which}"
    return {
        key: Quantity(value, "N/cm^3", source)
        for key, value in zip(FOURIER_KEYS, values, strict=True)
    }


def _register_published() -> None:
    """Register the media of `media.csv`, with a row for each constant; `rft2d` has the scale."""
    for name, (title, default_law) in _MEDIA.items():
        tables: dict[str, dict[str, Quantity]] = {}
        for row in _rows("media.csv"):
            if row["medium"] == name:
                quantity = Quantity(float(row["value"]), row["unit"], row["source"])
                generic = _fourier(GENERIC_FOURIER, "generic set") if row["law"] == "rft2d" else {}
                tables.setdefault(row["law"], generic)[row["constant"]] = quantity
        general = tables.pop("")  # density, and perhaps the size of grains
        register_medium(Medium(name, title, default_law=default_law, constants=tables, **general))


def _register_measured(row: dict[str, str]) -> None:
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
    register_medium(medium)


_register_published()
for _row in _rows("li_2013.csv"):
    _register_measured(_row)
