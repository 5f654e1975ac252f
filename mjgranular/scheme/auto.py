"""Automatic choice of the scheme."""

import logging
from dataclasses import dataclass
from typing import ClassVar

import mujoco

from mjgranular.scheme.explicit import Explicit
from mjgranular.scheme.implicit import Implicit
from mjgranular.scheme.scheme import Scheme, SchemeChoice, schemes

_logger = logging.getLogger(__name__)

# Both chosen. Below this step the paper's link creeps by less than 0.5 mm/s with the explicit
# scheme, which is of second order there (docs/scheme.md). Above this number of elements a step of
# the implicit scheme takes milliseconds.
FINE_STEP = 2e-5  # [s]
MANY_ELEMENTS = 5000
_FINE_OF_MANY = 1e-4  # [s]


def choose_scheme(timestep: float, elements: int, adds_mass: bool) -> tuple[Scheme, str]:
    """Choose the scheme for a time step [s], a number of elements and a law; also return why."""
    if adds_mass:
        return Implicit(), "the law moves sand along, which the explicit scheme cannot"
    if timestep <= FINE_STEP:
        return Explicit(longest_step=FINE_STEP), (
            f"the time step of {timestep:g} s is fine enough for forces as they come, which "
            "are of second order"
        )
    if elements > MANY_ELEMENTS and timestep <= _FINE_OF_MANY:
        return Explicit(longest_step=_FINE_OF_MANY), (
            f"{elements} elements are many, and {timestep:g} s is a fine step"
        )
    return Implicit(), f"at steps of {timestep:g} s it holds still what the sand can hold"


@dataclass(frozen=True)
class Auto(SchemeChoice):
    """`Implicit`, unless the time step is small or the elements are many: then `Explicit`.

    Laws with added mass, as those for fast motion, always use `Implicit`.
    """

    name: ClassVar[str] = "auto"
    title: ClassVar[str] = "implicit, or explicit for fine steps and very many elements"

    def scheme_for(
        self, model: mujoco.MjModel, elements: int, *, adds_mass: bool = False
    ) -> Scheme:
        chosen, reason = choose_scheme(model.opt.timestep, elements, adds_mass)
        _logger.info("scheme %s: %s", chosen.name, reason)
        return chosen


schemes.add(Auto.name, Auto)
