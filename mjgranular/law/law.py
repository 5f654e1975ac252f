"""The interface of laws, and their register."""

from __future__ import annotations

import difflib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import MISSING, fields
from typing import Any, ClassVar, Self, TypeVar

import mujoco
import numpy as np

from mjgranular._util.checks import is_finite, kind_of
from mjgranular._util.parse import read_part
from mjgranular._util.registry import Registry
from mjgranular.errors import InputError, UnknownNameError, shown, warn_user
from mjgranular.law.kernel import LawKernel
from mjgranular.law.validity import Finding, Limit, findings_of
from mjgranular.medium import Medium, get_medium
from mjgranular.surface import Surface

laws: Registry[type[Law]] = Registry("law")
"""Classes of laws by their names."""


class Law(ABC):
    """Resistance of sand. A final law is a frozen dataclass of its parameters.

    Three things pass through a law once, when it is bound to a model, and never again: the geoms
    become the law's elements, its parameters and the surface become one record, and its kernel is
    chosen. What runs at every step is the kernel alone.

    Attributes:
        name: the name it is known by.
        title: one line for lists.
        citation: where it was published.
        validity: limits within which it holds; `Sand.report` says how a body stands against them.
        strength_keys: fields of its record that the static resistance is proportional to.
        density_keys: fields that resistance by velocity is proportional to, as a medium's density
            makes it. Both are what tunable sand scales (`engine.tuning`).
    """

    name: ClassVar[str]
    title: ClassVar[str]
    citation: ClassVar[str]
    validity: ClassVar[tuple[Limit, ...]] = ()
    strength_keys: ClassVar[tuple[str, ...]] = ()
    density_keys: ClassVar[tuple[str, ...]] = ()

    @property
    def adds_mass(self) -> bool:
        """Whether sand is moved along (`LawKernel.added`), which needs the implicit scheme."""
        return False

    @classmethod
    def from_medium(cls, medium: Medium | str) -> Self:
        """The law with the published constants of a medium, or of that of a name.

        Raises:
            UnknownNameError: the medium has none for this law.
        """
        return cls(**constants_of(cls, medium))

    @abstractmethod
    def elements(
        self, model: mujoco.MjModel, geoms: Sequence[int], resolution: int | None = None
    ) -> np.ndarray:
        """The elements that the law acts on.

        Args:
            model: the model.
            geoms: ids of the geoms that meet the sand.
            resolution: how finely they are cut, in the law's own measure; None for its default.

        Returns:
            A structured array, body by body, with fields `geom`, `body`, `slot` (the row of the
            body among those in the sand) and `width` (for Froude numbers [m]).

        Raises:
            InputError: geoms that the law has no elements for.
        """

    def parameters(self, medium: Medium) -> np.ndarray:
        """Parameters of law and medium as the kernel reads them: structured, shape (1,).

        These are the law's fields, as numbers, unless it says otherwise.

        Raises:
            InputError: a field that is no finite number.
        """
        names = [field.name for field in fields(self)]  # pyright: ignore[reportArgumentType]
        parameters = np.zeros(1, np.dtype([(name, np.float64) for name in names]))
        for name in names:
            value = getattr(self, name)
            if not is_finite(value):
                raise InputError(
                    f"{type(self).__name__}: {name} must be a finite number, not {shown(value)}"
                )
            parameters[name] = value
        return parameters

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Errors that were found against measured motion; none for a law that nobody compared."""
        return findings_of(self.name)

    @abstractmethod
    def kernel(self, surface: Surface) -> LawKernel:
        """The compiled law under that kind of surface (see `law.kernel`).

        Its `law` is the record made by `parameters`, its `surface` that of the surface.
        """

    def kernel_of_forces(self, surface: Surface) -> LawKernel:
        """Kernels that are asked for forces alone, and not for derivatives (`warp`).

        The same unless a law has shorter ones.
        """
        return self.kernel(surface)


LawClass = TypeVar("LawClass", bound=type[Law])


def register_law(law: LawClass, *, replace: bool = False) -> LawClass:
    """Makes a class of laws known by its `name` in this process; can be used as a decorator.

    A class that is defined again, as in a cell of a notebook, takes the place of what it was.

    Args:
        law: the class.
        replace: let it take the place of another law of that name.

    Raises:
        InputError: another law has that name, or it is no class of laws.
    """
    if not (isinstance(law, type) and issubclass(law, Law)):
        raise InputError(f"a law is a class that derives from mjgranular.Law, not {kind_of(law)}")
    before = laws.get(law.name)
    again = before is not None and (before.__module__, before.__qualname__) == (
        law.__module__,
        law.__qualname__,
    )
    laws.add(law.name, law, replace=replace or again)
    return law


def constants_of(law: type[Law], medium: Medium | str, name: str | None = None) -> dict[str, Any]:
    """A medium's constants for a law, by the names of the law's fields.

    Args:
        law: a dataclass.
        medium: the medium, or its name.
        name: of a law that has them, where that is another; None for the law's own.

    Raises:
        UnknownNameError: the medium has none for this law.
        InputError: one that the law does not know, or one that it needs is missing.
    """
    known = fields(law)  # pyright: ignore[reportArgumentType]
    medium = get_medium(medium)
    constants = medium.constants_for(name or law.name)
    names = [field.name for field in known]
    for key in constants:
        if key not in names:
            raise InputError(
                f"medium {medium.name!r}: the law {law.name!r} has no constant {key!r}; it has: "
                f"{', '.join(names)}"
            )
    for field in known:
        if field.default is MISSING and field.name not in constants:
            raise InputError(
                f"medium {medium.name!r}: the law {law.name!r} needs the constant {field.name!r}"
            )
    return constants


def make_scene(law: Law, medium: Medium, surface: Surface, model: mujoco.MjModel) -> np.ndarray:
    """Makes the record of law, medium and surface: fields `law` and `surface`, shape (1,)."""
    parameters, place = law.parameters(medium), surface.record(model)
    scene = np.zeros(1, np.dtype([("law", parameters.dtype), ("surface", place.dtype)]))
    scene["law"], scene["surface"] = parameters, place
    return scene


def get_law(law: str | Law | type[Law] | None, medium: Medium) -> Law:
    """The law of that name or class with the medium's constants, its own law, or `law` itself.

    A name may have parameters behind it, such as "rft3d scale=1.3": they replace the medium's
    constants, which are not asked for where all that a law needs is given.

    Raises:
        UnknownNameError: no such law, or the medium has no constants for it.
        InputError: a parameter that the law does not have, or a value of a wrong type.
    """
    if isinstance(law, Law):
        return law
    if isinstance(law, type) and issubclass(law, Law):
        return law.from_medium(medium)
    if law is None:
        return laws[medium.default_law].from_medium(medium)
    cls, given = law_in(law)
    if not given:
        return cls.from_medium(medium)
    known = fields(cls)  # pyright: ignore[reportArgumentType]
    if {field.name for field in known if field.default is MISSING} <= given.keys():
        return cls(**given)
    made = cls.from_medium(medium)
    return cls(**{**{field.name: getattr(made, field.name) for field in known}, **given})


def law_in(text: str) -> tuple[type[Law], dict[str, Any]]:
    """The class of a law that is named, and the parameters behind the name.

    Raises:
        UnknownNameError: no such law; lists those there are.
        InputError: a parameter that the law does not have, or a value of a wrong type.
    """
    if not isinstance(text, str) or not text.strip():
        return laws[text], {}  # which says what there is
    return read_part(text, laws, "law")


def check_constants(medium: Medium) -> None:
    """Checks a medium's constants against the fields of the laws they are for.

    A law that is not known, and resembles none, may be of somebody's own.

    Raises:
        UnknownNameError: a law whose name is misspelt.
        InputError: a constant that the law does not have, one that it needs is missing, or a value
            outside its range.
    """
    for name in medium.constants:
        if name in laws:
            laws[name].from_medium(medium)
        elif difflib.get_close_matches(name, laws):
            raise UnknownNameError("law", name, laws)
        else:
            warn_user(
                f"medium {medium.name!r}: no law {name!r} is known here, so its constants are not "
                "checked"
            )
