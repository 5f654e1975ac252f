"""The velocity of a body, now or half a step ahead."""

from __future__ import annotations

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import CDOF, CVEL, DOF_PARENT, NBODY, NV, WARMSTART, floats, ints


@compiled
def body_velocity(table, body, last_dof, lead):
    """Spatial velocity of a body, extrapolated by the time `lead` with the last acceleration.

    MuJoCo's `cvel` and the columns of `cdof` are spatial vectors about the centre of mass of the
    kinematic tree, so `v + lead * a` needs no Jacobian: one sum along the chain of the body's
    degrees of freedom. `qacc_warmstart` is the acceleration of the last step; it is zero after a
    reset and travels with MuJoCo's own integration state.

    Args:
        table: the simulation's (`kernel.memory`).
        body: body id.
        last_dof: the body's last degree of freedom in its chain, -1 if it has none.
        lead: time to extrapolate by [s]; 0 gives the current velocity.

    Returns:
        (wx, wy, wz, vx, vy, vz): angular velocity [rad/s] and linear velocity [m/s] of the point
        that coincides with the tree's centre of mass, world axes.
    """
    cvel = floats(table[CVEL], 6 * table[NBODY])
    i = 6 * body
    wx, wy, wz = cvel[i], cvel[i + 1], cvel[i + 2]
    vx, vy, vz = cvel[i + 3], cvel[i + 4], cvel[i + 5]
    if lead != 0.0:
        nv = table[NV]
        cdof = floats(table[CDOF], 6 * nv)
        acceleration = floats(table[WARMSTART], nv)
        parent = ints(table[DOF_PARENT], nv)
        dof = last_dof
        while dof >= 0:
            gain = lead * acceleration[dof]
            j = 6 * dof
            wx += gain * cdof[j]
            wy += gain * cdof[j + 1]
            wz += gain * cdof[j + 2]
            vx += gain * cdof[j + 3]
            vy += gain * cdof[j + 4]
            vz += gain * cdof[j + 5]
            dof = parent[dof]
    return wx, wy, wz, vx, vy, vz
