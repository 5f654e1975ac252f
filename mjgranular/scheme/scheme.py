"""The interface of schemes, and the statuses of their programs."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import LONGEST_STEP
from mjgranular.kernel.records import options_at
from mjgranular.law.kernel import LawKernel

STEP = "int64(int64, float64)"  # signature of the program of a scheme

FORCES = "float64(int64, int64, int64, float64, int64, float64)"
"""Signature of the program of a law (`Scheme.forces`)."""


# Statuses of a scheme's program. Options may change between any two steps, for example in a viewer:
# a scheme that cannot step with them reports that before it computes anything.
FINE = -1  # success
BAD_STATE = -2  # MuJoCo has found numbers in the state that are not finite
BAD_TIMESTEP = -3  # the time step is not a positive number
LONG_TIMESTEP = -4  # the time step is longer than the scheme was chosen for
BAD_INTEGRATOR = -5  # the scheme cannot step with this integrator
BAD_SOLVER = -6  # the engine does not have this constraint solver: it would end the process
BAD_METRIC = -7
"""The integrator `discrete` with options that the implicit scheme does not predict."""

REFUSALS = {  # numbered downward without gaps
    BAD_TIMESTEP: "the time step of the model (opt.timestep) must be a positive number",
    LONG_TIMESTEP: (
        "the explicit scheme was chosen for time steps up to {limit:g} s, and that of the model "
        "(opt.timestep) is longer now: prepare the sand again, or with scheme='implicit'"
    ),
    BAD_INTEGRATOR: (
        "the sand cannot be stepped with the integrator that the model has now (opt.integrator, "
        "such as RK4): set it to Euler, implicit, implicitfast or discrete"
    ),
    BAD_SOLVER: (
        "the constraint solver of the model (opt.solver) is none that MuJoCo has: set it to PGS, "
        "CG or Newton"
    ),
    BAD_METRIC: (
        "with the integrator discrete the implicit scheme predicts the constraint solvers Newton "
        "and CG (opt.solver), without the flag ipc (opt.enableflags): set these, another "
        "integrator, or scheme='explicit'"
    ),
}
"""Statuses for options that the scheme cannot step with, and what to change."""

REFUSED = tuple(REFUSALS)

_LONGEST = 10**18  # [ns]: any step
_NANO = 1e-9
_SOLVERS = len(mujoco.mjtSolver.__members__)
_INTEGRATORS, _RK4 = len(mujoco.mjtIntegrator.__members__), int(mujoco.mjtIntegrator.mjINT_RK4)


@partial(compiled, inline=True)
def check_options(table):
    """Return `FINE` if the scheme can step with the model's options, else one of `REFUSED`."""
    options = options_at(table)
    step = options.timestep
    if not 0.0 < step < math.inf:
        return BAD_TIMESTEP
    if step > _NANO * table[LONGEST_STEP]:
        return LONG_TIMESTEP
    if options.integrator == _RK4 or not 0 <= options.integrator < _INTEGRATORS:
        return BAD_INTEGRATOR
    if not 0 <= options.solver < _SOLVERS:
        return BAD_SOLVER
    return FINE


def nanoseconds(longest_step: float) -> int:
    """Convert a longest time step [s] for the table [ns], with a margin for its rounding."""
    return math.ceil(min((1 + 1e-9) * longest_step / _NANO, _LONGEST))


@dataclass(frozen=True)
class Workspace:
    """Memory of a scheme for one simulation, allocated once, so that no step allocates."""

    record: np.ndarray  # sizes and addresses, as the scheme's program reads them; words of 8 bytes
    # By name, those whose addresses are in the record, to be kept alive.
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    statistics: np.ndarray | None = None  # what the program counts, by name; see the scheme


class SchemeChoice(ABC):
    """Choice of a scheme: a fixed one, or one that depends on the model."""

    name: ClassVar[str]  # in the registry

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
        """Say why the program returned a status of `REFUSED`, and what to change."""
        return REFUSALS[status].format(limit=self.step_limit)

    @property
    @abstractmethod
    def lead(self) -> float:
        """Return how far velocities lead the state, as a fraction of the time step."""

    @abstractmethod
    def program(self, kernel: LawKernel, scene: np.dtype) -> Any:
        """Make the kernel that goes from a law's kernels to `xfrc_applied`.

        Called as `program(address, lead)` with the address of the simulation's table
        (`kernel.memory`) and the lead in seconds; it returns one of these statuses, or the row of
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
