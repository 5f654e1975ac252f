"""Warnings of values of an experiment that look like a wrong unit."""

from __future__ import annotations

from mjgranular.errors import RangeWarning, warn_user

_LONGEST = 10.0
"""Heights and depths [m]. Chosen: what falls farther is seldom dropped onto sand by hand or by a
robot, and 10 mm are the least that anybody asks for."""

_FASTEST = 1000.0
"""[m/s]. Chosen: the laws were measured at some m/s; a bullet has 1000."""

_DENSITIES = (10.0, 25000.0)
"""Of what falls [kg/m^3]: from foam to platinum. In g/cm^3 it is 0.01 to 25."""


def warn_of_slips(
    *,
    lengths: dict[str, float | None] | None = None,
    speed: float = 0.0,
    density: float | None = None,
) -> None:
    """Warns of lengths, speeds and densities that nobody drops onto sand.

    Args:
        lengths: by what they are of [m]; None for one that was not given.
        speed: [m/s].
        density: of what falls [kg/m^3]; None where a model says it.
    """
    for what, length in (lengths or {}).items():
        if length is not None and abs(length) > _LONGEST:
            warn_user(
                f"{what} is {length:g} m: lengths are in metres, and {length:g} mm is "
                f"{length / 1000:g} m",
                RangeWarning,
            )
    if abs(speed) > _FASTEST:
        warn_user(
            f"the speed is {speed:g} m/s, far beyond what laws of sand are known for: {speed:g} "
            f"mm/s is {speed / 1000:g} m/s",
            RangeWarning,
        )
    low, high = _DENSITIES
    if density is not None and not low <= density <= high:
        likely = (
            f"{density:g} g/cm^3 is {1000 * density:g} kg/m^3"
            if low <= 1000 * density <= high
            else "densities are in kg/m^3"
        )
        warn_user(
            f"what falls has a density of {density:g} kg/m^3, and solids have {low:g} to {high:g}: "
            f"{likely}",
            RangeWarning,
        )
