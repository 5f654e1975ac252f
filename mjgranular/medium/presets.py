"""The media that come with the package."""

from __future__ import annotations

from mjgranular.medium.medium import Medium, Quantity, register_medium

_LINK_PAPER = (
    "Lee and Marghitu, Stopping Time for a Planar Link in Contact with a Granular Material"
)

play_sand = register_medium(
    Medium(
        name="play_sand",
        title="Play sand (Quikrete 1113-51)",
        density=Quantity(2500.0, "kg/m^3", f"{_LINK_PAPER}, section 4"),
        default_law="link",
        constants={
            "link": {
                "eta_d": Quantity(6.5, "", f"{_LINK_PAPER}, section 4: dynamic frictional force"),
                "eta_h": Quantity(8.0, "", f"{_LINK_PAPER}, section 4: horizontal static force"),
                "eta_v": Quantity(22.0, "", f"{_LINK_PAPER}, section 4: vertical static force"),
                "exponent": Quantity(1.1, "", f"{_LINK_PAPER}, section 4: lambda"),
            }
        },
    )
)
"""The sand of the paper. Its density is the value the paper uses, that of quartz grains rather than
of a bed with air between them; the coefficients belong to it, so it is kept."""
