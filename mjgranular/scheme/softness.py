"""How softly the implicit scheme holds what is at rest, and how close to balance it has to come.

A static force that holds grows to its limit over a small speed, the softness. It is far below
anything visible, and grows with speeds that cancel in an element's own, whose rounding a finer hold
would drown in.
"""

from __future__ import annotations

import math

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import floats, ints
from mjgranular.scheme import desk as d
from mjgranular.scheme.layout import ARM, VELOCITY, head_records

# Speed at which a static force that holds lets go [m/s]: what holds for a year moves 0.03 mm at
# 0.7 of its limit. Beside it, a share of the speeds that cancel in an element's own, the largest
# of all elements: a hold finer than their rounding would drown in it. Both chosen; robots need as
# many evaluations with a share of 1e-5 and 5 % fewer with 1e-4, where they hold less.
_SOFT = 1e-12
_SOFT_SHARE = 1e-6
# Residuals to be reached at rest and in motion, where rounding in what holds is larger, in parts of
# the momentum at hand. Chosen; at rest a step begins with the grips that velocities stand for, and
# after 1e-12, which is a tenth of the softness in one of gravity's 0.1 m/s a step, with wrong ones.
_AT_REST, _IN_MOTION = 1e-13, 1e-8


@compiled
def goal_of(fine):
    """Residual to be reached, in parts of the momentum at hand."""
    return _AT_REST + _IN_MOTION * (fine - _SOFT) / fine


@compiled
def fastest_of(desk, count):
    """The greatest speed in the blocks [m/s]."""
    lanes = desk[d.LANES]
    most = 0.0
    for i in range(count):
        v = d.vectors_at(desk, i, VELOCITY)
        for lane in range(lanes):
            x, y, z = v[lane], v[lanes + lane], v[2 * lanes + lane]
            most = max(most, x * x + y * y + z * z)
    return math.sqrt(most)


@compiled
def softness(desk, count, velocity):
    """The fine softness at a velocity [m/s].

    With it grow the velocities of joints that cancel in that of a body: the rounding of its rest.
    """
    nv, nbody = desk[d.NV], desk[d.NBODY]
    cdof = floats(desk[d.CDOF], 6 * nv)
    parents = ints(desk[d.BODY_PARENT], nbody)
    dof_parent = ints(desk[d.DOF_PARENT], nv)
    first, number = ints(desk[d.BODY_DOF], nbody), ints(desk[d.BODY_DOFS], nbody)
    large = 0.0
    last = -1
    lanes = desk[d.LANES]
    heads = head_records(desk[d.HEADS], count)
    for i in range(count):
        if heads[i].body == last:
            continue
        last = heads[i].body
        first_arm = d.vectors_at(desk, i, ARM)
        arm = abs(first_arm[0]) + abs(first_arm[lanes]) + abs(first_arm[2 * lanes])
        body = last
        while body > 0 and number[body] == 0:
            body = parents[body]
        dof = first[body] + number[body] - 1 if body > 0 else -1
        total = 0.0
        while dof >= 0:
            c = cdof[6 * dof : 6 * dof + 6]
            turning = abs(c[0]) + abs(c[1]) + abs(c[2])
            total += abs(velocity[dof]) * (arm * turning + abs(c[3]) + abs(c[4]) + abs(c[5]))
            dof = dof_parent[dof]
        large = max(large, total)
    return _SOFT + _SOFT_SHARE * large
