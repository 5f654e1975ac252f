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
        chosen, step = Implicit(), model.opt.timestep
        reason = f"at steps of {step:g} s it holds still what the sand can hold"
        if adds_mass:
            reason = "the law moves sand along, which the explicit scheme cannot"
        elif step <= FINE_STEP:
            chosen = Explicit(longest_step=FINE_STEP)
            reason = (
                f"the time step of {step:g} s is fine enough for forces as they come, which are "
                "of second order"
            )
        elif elements > MANY_ELEMENTS and step <= _FINE_OF_MANY:
            chosen = Explicit(longest_step=_FINE_OF_MANY)
            reason = f"{elements} elements are many, and {step:g} s is a fine step"
        _logger.info("scheme %s: %s", chosen.name, reason)
        return chosen


schemes.add(Auto.name, Auto)
