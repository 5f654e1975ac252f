"""What every scheme offers, and the register of schemes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import mujoco

from mjgranular.registry import Registry

schemes: Registry[type[Scheme]] = Registry("scheme")


class Scheme(ABC):
    """How forces become a step. A final scheme is a frozen dataclass of its options.

    Attributes:
        name: the name it is known by.
        title: one line for lists.
    """

    name: ClassVar[str]
    title: ClassVar[str]

    @property
    @abstractmethod
    def lead(self) -> float:
        """How far ahead of the state velocities are taken, as a fraction of the time step."""

    @abstractmethod
    def program(self, kernel: Any) -> Any:
        """One compiled call that takes a law's kernel to `xfrc_applied`.

        Called as `program(address, lead)` with the address of the simulation's table
        (`kernel.memory`) and the lead in seconds; returns -1, the row of the
        first body whose wrench is not finite, or -2 if MuJoCo has found the state bad.
        """

    @abstractmethod
    def check(self, model: mujoco.MjModel) -> None:
        """Refuses a model that the scheme cannot step.

        Raises:
            InputError: says why, and what to set instead.
        """


def get_scheme(scheme: str | Scheme) -> Scheme:
    """The scheme of that name with its default options, or `scheme` itself.

    Raises:
        UnknownNameError: no such scheme; lists those that exist.
    """
    return scheme if isinstance(scheme, Scheme) else schemes[scheme]()
