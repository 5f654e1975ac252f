"""A medium: numbers, each with where it comes from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from mjgranular.errors import InputError, UnknownNameError
from mjgranular.registry import Registry

media: Registry[Medium] = Registry("medium")


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
        constants: for each law by its name, that law's constants by their names.
        default_law: the law to use when none is asked for.

    Raises:
        InputError: a density that is not positive, a constant that is not finite, or a default law
            without constants.
    """

    name: str
    title: str
    density: Quantity
    default_law: str
    constants: Mapping[str, Mapping[str, Quantity]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.density.value) and self.density.value > 0):
            raise InputError(
                f"medium {self.name!r}: the bulk density must be positive [kg/m^3], "
                f"not {self.density.value}"
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


def get_medium(medium: str | Medium) -> Medium:
    """The medium of that name, or `medium` itself if it is one.

    Raises:
        UnknownNameError: no such name; lists those that exist.
    """
    return medium if isinstance(medium, Medium) else media[medium]
