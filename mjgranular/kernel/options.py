"""The options of a model, which a user may change between any two steps.

Nothing that depends on them is stored: compiled code reads `mjOption` in place in `mjModel`.
"""

from functools import partial

import mujoco

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import OPTIONS, field, records
from mjgranular.kernel.structs import check_layout, offset_of, record_of

OPTION_DTYPE = record_of("mjOption")
option_records = records(OPTION_DTYPE)
_options_in = field("mjModel", "opt")

NO_GRAVITY = int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
NO_PASSIVE_FORCES = int(mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER)
"""With both of these disabled `mj_passive` computes nothing, not even the forces of plugins."""


def options_address(model: mujoco.MjModel) -> int:
    """Return the address of a model's `mjOption`."""
    check_layout("mjOption")
    return model.opt.gravity.ctypes.data - offset_of("mjOption", "gravity")


@partial(compiled, inline=True)
def options_at(table):
    """Return the present options of the model, a record of `OPTION_DTYPE`."""
    return option_records(table[OPTIONS], 1)[0]


@partial(compiled, inline=True)
def options_of(model):
    """Return the present options of the model at an address."""
    return option_records(_options_in(model), 1)[0]


@partial(compiled, inline=True)
def has_passive_forces(model):
    """Return True if MuJoCo computes passive forces for the model at an address."""
    return options_of(model).disableflags & NO_PASSIVE_FORCES != NO_PASSIVE_FORCES
