"""Schemes by name, and their automatic choice."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco

from mjgranular._util.parse import Registry, read_part
from mjgranular.scheme.explicit import Explicit
from mjgranular.scheme.implicit import Implicit
from mjgranular.scheme.scheme import Scheme, SchemeChoice

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

    def scheme_for(self, model: mujoco.MjModel, elements: int, adds_mass: bool) -> Scheme:
        step, limit = model.opt.timestep, FINE_STEP
        if elements > MANY_ELEMENTS and step > FINE_STEP:
            limit = _FINE_OF_MANY
        fine = step <= limit and not adds_mass
        return Explicit(longest_step=limit) if fine else Implicit()


schemes: Registry[type[SchemeChoice]] = Registry("scheme")
"""Scheme classes by name."""

for _kind in (Explicit, Implicit, Auto):
    schemes.add(_kind.name, _kind)


def get_scheme(scheme: str | SchemeChoice) -> SchemeChoice:
    """Return the scheme of that name, or `scheme` itself.

    A name may be followed by options, such as "implicit evaluations=9"; others keep their defaults.

    Raises:
        UnknownNameError: no such scheme; lists the existing ones.
        InputError: the scheme does not have that option, or its value has a wrong type.
    """
    if isinstance(scheme, SchemeChoice):
        return scheme
    if not isinstance(scheme, str) or not scheme.strip():
        return schemes[scheme]()
    cls, given = read_part(scheme, schemes, "scheme")
    return cls(**given)
