"""Sand that is sampled at every reset."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, Self

import mujoco
import numpy as np

from mjgranular._util.checks import check_kind, check_name, kind_of
from mjgranular.engine import tune
from mjgranular.envs.figures import Figures
from mjgranular.errors import InputError, UnknownNameError
from mjgranular.law import law_in
from mjgranular.medium import Medium, get_medium
from mjgranular.relief.memory import as_memory
from mjgranular.sand.spec import SandSpec, combined, medium_for
from mjgranular.surface import surface_of

SURFACES = ("plane", "dunes")
"""Surfaces that can be sampled: level apart from the slope, or fixed dunes at a random position."""

STEEPEST = math.radians(34)
"""Steepest slope: beyond its angle of repose sand slides by itself; 34 degrees is that of Quikrete
medium sand (Agarwal, Goldman, Kamrin, PNAS 120 (2023), tangent of internal friction)."""

_DRAWN = ("strength", "density", "slope")
_NAMED = ("media", "laws", "surfaces")
_STRONGEST = 100.0  # factor; chosen: far beyond any sand


@dataclass(frozen=True)
class SandRanges:
    """Ranges from which the sand of an episode is sampled, uniformly.

    Attributes:
        strength: factor on static resistance, (low, high).
        density: factor on rate-dependent resistance, (low, high).
        slope: slope of the ground, uphill toward +x [rad], (low, high). Gravity is tilted, not the
            sand: heights and depths are along the surface's normal.
        media: names of media, or paths of YAML files; empty for the environment's default.
        laws: names of laws, with parameters if any; empty for the default, or that of each medium.
        surfaces: names from `SURFACES`; empty for the environment's default.

    Raises:
        InputError: low above high, or impossible values; names the field.
        UnknownNameError: a medium, law or surface that does not exist; lists those that do.
    """

    strength: tuple[float, float] = (1.0, 1.0)
    density: tuple[float, float] = (1.0, 1.0)
    slope: tuple[float, float] = (0.0, 0.0)
    media: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()
    surfaces: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in _DRAWN:
            object.__setattr__(self, name, _finite_range(name, getattr(self, name)))
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
        for name in _NAMED:
            names = getattr(self, name)
            if isinstance(names, str) or not isinstance(names, Sequence):
                raise InputError(f"SandRanges: {name} must be a tuple of names, not {names!r}")
            object.__setattr__(self, name, tuple(_checked_name(name, given) for given in names))

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> Self:
        """Return ranges from a table by the names of the fields, as in TOML or YAML."""
        for name in table:
            check_name("range of randomise", name, (*_DRAWN, *_NAMED))
        return cls(**table)

    @staticmethod
    def of_reset(ranges: "SandRanges | None", options: Any) -> "SandRanges | None":
        """Return the ranges of one episode from options of a reset; one value or name is fixed."""
        if not isinstance(options, Mapping | None):
            raise InputError(f"options of reset must be a dict by name, not {kind_of(options)}")
        if not options:
            return ranges
        for name in options:
            check_name("option of reset", name, (*_DRAWN, *_NAMED))
        if ranges is None:
            raise InputError(
                f"reset: {', '.join(options)} can be set if the environment is made with "
                "randomise={...}, for example randomise={}"
            )
        given = dict(options)
        for name, value in options.items():
            if isinstance(value, Real):
                given[name] = (value, value)
            elif isinstance(value, str):
                given[name] = (value,)
        wanted = replace(ranges, **given)
        wanted.check_within(ranges, "reset")
        return wanted

    def check_within(self, other: "SandRanges", origin: str) -> None:
        """Check that a curriculum or a reset names only sand that the model has."""
        for key in _NAMED:
            there = getattr(other, key)
            for name in getattr(self, key):
                if name not in there:
                    raise InputError(
                        f"{key} of {origin} have {name!r}, which randomise does not: it has "
                        f"{', '.join(there) or 'none'}"
                    )

    def draw(
        self, choices: Sequence["Choice"], random: np.random.Generator, *, span: float = 0.0
    ) -> "Sample":
        """Sample a sand; every call draws the same number of values.

        `choices` are the sands of the model; on dunes robots start at x from -`span` to `span` [m].
        """
        fitting = [
            number
            for number, choice in enumerate(choices)
            if (not self.media or choice.medium in self.media)
            and (not self.laws or choice.law in self.laws)
            and (not self.surfaces or choice.surface in self.surfaces)
        ]
        number = fitting[int(random.integers(len(fitting)))]
        numbers = {key: float(random.uniform(*getattr(self, key))) for key in _DRAWN}
        place = float(random.uniform(-span, span))
        return Sample(number, **numbers, place=place if choices[number].surface == "dunes" else 0.0)

    def in_episode(
        self, curriculum: Callable[[int], "SandRanges"] | None, episode: int
    ) -> "SandRanges":
        """Return the ranges for an episode: from the curriculum, or unchanged."""
        if curriculum is None:
            return self
        given = curriculum(episode)
        if not isinstance(given, SandRanges):
            raise InputError(f"the curriculum must give a SandRanges, not {given!r}")
        given.check_within(self, "the curriculum")
        for name in _DRAWN:
            (low, high), (least, most) = getattr(given, name), getattr(self, name)
            if low < least or high > most:
                raise InputError(
                    f"{name} of the curriculum must be within that of randomise, {(least, most)}, "
                    f"not {(low, high)}"
                )
        return given


def _checked_name(key: str, given: Any) -> str:
    """Return the name of a medium, law or surface that exists."""
    if isinstance(given, Medium):
        raise InputError(f"SandRanges: media must be names, got the medium {given.name!r}")
    if key == "media":
        get_medium(given)
        return str(given)
    if key == "laws":
        law_in(given)
    elif given not in SURFACES:
        raise UnknownNameError("surface", given, SURFACES)
    return given


def _finite_range(name: str, given: Any) -> tuple[float, float]:
    try:
        low, high = (float(value) for value in given)
    except (TypeError, ValueError):
        raise InputError(f"SandRanges: {name} must be (low, high), not {given!r}") from None
    if not (math.isfinite(low) and math.isfinite(high)):
        raise InputError(f"SandRanges: {name} must be finite, not {given}")
    if low > high:
        raise InputError(f"SandRanges: {name} has its low end above its high end: {given}")
    return low, high


def ranges_of(ranges: Any, curriculum: Any, memory: Any) -> SandRanges | None:
    """Return the ranges of an environment, and check its curriculum.

    Empty ranges are None for sand with memory, which is never drawn.
    """
    if isinstance(ranges, Mapping):
        ranges = SandRanges.of(ranges)
    if ranges is not None:
        check_kind(ranges, SandRanges, "randomise", "SandRanges(strength=(0.5, 2), ...)")
    if curriculum is not None and not callable(curriculum):
        raise InputError(
            "a curriculum is a function of the number of the episode that gives a SandRanges, not "
            f"{kind_of(curriculum)}"
        )
    if curriculum is not None and ranges is None:
        raise InputError(
            "a curriculum needs randomise=SandRanges(...), which names all media, laws and "
            "surfaces that it may draw"
        )
    if ranges is not None and as_memory(memory) is not None:
        if curriculum is not None or ranges != SandRanges():
            raise InputError("sand with memory cannot be drawn at random: use randomise={}")
        return None
    return ranges


@dataclass(frozen=True)
class Choice:
    """One of the sands in a model: requested names of medium, law and surface; the sand."""

    medium: str
    law: str
    surface: str
    sand: SandSpec


@dataclass(frozen=True)
class Sample:
    """The sand of one episode."""

    active: int = 0  # index of the active sand in the model
    strength: float = 1.0  # factor on static resistance
    density: float = 1.0  # factor on rate-dependent resistance
    slope: float = 0.0  # slope of the ground [rad]
    place: float = 0.0  # x at which the robot starts [m]; 0 without dunes

    def lay(
        self, model: mujoco.MjModel, figures: Figures, plugin_state: np.ndarray, gravity: np.ndarray
    ) -> None:
        """Apply it to a simulation: write to its plugin state and its gravity."""
        factors = {"strength": self.strength, "density": self.density}
        for number, name in enumerate(figures.sands):
            tune(model, plugin_state, name, active=float(number == self.active), **factors)
        (x, y, z), sine, cosine = figures.gravity, math.sin(self.slope), math.cos(self.slope)
        gravity[:] = x * cosine + z * sine, y, z * cosine - x * sine


def sampled_info(choices: Sequence[Choice], state: Any) -> dict[str, np.ndarray]:
    """Return the entries of `info` on the sampled sand of the simulations of a state."""
    info = {f"sand/{name}": getattr(state, name).copy() for name in _DRAWN}
    for key in ("medium", "law", "surface"):
        names = [getattr(choice, key) for choice in choices]
        info[f"sand/{key}"] = np.array(names, object)[state.active]
    return info


def choices_of(ranges: SandRanges | None, base: SandSpec, dunes: Any) -> list[Choice]:
    """Return the sands that a model needs for these ranges.

    A `base` on the dunes themselves has these without ranges too.
    """
    choices = []
    on_dunes = base.surface is not None and surface_of(base.surface) == dunes
    usual, plane = ("dunes", None) if on_dunes else ("plane", base.surface)
    for medium in (ranges and ranges.media) or (base.medium,):
        for law in (ranges and ranges.laws) or (base.law,):
            for name in (ranges and ranges.surfaces) or (usual,):
                surface = dunes if name == "dunes" else plane
                sand = combined(base, {"medium": medium, "law": law, "surface": surface})
                in_medium, own = medium, law
                if medium is None and law is not None:
                    in_medium = medium_for(law)
                if law is None and medium is not None:
                    own = get_medium(medium).default_law
                choices.append(Choice(_name(in_medium), _name(own), name, sand))
    return choices


def _name(thing: Any) -> str:
    """Return the name of a medium or a law in `info`; None is the default."""
    if thing is None:
        return "default"
    return thing if isinstance(thing, str) else str(getattr(thing, "name", thing))
