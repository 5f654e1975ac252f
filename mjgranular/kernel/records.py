"""Records that kernels fill: one for each body in the sand, and one for each element."""

from functools import partial

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import BODIES, BODY_COUNT, CONTACTS, ELEMENT_COUNT, records

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

body_records = records(BODY_DTYPE)
contact_records = records(CONTACT_DTYPE)


@partial(compiled, inline=True)
def bodies_of(table):
    """Return the records of the bodies of a simulation."""
    return body_records(table[BODIES], table[BODY_COUNT])


@partial(compiled, inline=True)
def contacts_of(table):
    """Return the records of the elements of a simulation."""
    return contact_records(table[CONTACTS], table[ELEMENT_COUNT])
