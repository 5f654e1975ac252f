"""Constants of a law that can be free, derived from the law itself.

No law is hard-coded here. A law's free constants are its numeric fields, the bulk density if the
law's record depends on it, and `strength`, the factor on static resistance that `engine.tune` finds
by `Law.strength_keys`. Bounds are what its constructor accepts.
"""

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self, get_type_hints

import numpy as np

from mjgranular._util.checks import check_name
from mjgranular.errors import GranularError, InputError
from mjgranular.law import Law, get_law, law_in
from mjgranular.medium import Medium

STRENGTH = "strength"
DENSITY = "density"

_LARGEST = 1e9  # times the start: a value that a law accepts here it accepts anywhere
_BISECTIONS = 100


def numbers_of(kind: type[Law], types: tuple[type, ...] = (float, int)) -> tuple[str, ...]:
    """Return the names of the fields of a law that are numbers of some types."""
    hints = get_type_hints(kind)
    every = fields(kind)  # pyright: ignore[reportArgumentType]
    return tuple(field.name for field in every if hints[field.name] in types)


@dataclass(frozen=True)
class Material:
    """A law, its medium, and a factor on its static resistance.

    `given` has the names of the constants that were given; the others are the law's defaults.
    """

    law: Law
    medium: Medium
    given: frozenset[str] = frozenset()

    @classmethod
    def of(cls, medium: Medium, law: str | Law | None) -> Self:
        """Return the law with the medium's constants; `law` as `Sand` takes it."""
        made = get_law(law, medium)
        names = {field.name for field in fields(made)}  # pyright: ignore[reportArgumentType]
        if isinstance(law, Law):
            return cls(made, medium, frozenset(names))
        key = medium.key_for(made.name)
        tables = list(medium.constants.values()) if key is None else [medium.constants[key]]
        given = {key for table in tables for key in table if key in names}
        if isinstance(law, str):
            given |= law_in(law)[1].keys()
        return cls(made, medium, frozenset(given))

    @cached_property
    def _stronger(self) -> tuple[str, ...]:
        """The fields that a factor on static resistance multiplies; may be empty."""
        keys = type(self.law).strength_keys
        names = tuple(key for key in keys if key in self._numbers)
        if keys and not names and "scale" in self._numbers:
            names = ("scale",)  # the record's stiffness is proportional to it
        return names if any(getattr(self.law, name) for name in names) else ()

    @cached_property
    def _numbers(self) -> tuple[str, ...]:
        return numbers_of(type(self.law), (float,))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the constants that can be free."""
        found = [STRENGTH] if self._stronger else []
        found += self._numbers
        if DENSITY not in found and self._accepts(DENSITY, 1.01 * self.medium.density.value):
            denser = self.changed({DENSITY: 1.01 * self.medium.density.value})
            plain = self.law.parameters(self.medium)
            if denser.law.parameters(denser.medium).tobytes() != plain.tobytes():
                found.append(DENSITY)
        return tuple(found)

    def value(self, name: str) -> float:
        """Return the value of a constant; that of strength is 1."""
        if name == STRENGTH:
            return 1.0
        if name == DENSITY and DENSITY not in self._numbers:
            return self.medium.density.value
        return float(getattr(self.law, name))

    def changed(self, values: dict[str, float]) -> Self:
        """Return the material with other values of some constants; strength is a factor on it."""
        own: Any = {name: value for name, value in values.items() if name in self._numbers}
        law = replace(self.law, **own) if own else self.law  # pyright: ignore
        factor = values.get(STRENGTH, 1.0)
        if factor != 1.0:
            stronger: Any = {name: factor * getattr(law, name) for name in self._stronger}
            law = replace(law, **stronger)  # pyright: ignore
        medium = self.medium
        if DENSITY in values:
            medium = replace(medium, density=replace(medium.density, value=values[DENSITY]))
        return replace(self, law=law, medium=medium)

    def by_speed(self, name: str) -> bool:
        """Return True if, by the law, a constant affects only rate-dependent resistance."""
        value = self.value(name)
        for other in (1.01 * value, 0.99 * value) if value else (1.0,):
            if self._accepts(name, other):
                made = self.changed({name: other})
                plain, now = (m.law.parameters(m.medium) for m in (self, made))
                touched = {k for k in plain.dtype.names or () if np.any(plain[k] != now[k])}
                return bool(touched) and touched <= {*type(self.law).density_keys, "added"}
        return False

    def check_free(self, names: tuple[str, ...]) -> None:
        if not names:
            raise InputError(f"no constant is free; {self.law.name!r} has {', '.join(self.names)}")
        for name in names:
            check_name(f"free constant of {self.law.name}", name, self.names)
            if names.count(name) > 1:
                raise InputError(f"{name} is named twice among the free constants")
        if STRENGTH in names:
            both = [name for name in self._stronger if name in names]
            if both:
                raise InputError(
                    f"strength is a factor on {', '.join(self._stronger)}: fit one of strength "
                    f"and {both[0]}, not both"
                )
        for name in names:
            self.has_start(name)

    def has_start(self, name: str) -> bool:
        """Return True if a fit can start from the current value: not from a default on a bound.

        A given value that lies on a bound is an error.
        """
        value, (low, high) = self.value(name), self.bounds(name)
        if low < value < high and value != 0:
            return True
        if name in self.given:
            accepted = f"from {low:g} on" if math.isinf(high) else f"{low:g} to {high:g}"
            raise InputError(
                f"{name} starts at {value:g}, on a bound ({accepted}): give a start inside, or none"
            )
        return False

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the range of values that the law accepts; infinite without a limit."""
        value = self.value(name)
        size = abs(value) or 1.0
        return self._end(name, value, -size), self._end(name, value, size)

    def _end(self, name: str, value: float, way: float) -> float:
        """Return the bound in the direction of `way`, by bisection."""
        if self._accepts(name, value + way * _LARGEST):
            return math.copysign(math.inf, way)
        if way < 0 < value and self._accepts(name, 0.0) and not self._accepts(name, -1e-9 * value):
            return 0.0
        inside, outside = 0.0, abs(way) * _LARGEST
        for _ in range(_BISECTIONS):
            middle = (inside + outside) / 2
            if self._accepts(name, value + math.copysign(middle, way)):
                inside = middle
            else:
                outside = middle
        end = value + math.copysign(inside, way)
        return float(f"{end:.9g}") if self._accepts(name, float(f"{end:.9g}")) else end

    def _accepts(self, name: str, value: float) -> bool:
        try:
            made = self.changed({name: value})
            made.law.parameters(made.medium)
        except (GranularError, ArithmeticError):
            return False
        return True

    def constants(self) -> dict[str, float]:
        """Return the law's constants that a medium must have: all but defaults."""
        defaults = {f.name: f.default for f in fields(self.law)}  # pyright: ignore[reportArgumentType]
        return {
            name: float(getattr(self.law, name))
            for name, default in defaults.items()
            if (name in self._numbers or isinstance(default, bool))
            and (name in self.given or getattr(self.law, name) != default)  # MISSING equals none
        }
