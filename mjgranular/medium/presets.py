"""The media that come with the package."""

import csv
from pathlib import Path

from mjgranular.medium.file import register_medium
from mjgranular.medium.medium import Medium, Quantity

FOURIER_KEYS = ("A00", "A10", "B11", "B01", "Bm11", "C11", "C01", "Cm11", "D10")
GENERIC_FOURIER = (0.206, 0.169, 0.212, 0.358, 0.055, -0.124, 0.253, 0.007, 0.088)
_GENERIC_SOURCE = (
    "Li, Zhang, Goldman, Science 339, 1408 (2013), supplementary table S2: generic set"
)

_MEDIA = {
    # The paper's coefficients assume the density of quartz grains, not of a bed of them.
    "play_sand": ("Play sand (Quikrete 1113-51)", "link"),
    "quikrete_medium": ("Quikrete medium sand", "rft3d_dynamic"),
    "glass_beads": ("Glass beads, 250 to 350 um", "rft2d_dynamic"),
    "yuma_sand": ("Sand of Yuma", "rft2d_dynamic"),
    "twentynine_palms_sand": ("Sand of 29 Palms", "rft2d_dynamic"),
    # Li, Zhang and Goldman 2013. Their tables give 2500 to 2600 kg/m^3 for grains of glass: the
    # mean is used. The default law is the one that was validated for fast motion
    # (docs/validity.md), not the table for plates. With the measured alpha_z of a level plate
    # pushed straight down, where the Fourier series is 5 to 28 % softer, `scale` of `rft3d` is
    # alpha_z / (LEVEL_PLATE density 9.81 FRICTION_CUBIC(internal_friction)) (`law.rft3d`).
    "poppy_seed_loose": ("Poppy seed, loosely packed", "rft3d_dynamic"),
    "poppy_seed_close": ("Poppy seed, closely packed", "rft3d_dynamic"),
    "glass_beads_loose": ("Glass beads of 0.3 mm, loosely packed", "rft3d_dynamic"),
    "glass_beads_close": ("Glass beads of 0.3 mm, closely packed", "rft3d_dynamic"),
    "glass_beads_3mm_close": ("Glass beads of 3 mm, closely packed", "rft3d_dynamic"),
}
"""Title and default law of the media in `media.csv`, which has a row for each constant."""


def _register() -> None:
    """Register all media; `rft2d` has the generic set where a medium has only a scale of it."""
    with Path(__file__).with_name("media.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for name, (title, default_law) in _MEDIA.items():
        tables: dict[str, dict[str, Quantity]] = {}
        for row in rows:
            if row["medium"] == name:
                quantity = Quantity(float(row["value"]), row["unit"], row["source"])
                tables.setdefault(row["law"], {})[row["constant"]] = quantity
        general = tables.pop("")  # density, and perhaps the size of grains
        if "scale" in tables.get("rft2d", {}):
            both = zip(FOURIER_KEYS, GENERIC_FOURIER, strict=True)
            generic = {key: Quantity(value, "N/cm^3", _GENERIC_SOURCE) for key, value in both}
            tables["rft2d"] = generic | tables["rft2d"]
        register_medium(Medium(name, title, default_law=default_law, constants=tables, **general))


_register()
