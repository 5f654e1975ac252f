"""The interface of laws, and their registry."""

import difflib
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import MISSING, fields, replace
from functools import cache
from itertools import product
from typing import Any, ClassVar, Self, TypeVar

import mujoco
import numpy as np

from mjgranular._util.checks import check_records, is_finite, kind_of
from mjgranular._util.parse import Registry, read_part
from mjgranular.errors import InputError, UnknownNameError, shown, warn_user
from mjgranular.kernel.compiled import compiled, entry
from mjgranular.kernel.fields import column, packed, size_of
from mjgranular.kernel.memory import floats, records
from mjgranular.kernel.motion import still
from mjgranular.kernel.vector import diagonal, dot, norm, read_vector
from mjgranular.law.kernel import LawKernel, Pose
from mjgranular.law.validity import Finding, Limit, findings_of
from mjgranular.medium import Medium, get_medium
from mjgranular.surface import Surface

laws: Registry[type["Law"]] = Registry("law", "import its module; commands: --law module:Class")
"""Law classes by name."""


class Law(ABC):
    """Resistance of sand. A final law is a frozen dataclass of its parameters.

    Attributes:
        name: name in the registry.
        title: one line for lists.
        citation: where it was published.
        validity: limits within which it holds; `Sand.report` compares bodies with them.
        strength_keys: fields of its record that the static resistance is proportional to.
        density_keys: fields that velocity-dependent resistance is proportional to, through a
            medium's density. Tunable sand scales both (`engine.tuning`).
    """

    name: ClassVar[str]
    title: ClassVar[str]
    citation: ClassVar[str]
    validity: ClassVar[tuple[Limit, ...]] = ()
    strength_keys: ClassVar[tuple[str, ...]] = ()
    density_keys: ClassVar[tuple[str, ...]] = ()

    @property
    def adds_mass(self) -> bool:
        """Whether there is added mass (`LawKernel.added`), which needs the implicit scheme."""
        return False

    @classmethod
    def from_medium(cls, medium: Medium | str) -> Self:
        """Return the law with the published constants of a medium, given as object or name.

        Raises:
            UnknownNameError: the medium has no constants for this law.
        """
        return cls(**constants_of(cls, medium))

    @abstractmethod
    def elements(
        self, model: mujoco.MjModel, geoms: Sequence[int], resolution: int | None = None
    ) -> np.ndarray:
        """Return the elements that the law acts on, of geoms that meet the sand.

        They are a structured array, body by body, with fields `geom`, `body`, `slot` (the row of
        the body among those in the sand) and `width` (for Froude numbers [m]). The resolution is
        how finely geoms are divided, in the law's own measure; None for its default.

        Raises:
            InputError: the law has no elements for some geoms.
        """

    def parameters(self, medium: Medium) -> np.ndarray:
        """Return parameters of law and medium as the kernel reads them: structured, shape (1,).

        These are the law's fields as numbers, unless a law overrides this.

        Raises:
            InputError: a field is not a finite number.
        """
        known = fields(self)  # pyright: ignore[reportArgumentType]
        self.check_numbers(*(field.name for field in known), low=-math.inf)
        return record_of(**{field.name: getattr(self, field.name) for field in known})

    def check_numbers(self, *names: str, low: float = 0.0, high: float = math.inf) -> None:
        """Check that fields are finite numbers in a range."""
        limits = f"from {low:g} to {high:g}" if high < math.inf else "not negative"
        rule = "finite" if low == -math.inf else f"finite and {limits}"
        for name in names:
            value = getattr(self, name)
            if not (is_finite(value) and low <= value <= high):
                raise InputError(
                    f"{type(self).__name__}: {name} must be {rule}, not {shown(value)}"
                )

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return the errors found against measured motion; empty for a law without comparisons."""
        return findings_of(self.name)

    @abstractmethod
    def kernel(self, surface: Surface) -> LawKernel:
        """Return the compiled law under that kind of surface (see `law.kernel`).

        Its `law` is the record made by `parameters`, its `surface` that of the surface.
        """

    def kernel_of_forces(self, surface: Surface) -> LawKernel:
        """Return kernels used for forces only, not for derivatives (`warp`).

        The same as `kernel` unless a law has shorter ones.
        """
        return self.kernel(surface)


def record_of(**numbers: Any) -> np.ndarray:
    """Return numbers and arrays of numbers as a record, as kernels read it: shape (1,)."""
    kinds = [(name, np.float64, np.shape(value)) for name, value in numbers.items()]
    record = np.zeros(1, np.dtype(kinds))
    for name, value in numbers.items():
        record[name] = value
    return record


LawClass = TypeVar("LawClass", bound=type[Law])


def register_law(law: LawClass, *, replace: bool = False) -> LawClass:
    """Register a class of laws by its `name` in this process; can be used as a decorator.

    A class that is defined again, as in a cell of a notebook, replaces the old one; with `replace`
    it replaces any other law of that name.

    Raises:
        InputError: another law has that name, or `law` is not a class of laws.
    """
    if not (isinstance(law, type) and issubclass(law, Law)):
        raise InputError(f"a law is a class that derives from mjgranular.Law, not {kind_of(law)}")
    if not isinstance(getattr(law, "name", None), str):
        raise InputError(f"the law {law.__name__} must have a class variable `name`, a string")
    laws.add(law.name, law, replace=replace)
    return law


def constants_of(law: type[Law], medium: Medium | str, name: str | None = None) -> dict[str, Any]:
    """Return a medium's constants for a law, by the names of the law's fields.

    `name` is the law whose constants to use, if another. Errors name constants that are missing or
    unknown.
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
    switches = [field.name for field in known if isinstance(field.default, bool)]
    return {k: bool(v) if k in switches and v in (0, 1) else v for k, v in constants.items()}


