"""Motion of a body: its velocity, and that of its points.

MuJoCo's `cvel` and the columns of `cdof` are spatial vectors (angular, linear) about the center of
mass of the kinematic tree, world axes; sums of them need no Jacobian.
"""

from functools import partial
from typing import NamedTuple

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import CDOF, DOF_PARENT, NV, ints, row_of
from mjgranular.kernel.vector import Vector, cross, read_vector, vector, write_vector


class Motion(NamedTuple):
    """A spatial velocity."""

    angular: Vector  # [rad/s]
    linear: Vector  # of the point that coincides with the tree's center of mass [m/s]


@partial(compiled, inline=True)
def motion_along(table, last_dof, rates, scale):
    """Return the spatial velocity of a body from `scale` times the rates at an address.

    The body's chain ends with the degree of freedom `last_dof`, -1 if it has none.
    """
    parent = ints(table[DOF_PARENT], table[NV])
    angular, linear = vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0)
    dof = last_dof
    while dof >= 0:
        gain = scale * row_of(rates, dof, 1)[0]
        axis = row_of(table[CDOF], dof, 6)
        angular += gain * read_vector(axis, 0)
        linear += gain * read_vector(axis, 3)
        dof = parent[dof]
    return Motion(angular, linear)


@partial(compiled, inline=True)
def velocity_at(motion, arm):
    """Return the linear velocity [m/s] of a point, from its position relative to the center [m]."""
    return motion.linear + cross(motion.angular, arm)


@partial(compiled, inline=True)
def read_motion(array, first):
    """Return the spatial velocity in six numbers of an array, from index `first` on."""
    return Motion(read_vector(array, first), read_vector(array, first + 3))


@partial(compiled, inline=True)
def write_motion(array, first, motion):
    """Write a spatial velocity, or a force and a moment, to an array, from index `first` on."""
    write_vector(array, first, motion.angular)
    write_vector(array, first + 3, motion.linear)


@partial(compiled, inline=True)
def still():
    """Return zero motion."""
    return Motion(vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0))
