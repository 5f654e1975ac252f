"""A medium: numbers with their sources."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mjgranular._util.checks import kind_of
from mjgranular.errors import InputError, UnknownNameError, listed, one_line, shown

# From snow to tungsten powder, from dust to gravel: a value outside has a wrong unit.
DENSITIES = (10.0, 25000.0)
_GRAINS = (1e-6, 0.1)

DYNAMIC = "_dynamic"
"""Suffix of the names of laws for fast motion: for `rft3d` there is `rft3d_dynamic`."""


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

    def __post_init__(self) -> None:
        value = self.value
        if not isinstance(value, (int, float, np.number)) or isinstance(value, bool):
            raise InputError(f"a quantity's value is a number, not {shown(self.value)}")


@dataclass(frozen=True)
class Medium:
    """A granular medium.

    Attributes:
        name: the registered name.
        title: what it is, in a few words.
        density: bulk density [kg/m^3].
        default_law: the law to use when none is given.
        constants: for each law's name, its constants by their names.
        grain: diameter of a grain [m], None if unknown.

    Raises:
        InputError: a number is out of its range, or the default law has no constants.
    """

    name: str
    title: str
    density: Quantity
    default_law: str
    constants: Mapping[str, Mapping[str, Quantity]] = field(default_factory=dict)
    grain: Quantity | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise InputError(f"a medium has a name such as 'my_sand', not {kind_of(self.name)}")
        medium = f"medium {shown(self.name)}"
        tables = [self.constants, *getattr(self.constants, "values", tuple)()]
        if not all(isinstance(table, Mapping) for table in tables):
            raise InputError(
                f"{medium}: constants are a table of laws, {{'rft3d': {{name: Quantity(...)}}}}, "
                f"not {shown(self.constants)}"
            )
        numbers: list[tuple[str, Any, tuple[float, float] | None, str]]
        numbers = [("the bulk density", self.density, DENSITIES, "kg/m^3")]
        if self.grain is not None:
            numbers.append(("the grain size", self.grain, _GRAINS, "m"))
        for law, constants in self.constants.items():
            numbers += [(f"{law}.{key}", one, None, "") for key, one in constants.items()]
        for what, one, limits, unit in numbers:
            if not isinstance(one, Quantity):
                raise InputError(
                    f"{medium}: {what} is a Quantity(value, unit, source), not {kind_of(one)}"
                )
            low, high = limits or (-math.inf, math.inf)
            if not (math.isfinite(one.value) and low <= one.value <= high):
                rule = f"from {low:g} to {high:g} {unit}" if limits else "finite"
                raise InputError(f"{medium}: {what} must be {rule}, not {one.value}")
        if self.key_for(self.default_law) is None:
            raise InputError(
                f"{medium}: its default law {shown(self.default_law)} has no constants; "
                f"it has those of: {listed(sorted(self.constants))}"
            )

    def __repr__(self) -> str:
        """Return a short form; `mjgranular list media NAME` has the numbers."""
        return (
            f"Medium({shown(self.name)}: {one_line(self.title)}, {self.density.value:g} kg/m^3, "
            f"laws {listed(self.laws)})"
        )

    @property
    def laws(self) -> tuple[str, ...]:
        """The default law, and others that it has constants for."""
        others = (law for law in self.constants if law != self.default_law)
        return (self.default_law, *others)

    def key_for(self, law: str) -> str | None:
        """Return the name of the law whose constants in this medium serve a law; None if none do.

        Constants of a quasi-static law serve that for fast motion, whose name has the suffix
        `DYNAMIC`, if it has no constants itself.
        """
        slow = law.removesuffix(DYNAMIC) if isinstance(law, str) else law
        return next((name for name in (law, slow) if name in self.constants), None)

    def constants_for(self, law: str) -> dict[str, float]:
        """Return the values of this medium's constants for a law, found by `key_for`.

        Raises:
            UnknownNameError: the medium has no constants for that law; lists those it has.
        """
        key = self.key_for(law)
        if key is None:
            raise UnknownNameError(
                f"constants in medium {shown(self.name)} for law",
                law,
                sorted(self.constants),
                "mjgranular list laws NAME shows the media that have them; or give all its options",
            )
        return {name: quantity.value for name, quantity in self.constants[key].items()}
