"""The interface of schemes, and their register."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular._util.parse import read_part
from mjgranular._util.registry import Registry
from mjgranular.errors import InputError
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.status import refusal

schemes: Registry[type[SchemeChoice]] = Registry("scheme")
"""Classes of schemes by their names."""

STEP = "int64(int64, float64)"
"""Signature of the program of a scheme."""

_SPELLED = {"EULER": "Euler"}


@dataclass(frozen=True)
class Workspace:
    """Memory of a scheme for one simulation: made once, so that no step allocates.

    Attributes:
        record: sizes and addresses, as the scheme's program reads them; words of 8 bytes.
        arrays: by name, those whose addresses are in the record, to be kept alive.
        statistics: what the program counts, by name; see the scheme.
    """

    record: np.ndarray
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    statistics: np.ndarray | None = None


class SchemeChoice(ABC):
    """Choice of a scheme: one, or one among several by the model.

    Attributes:
        name: the name it is known by.
        title: one line for lists.
    """

    name: ClassVar[str]
    title: ClassVar[str]

    @abstractmethod
    def scheme_for(
        self, model: mujoco.MjModel, elements: int, *, adds_mass: bool = False
    ) -> Scheme:
        """The scheme for a model with so many elements, and for a law (`Law.adds_mass`)."""

    @abstractmethod
    def check(self, model: mujoco.MjModel) -> None:
        """Refuses a model that the scheme cannot step.

        Raises:
            InputError: says why, and what to set instead.
        """


class Scheme(SchemeChoice):
    """Way in which forces become a step. A final scheme is a frozen dataclass of its options.

    Attributes:
        whole_state: whether its forces depend on more than `qpos` and `qvel`: on actuators, applied
            and passive forces, constraints.
        integrators: of MuJoCo's that can be stepped from outside.
    """

    whole_state: ClassVar[bool] = False
    integrators: ClassVar[tuple[str, ...]] = ("EULER", "IMPLICIT", "IMPLICITFAST", "DISCRETE")

    @property
    def step_limit(self) -> float:
        """The longest time step that may be set later [s]."""
        return math.inf

    def refusal(self, status: int) -> str:
        """Says what the program has refused (`scheme.status.REFUSED`), and what it would take."""
        *first, last = (_SPELLED.get(name, name.lower()) for name in self.integrators)
        return refusal(
            status,
            longest_step=self.step_limit,
            integrators=f"{', '.join(first)} or {last}",
        )

    @property
    @abstractmethod
    def lead(self) -> float:
        """Time by which velocities are taken ahead of the state, as a fraction of the time step."""

    @abstractmethod
    def program(self, kernel: LawKernel, scene: np.dtype) -> Any:
        """One compiled call that takes a law's kernels to `xfrc_applied`.

        Called as `program(address, lead)` with the address of the simulation's table
        (`kernel.memory`) and the lead in seconds; returns one of `scheme.status`, or the row of
        the first body whose wrench is not finite.

        Args:
            kernel: of the law.
            scene: record of two: `law`, made by its `parameters`, and `surface`.
        """

    def scheme_for(
        self, model: mujoco.MjModel, elements: int, *, adds_mass: bool = False
    ) -> Scheme:
        return self

    def workspace(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        elements: np.ndarray,
        kernel: LawKernel,
        *,
        within: bool = False,
    ) -> Workspace:
        """The memory that the program works with in one simulation, if it needs any.

        Args:
            model: the model.
            data: the simulation.
            elements: of the law.
            kernel: of the law.
            within: whether the program runs among MuJoCo's passive forces, inside its step.
        """
        return Workspace(np.zeros(0, np.int64))


def get_scheme(scheme: str | SchemeChoice | type[SchemeChoice]) -> SchemeChoice:
    """The scheme of that name or class, or `scheme` itself.

    A name may have options behind it, such as "implicit evaluations=9"; others are the defaults.

    Raises:
        UnknownNameError: no such scheme; lists those that exist.
        InputError: an option that the scheme does not have, or a value of a wrong type.
    """
    if isinstance(scheme, type) and issubclass(scheme, SchemeChoice):
        return scheme()
    if isinstance(scheme, SchemeChoice):
        return scheme
    if not isinstance(scheme, str) or not scheme.strip():
        return schemes[scheme]()
    cls, given = read_part(scheme, schemes, "scheme")
    return cls(**given)


def refuse_runge_kutta(model: mujoco.MjModel) -> None:
    """Refuses the one integrator that cannot be stepped with a force from outside.

    Raises:
        InputError: the model's integrator is RK4.
    """
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        raise InputError(
            "the integrator RK4 cannot be stepped with a force from outside: mj_step1 and "
            "mj_step2 would silently be Euler; set the model's integrator to Euler, implicit "
            "or implicitfast"
        )