def make_scene(law: Law, medium: Medium, surface: Surface, model: mujoco.MjModel) -> np.ndarray:
    """Make the record of law, medium and surface: fields `law` and `surface`, shape (1,)."""
    parameters, place = law.parameters(medium), surface.record(model)
    check_records(f"{type(law).__name__}.parameters", parameters)
    scene = np.zeros(1, np.dtype([("law", parameters.dtype), ("surface", place.dtype)]))
    scene["law"], scene["surface"] = parameters, place
    return scene


def get_law(law: str | Law | None, medium: Medium | str) -> Law:
    """Return the law of that name with the medium's constants, or `law` itself.

    None stands for the medium's default law. A name may be followed by parameters, such as "rft3d
    scale=1.3": they replace the medium's constants, which are not needed if all required parameters
    are given.

    Raises:
        UnknownNameError: no such law, or the medium has no constants for it.
        InputError: a parameter that the law does not have, or a value of a wrong type.
    """
    if isinstance(law, Law):
        return law
    if law is None:
        return laws[get_medium(medium).default_law].from_medium(medium)
    cls, given = law_in(law)
    if not given:
        return cls.from_medium(medium)
    known = fields(cls)  # pyright: ignore[reportArgumentType]
    if {field.name for field in known if field.default is MISSING} <= given.keys():
        return cls(**given)
    made: Any = cls.from_medium(medium)
    return replace(made, **given)


def law_in(text: str) -> tuple[type[Law], dict[str, Any]]:
    """Parse the name of a law and the parameters after it, each one of a field of that law."""
    if not isinstance(text, str) or not text.strip():
        return laws[text], {}  # raises with a list of names
    return read_part(text, laws, "law")


def check_constants(medium: Medium) -> None:
    """Check names, number and values of a medium's constants against the laws they are for.

    A law that is unknown, and whose name resembles none, may be a custom one.
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


# The rules for `respond` that a custom law may break; docs/architecture.md has them in words.

_DIRECTION = np.array([0.6, 0.48, 0.64])
_TOLERANCE = 1e-3  # chosen: derivatives may be differences


@cache
def _rules_kernel(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """Make a kernel `add_power(scene, elements, count, account)`, of addresses.

    The account is the position of the body, its velocity, the number of elements in the sand, a
    relative error of F = F'(p) p, and the power of static resistance and of drag.
    """
    scenes, size = records(scene_dtype), size_of(kernel.element)
    read, own = column(kernel.element, 1).read, kernel.multiplier.own
    sample, respond = kernel.sample, kernel.respond

    @compiled
    def add_power(scene, elements, count, account):
        record, out = scenes(scene, 1)[0], floats(account, 10)
        law, place = record.law, record.surface
        at, v = read_vector(out, 0), read_vector(out, 3)
        pose = Pose(at, diagonal(1.0), at, at, still())
        for i in range(count):
            element = read(floats(elements + 8 * size * i, size), 0)
            found = sample(element, pose, law, place, 9.81)
            if found.depth > 0.0:
                static, _, drag, _ = respond(found, law, 9.81, v, own(found, v, 1e-150), 0.0)
                p = own(found, v, norm(v))
                soft, by_p, _, _ = respond(found, law, 9.81, v, p, norm(v))
                error = norm(by_p @ p - soft)
                out[6] += 1.0
                if not error <= _TOLERANCE * norm(soft):  # NaN is an error too
                    out[7] = error / norm(soft)
                out[8] += dot(static, v)
                out[9] += dot(drag, v)

    return add_power


def check_rules(
    law: Law, kernel: LawKernel, elements: np.ndarray, scene: np.ndarray, model: mujoco.MjModel
) -> None:
    """Check the forces of a custom law on its elements, moved to a place in the sand."""
    if type(law).__module__.startswith("mjgranular."):
        return  # has been tested; to load the kernel takes time
    numbers, account = packed(elements, kernel.element), np.zeros(10)
    add_power = entry(_rules_kernel(kernel, scene.dtype), "void(int64, int64, int64, int64)")
    addresses = scene.ctypes.data, numbers.ctypes.data, len(numbers), account.ctypes.data
    for distance in (0.1, 1, 10, 100):
        for *corner, side in product(*3 * [(-1, 0, 1)], (-1, 1)):
            account[:3] = model.stat.center + distance * model.stat.extent * np.array(corner)
            account[3:6] = side * _DIRECTION
            add_power(*addresses)
        if account[6] > 0:
            break
    error, static, drag = account[7:]
    respond = f"{type(law).__name__}: respond must return"
    if not np.isfinite(static + drag):
        raise InputError(f"{respond} finite forces, got {static + drag} N")
    for force, power in (("a static resistance", static), ("a drag", drag)):
        if power > 1e-9:  # [W], at 1 m/s; rounding
            raise InputError(f"{respond} {force} that opposes the motion, got the reverse")
    if error != 0:
        raise InputError(
            f"{respond} a derivative by p that, times p, is the static resistance, got a relative "
            f"error of {error:.2g}"
        )
