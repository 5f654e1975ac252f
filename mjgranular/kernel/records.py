"""Records of kernels: of each body in the sand and of each element, filled; the model's options.

A user may change options between any two steps: kernels read `mjOption` in place in `mjModel`.
"""

from functools import partial

import mujoco
import numpy as np

from mjgranular.kernel import memory
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import check_layout, offset_of, record_of

BODY_DTYPE = np.dtype(
    [
        ("body", np.int64),
        ("root", np.int64),  # root of the body's kinematic tree
        ("last_dof", np.int64),
        ("end", np.int64),  # one past its last element: elements come body by body
        ("wrench", np.float64, (6,)),  # force [N], moment about the center of mass [N m], world
        ("change", np.float64, (6,)),  # of its spatial velocity within a scheme's lead
        ("user_wrench", np.float64, (6,)),  # the user's row of xfrc_applied
        ("last_wrench", np.float64, (6,)),  # that row as last written by the sand
    ]
)
# Above the sand only the depth is written.
CONTACT_DTYPE = np.dtype(
    [
        ("depth", np.float64),  # of the element's deepest point [m], negative above the sand
        ("length", np.float64),  # immersed length of a rod [m], 0 for other elements
        ("point", np.float64, (3,)),  # point of action of the force [m], world
        ("velocity", np.float64, (3,)),  # of that point [m/s], world
        ("force", np.float64, (3,)),  # on the element [N], world
        ("power", np.float64),  # of that force at the velocity that it belongs to [W]
    ]
)

OPTION_DTYPE = record_of("mjOption")

NO_GRAVITY = int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
NO_PASSIVE_FORCES = int(mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER)
"""With both of these disabled `mj_passive` computes nothing, not even the forces of plugins."""

body_records = memory.records(BODY_DTYPE)
contact_records = memory.records(CONTACT_DTYPE)
option_records = memory.records(OPTION_DTYPE)
_options_in = memory.field("mjModel", "opt")


@partial(compiled, inline=True)
def bodies_of(table):
    """Return the records of the bodies of a simulation."""
    return body_records(table[memory.BODIES], table[memory.BODY_COUNT])


@partial(compiled, inline=True)
def contacts_of(table):
    """Return the records of the elements of a simulation."""
    return contact_records(table[memory.CONTACTS], table[memory.ELEMENT_COUNT])


def options_address(model: mujoco.MjModel) -> int:
    """Return the address of a model's `mjOption`."""
    check_layout("mjOption")
    return model.opt.gravity.ctypes.data - offset_of("mjOption", "gravity")


@partial(compiled, inline=True)
def options_at(table):
    """Return the present options of the model, a record of `OPTION_DTYPE`."""
    return option_records(table[memory.OPTIONS], 1)[0]


@partial(compiled, inline=True)
def options_of(model):
    """Return the present options of the model at an address."""
    return option_records(_options_in(model), 1)[0]


@partial(compiled, inline=True)
def has_passive_forces(model):
    """Return True if MuJoCo computes passive forces for the model at an address."""
    return options_of(model).disableflags & NO_PASSIVE_FORCES != NO_PASSIVE_FORCES
