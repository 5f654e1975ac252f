"""Sand that is drawn anew at every reset."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mjgranular.envs.ground import Ground
from mjgranular.errors import InputError, UnknownNameError
from mjgranular.law import laws
from mjgranular.medium import media
from mjgranular.medium.medium import get_medium

SURFACES = ("plane", "dunes")
"""Surfaces that can be drawn: level but for the slope, or fixed dunes at a place drawn anew."""

STEEPEST = math.radians(34)
"""Greatest slope: beyond its angle of repose sand slides by itself; 34 degrees is that of Quikrete
medium sand (Agarwal, Goldman, Kamrin, PNAS 120 (2023), tangent of internal friction)."""

_STRONGEST = 100.0  # factor; chosen: far beyond any sand


@dataclass(frozen=True)
class SandRanges:
    """From where the sand of an episode is drawn: numbers evenly, names with equal chances.

    Attributes:
        strength: factor on static resistance, (low, high).
        density: factor on resistance by velocity, (low, high).
        slope: of the ground, uphill towards +x [rad], (low, high). Gravity is tilted and not the
            sand: heights and depths are along the surface's normal.
        media: names of media; empty for the environment's own.
        laws: names of laws; empty for the environment's own, or that of each medium.
        surfaces: out of `SURFACES`; empty for the environment's own.

    Raises:
        InputError: low above high, or what no sand can be; names the field.
        UnknownNameError: a medium, law or surface that does not exist; lists those that do.
    """

    strength: tuple[float, float] = (1.0, 1.0)
    density: tuple[float, float] = (1.0, 1.0)
    slope: tuple[float, float] = (0.0, 0.0)
    media: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()
    surfaces: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("strength", "density", "slope"):
            self._check_range(name)
        if not self.strength[0] > 0:
            raise InputError(f"SandRanges: strength must be positive, not {self.strength[0]}")
        if self.density[0] < 0:
            raise InputError(f"SandRanges: density must not be negative, not {self.density[0]}")
        for name in ("strength", "density"):
            if getattr(self, name)[1] > _STRONGEST:
                raise InputError(
                    f"SandRanges: {name} is a factor and at most {_STRONGEST:g}, "
                    f"not {getattr(self, name)[1]}"
                )
        if max(abs(self.slope[0]), abs(self.slope[1])) > STEEPEST:
            raise InputError(
                f"SandRanges: slope must be within {STEEPEST:.3f} rad (34 degrees, the angle of "
                f"repose) either way, not {self.slope}"
            )
        for name, kind, known in (
            ("media", "medium", media),
            ("laws", "law", laws),
            ("surfaces", "surface", SURFACES),
        ):
            names = getattr(self, name)
            if isinstance(names, str) or not isinstance(names, Sequence):
                raise InputError(f"SandRanges: {name} must be a tuple of names, not {names!r}")
            for given in names:
                if given not in known:
                    raise UnknownNameError(kind, given, known)

    def _check_range(self, name: str) -> None:
        given: Any = getattr(self, name)
        try:
            low, high = (float(value) for value in given)
        except (TypeError, ValueError):
            raise InputError(f"SandRanges: {name} must be (low, high), not {given!r}") from None
        if not (math.isfinite(low) and math.isfinite(high)):
            raise InputError(f"SandRanges: {name} must be finite, not {given}")
        if low > high:
            raise InputError(f"SandRanges: {name} has its low end above its high end: {given}")

    def check_within(self, other: SandRanges) -> None:
        """Makes sure that a curriculum draws no sand that the model has not got.

        Args:
            other: what the model was made for.

        Raises:
            InputError: a name that is not among the other's; names the field.
        """
        for field in fields(self):
            if field.name in ("media", "laws", "surfaces"):
                wanted, there = getattr(self, field.name), getattr(other, field.name)
                for name in wanted:
                    if name not in there:
                        raise InputError(
                            f"the curriculum's {field.name} have {name!r}, which randomise does "
                            f"not: it has {', '.join(there) or 'none'}"
                        )


@dataclass(frozen=True)
class Choice:
    """One of the sands in a model: names of medium, law and surface as they were asked for."""

    medium: str
    law: str
    surface: str


@dataclass(frozen=True)
class Sample:
    """The sand of one episode.

    Attributes:
        number: of the sand in the model that is switched on.
        strength: factor on static resistance.
        density: factor on resistance by velocity.
        slope: of the ground [rad].
    """

    number: int = 0
    strength: float = 1.0
    density: float = 1.0
    slope: float = 0.0


def draw(ranges: SandRanges, choices: Sequence[Choice], random: np.random.Generator) -> Sample:
    """Draws a sand.

    Args:
        ranges: from where.
        choices: the sands that the model has.
        random: where numbers come from; the same number of them at each call.
    """
    fitting = [
        number
        for number, choice in enumerate(choices)
        if (not ranges.media or choice.medium in ranges.media)
        and (not ranges.laws or choice.law in ranges.laws)
        and (not ranges.surfaces or choice.surface in ranges.surfaces)
    ]
    number = fitting[int(random.integers(len(fitting)))]
    numbers = [random.uniform(*getattr(ranges, key)) for key in ("strength", "density", "slope")]
    return Sample(number, *(float(value) for value in numbers))


def grounds_of(
    ranges: SandRanges | None, base: Ground, dunes: Any
) -> tuple[list[Ground], list[Choice]]:
    """The sands that a model needs for these ranges, and what each of them is.

    Args:
        ranges: from where sand is drawn; None for the one sand.
        base: what is not drawn.
        dunes: the surface that "dunes" stands for.
    """
    grounds, choices = [], []
    for medium in (ranges and ranges.media) or (base.medium,):
        for law in (ranges and ranges.laws) or (base.law,):
            for name in (ranges and ranges.surfaces) or ("plane",):
                surface = dunes if name == "dunes" else base.surface
                grounds.append(
                    Ground(medium, law, surface, base.scheme, base.resolution, base.geoms)
                )
                own = get_medium(medium).default_law if law is None else law
                choices.append(Choice(_name(medium), _name(own), name))
    return grounds, choices


def _name(thing: Any) -> str:
    return thing if isinstance(thing, str) else str(getattr(thing, "name", thing))
