"""Motion of a body: its velocity, and the change within the time that a scheme looks ahead.

MuJoCo's `cvel` and the columns of `cdof` are spatial vectors (angular, linear) about the centre of
mass of the kinematic tree, world axes; sums of them need no Jacobian.
"""

from __future__ import annotations

from functools import partial

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import CDOF, DOF_PARENT, NV, WARMSTART, ints, row_of


@compiled
def velocity_change(table, last_dof, lead):
    """Change of a body's spatial velocity within `lead` at the acceleration of the last step.

    That acceleration is `qacc_warmstart`: zero after a reset, and part of MuJoCo's own integration
    state, so that a copied simulation goes on as the original does.

    Args:
        table: the simulation's.
        last_dof: the last degree of freedom in the body's chain, -1 if it has none.
        lead: time [s].

    Returns:
        As `motion_along`.
    """
    return motion_along(table, last_dof, table[WARMSTART], lead)


@partial(compiled, inline=True)
def motion_along(table, last_dof, rates, scale):
    """The spatial velocity that rates of the degrees of freedom give a body.

    Args:
        table: the simulation's.
        last_dof: the last degree of freedom in the body's chain, -1 if it has none.
        rates: address of nv numbers.
        scale: what they are multiplied by.

    Returns:
        (wx, wy, wz, vx, vy, vz): angular velocity [rad/s], and linear velocity [m/s] of the point
        that coincides with the tree's centre of mass.
    """
    parent = ints(table[DOF_PARENT], table[NV])
    wx, wy, wz, vx, vy, vz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    dof = last_dof
    while dof >= 0:
        gain = scale * row_of(rates, dof, 1)[0]
        axis = row_of(table[CDOF], dof, 6)
        wx += gain * axis[0]
        wy += gain * axis[1]
        wz += gain * axis[2]
        vx += gain * axis[3]
        vy += gain * axis[4]
        vz += gain * axis[5]
        dof = parent[dof]
    return wx, wy, wz, vx, vy, vz


@partial(compiled, inline=True)
def velocity_at(motion, x, y, z):
    """Linear velocity [m/s] at (x, y, z) from the centre of a spatial velocity."""
    wx, wy, wz, vx, vy, vz = motion
    return vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x


@compiled
def add_force(wrench, fx, fy, fz, x, y, z):
    """Adds a force [N] that acts at (x, y, z) from the centre of mass [m] to a body's wrench."""
    wrench[0] += fx
    wrench[1] += fy
    wrench[2] += fz
    wrench[3] += y * fz - z * fy
    wrench[4] += z * fx - x * fz
    wrench[5] += x * fy - y * fx
