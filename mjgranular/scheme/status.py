"""Statuses of a scheme's program, and its check of the model's options.

Options may change between any two steps, for example in a viewer. A scheme that cannot step with
them reports that before it computes anything.
"""

import math
from functools import partial

import mujoco

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import LONGEST_STEP
from mjgranular.kernel.options import options_at

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
