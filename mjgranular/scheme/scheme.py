"""The interface of schemes, and their registry."""

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
from mjgranular.scheme.status import REFUSALS

schemes: Registry[type["SchemeChoice"]] = Registry("scheme")
"""Scheme classes by name."""

STEP = "int64(int64, float64)"  # signature of the program of a scheme

FORCES = "float64(int64, int64, int64, float64, int64, float64)"
"""Signature of the program of a law (`Scheme.forces`)."""


@dataclass(frozen=True)
class Workspace:
    """Memory of a scheme for one simulation, allocated once, so that no step allocates."""

    record: np.ndarray  # sizes and addresses, as the scheme's program reads them; words of 8 bytes
    # By name, those whose addresses are in the record, to be kept alive.
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    statistics: np.ndarray | None = None  # what the program counts, by name; see the scheme


class SchemeChoice(ABC):
    """Choice of a scheme: a fixed one, or one that depends on the model.

    Attributes:
        name: name in the registry.
    """

    name: ClassVar[str]

    @abstractmethod
    def scheme_for(self, model: mujoco.MjModel, elements: int, adds_mass: bool) -> "Scheme":
        """Return the scheme for a model, its number of elements, and its law (`Law.adds_mass`)."""

    def check(self, model: mujoco.MjModel) -> None:
        """Check that the scheme can step a model; the error says what to set instead."""
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            raise InputError(
                "the integrator RK4 cannot be stepped with sand, whose force belongs to one step "
                "and not to four stages: set the model's integrator to Euler, implicit or "
                "implicitfast"
            )


class Scheme(SchemeChoice):
    """How forces enter a step. A final scheme is a frozen dataclass of its options.

    Attributes:
        whole_state: whether its forces depend on more than `qpos` and `qvel`: on actuators, applied
            and passive forces, constraints.
    """

    whole_state: ClassVar[bool] = False

    @property
    def step_limit(self) -> float:
        """Return the longest time step that may be set later [s]."""
        return math.inf

    def refusal(self, status: int) -> str:
        """Say why the program returned a status of `scheme.status.REFUSED`, and what to change."""
        return REFUSALS[status].format(limit=self.step_limit)

    @property
    @abstractmethod
    def lead(self) -> float:
        """Return how far velocities lead the state, as a fraction of the time step."""

    @abstractmethod
    def program(self, kernel: LawKernel, scene: np.dtype) -> Any:
        """Make the kernel that goes from a law's kernels to `xfrc_applied`.

        Called as `program(address, lead)` with the address of the simulation's table
        (`kernel.memory`) and the lead in seconds; it returns one of `scheme.status`, or the row of
        the first body whose wrench is not finite. A scene is a record with the fields `law`, made
        by its `parameters`, and `surface`.
        """

    def sampling(self, kernel: LawKernel, scene: np.dtype) -> Any:
        """Make the kernel that finds the elements in the sand, if it is a separate program.

        Its address is in the table (`kernel.memory.SAMPLING`). It is called as `program` is, and
        returns nothing of use.
        """
        return None

    def forces(self, kernel: LawKernel, scene: np.dtype) -> Any:
        """Make the kernel of a law's forces, if the scheme's program calls one.

        It is the same for all surfaces, as `program` is then for all laws, so each is compiled
        once. Its address is in the table (`kernel.memory.LAW`).
        """
        return None

    def scheme_for(self, model: mujoco.MjModel, elements: int, adds_mass: bool) -> "Scheme":
        return self

    def workspace(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        kernel: LawKernel,
        tiles: int,
        within: bool,
    ) -> Workspace:
        """Allocate the memory that the program needs in one simulation, if any.

        `tiles` is the number of tiles of elements (`LawKernel.pack`), `within` whether the program
        runs among MuJoCo's passive forces, inside its step.
        """
        return Workspace(np.zeros(0, np.int64))


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
