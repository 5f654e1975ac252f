"""Warnings about values of an experiment that look like a wrong unit."""

from __future__ import annotations

from collections.abc import Mapping

from mjgranular.errors import RangeWarning, warn_user

# Chosen: larger heights and depths are rare in experiments, and 10 mm is the least that is common.
_LONGEST = 10.0  # heights and depths [m]
_FASTEST = 1000.0  # [m/s]; the laws were measured at some m/s
_DENSITIES = (10.0, 25000.0)  # of bodies [kg/m^3]: from foam to platinum


def warn_of_slips(
    *,
    lengths: Mapping[str, float | None] | None = None,
    speed: float = 0.0,
    density: float | None = None,
) -> None:
    """Warn about implausible lengths, speeds and densities.

    Args:
        lengths: values by what they describe [m]; None for one that was not given.
        speed: [m/s].
        density: density of the body [kg/m^3]; None if a model defines it.
    """
    messages = [
        f"{what} is {length:g} m: lengths are in meters, and {length:g} mm is {length / 1000:g} m"
        for what, length in (lengths or {}).items()
        if length is not None and abs(length) > _LONGEST
    ]
    if abs(speed) > _FASTEST:
        messages.append(
            f"the speed is {speed:g} m/s, far beyond the range that laws of sand are known for: "
            f"{speed:g} mm/s is {speed / 1000:g} m/s"
        )
    low, high = _DENSITIES
    if density is not None and not low <= density <= high:
        likely = "densities are in kg/m^3"
        if low <= 1000 * density <= high:
            likely = f"{density:g} g/cm^3 is {1000 * density:g} kg/m^3"
        messages.append(
            f"the body has a density of {density:g} kg/m^3, and solids have {low:g} to {high:g}: "
            f"{likely}"
        )
    for message in messages:
        warn_user(message, RangeWarning)
