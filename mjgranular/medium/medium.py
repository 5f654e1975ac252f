"""A medium: numbers, each with where it comes from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from mjgranular.errors import InputError, UnknownNameError
from mjgranular.registry import Registry

media: Registry[Medium] = Registry("medium")

# From snow to tungsten powder, from dust to gravel: what lies outside is a slip of units.
_DENSITIES = (10.0, 25000.0)
_GRAINS = (1e-6, 0.1)


@dataclass(frozen=True)
class Quantity:
    """A number with its unit and its source.

    Attributes:
        value: the number, SI.
        unit: its unit, "" for a pure number.
        source: publication and place in it, or "chosen, not measured".
    """

    value: float
    unit: str
    source: str


@dataclass(frozen=True)
class Medium:
    """A granular medium.

    Attributes:
        name: the name it is known by.
        title: what it is, in a few words.
        density: bulk density [kg/m^3].
        default_law: the law to use when none is asked for.
        constants: for each law by its name, that law's constants by their names.
        grain: diameter of a grain [m], None if it is not known.

    Raises:
        InputError: a density or grain size outside its range, a constant that is not finite, or a
            default law without constants.
    """

    name: str
    title: str
    density: Quantity
    default_law: str
    constants: Mapping[str, Mapping[str, Quantity]] = field(default_factory=dict)
    grain: Quantity | None = None

    def __post_init__(self) -> None:
        low, high = _DENSITIES
        if not (math.isfinite(self.density.value) and low <= self.density.value <= high):
            raise InputError(
                f"medium {self.name!r}: the bulk density must be from {low:g} to {high:g} kg/m^3, "
                f"not {self.density.value}"
            )
        low, high = _GRAINS
        if self.grain is not None and not low <= self.grain.value <= high:
            raise InputError(
                f"medium {self.name!r}: the grain size must be from {low:g} to {high:g} m, "
                f"not {self.grain.value}"
            )
        for law, constants in self.constants.items():
            for key, quantity in constants.items():
                if not math.isfinite(quantity.value):
                    raise InputError(
                        f"medium {self.name!r}: {law}.{key} must be finite, not {quantity.value}"
                    )
        if self.default_law not in self.constants:
            raise InputError(
                f"medium {self.name!r}: its default law {self.default_law!r} has no constants; "
                f"it has those of: {', '.join(sorted(self.constants)) or 'none'}"
            )

    def constants_for(self, law: str) -> dict[str, float]:
        """The values of this medium's constants for a law.

        Raises:
            UnknownNameError: the medium has no constants for that law; lists those it has.
        """
        try:
            constants = self.constants[law]
        except KeyError:
            raise UnknownNameError(
                f"constants in medium {self.name!r} for law", law, sorted(self.constants)
            ) from None
        return {key: quantity.value for key, quantity in constants.items()}


def register_medium(medium: Medium, *, replace: bool = False) -> Medium:
    """Makes a medium known by its name, everywhere a name of a medium is taken.

    Raises:
        InputError: another medium has that name and `replace` is false.
    """
    media.add(medium.name, medium, replace=replace)
    return medium


def get_medium(medium: str | Path | Medium) -> Medium:
    """The medium of that name, or `medium` itself if it is one.

    A path, or a name that ends in .yaml or .yml, is that of a file (`medium.file`).

    Raises:
        UnknownNameError: no such name; lists those that exist.
        InputError: a file that does not describe a medium.
    """
    if isinstance(medium, Medium):
        return medium
    if isinstance(medium, Path) or str(medium).endswith((".yaml", ".yml")):
        from mjgranular.medium.file import read_medium

        return read_medium(Path(medium))
    return media[medium]
