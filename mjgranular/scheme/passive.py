"""Sand gives no energy: what the implicit scheme does where its solver stops short.

There forces are bounded by the law's, but need not oppose the velocities they lead to. Then the
largest share of them is taken that does.
"""

from __future__ import annotations

import math

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import forward_constraint, solve_inertia
from mjgranular.kernel.memory import floats, ints
from mjgranular.scheme import desk as d
from mjgranular.scheme.balance import copy, norm, solve, weigh
from mjgranular.scheme.constraints import leave, rows_of
from mjgranular.scheme.forces import SAME

NO_ENERGY = 1e-14  # [J]; chosen
_TRUSTED = 1e-8  # a residual that still says something about the energy
_ROUNDING = 1e-15  # of a share


@compiled
def is_sure(desk, error):
    """Whether the velocity that was found says, with its residual, what the step will end with.

    What a solver of the engine's finds that only descends from where it is put
    (`handover.warm_engine`) is no farther off than that. Of the others nothing is known: with few
    iterations they stop anywhere.
    """
    rows = rows_of(desk[d.ROWS], 1)[0]
    alike = desk[d.WARM] != 0 or ints(desk[d.DATA] + rows.count, 1)[0] == 0
    return alike and error < _TRUSTED


@compiled
def power_bound(desk, room, error, scale):
    """What the sand may add to the energy at most [J], by the velocity found and its residual.

    The residual's size is measured with the diagonal of the inertia alone, which may be far too
    little for long chains of light bodies: a margin of a thousand, and no trust in large residuals.
    """
    nv = desk[d.NV]
    velocity = floats(room.velocity, nv)
    sand = floats(room.sand, nv)
    if not is_sure(desk, error):
        return math.inf
    work = 0.0
    for j in range(nv):
        work += sand[j] * velocity[j]
    return work + 1e3 * error * scale * norm(sand, room, nv)


@compiled
def power_ahead(desk, room, h):
    """The sand's momentum times the velocity that the step will end with, at most [J].

    That is the velocity found, less what would make up for the residual if the sand's forces stay
    as they are. Whether the engine's constraints answer to that, or its solver finds that it has
    nothing to do, is not known: both are looked at. Destroys residual and matrix.
    """
    nv = desk[d.NV]
    velocity = floats(room.velocity, nv)
    residual = floats(room.residual, nv)
    kept = floats(room.change, nv)
    matrix = floats(room.matrix, nv * nv)
    inertia = floats(room.inertia, nv * nv)
    weigh(desk, room, velocity, h)
    leave(desk, room, velocity, h, SAME)
    copy(kept, residual)
    power = power_less(desk, room)
    rows = rows_of(desk[d.ROWS], 1)[0]
    if ints(desk[d.DATA] + rows.count, 1)[0] > 0:
        copy(residual, kept)
        copy(matrix, inertia)
        power = max(power, power_less(desk, room))
    return power


@compiled
def power_less(desk, room):
    """The sand's momentum times what the velocity is without the residual over the matrix [J]."""
    nv = desk[d.NV]
    velocity = floats(room.velocity, nv)
    sand = floats(room.sand, nv)
    less = floats(room.trial, nv)
    if not solve(floats(room.matrix, nv * nv), floats(room.residual, nv), less, nv):
        return math.inf
    power = 0.0
    for j in range(nv):
        power += sand[j] * (velocity[j] - less[j])
    return power


@compiled
def passive_share(desk, room, error, h):
    """A share of the sand's momentum that gives no energy; 1 if the whole gives none.

    Where Newton's method stops short, its forces are bounded but need not oppose the velocities
    they lead to. The velocity that a share s leads to is asked for, of the engine itself where it
    has constraints; its product with the sand's momentum grows with s, along a straight line where
    there are none. So what has to be taken off is known from both ends, and doubled until what is
    left gives nothing. What is returned has been asked for.

    It has to be no more than needed: at rest, where rounding alone decides whether there is energy,
    a share less by one in a million would be a kick.
    """
    if is_sure(desk, error) and power_ahead(desk, room, h) <= NO_ENERGY:
        return 1.0
    whole = power_of_share(desk, room, h, 1.0)
    if whole <= NO_ENERGY:
        return 1.0
    none = power_of_share(desk, room, h, 0.0)
    if none >= 0.0:
        return 0.0
    less = max(whole / (whole - none), _ROUNDING)
    while less < 1.0:
        if power_of_share(desk, room, h, 1.0 - less) <= 0.0:
            return 1.0 - less
        less *= 2.0
    return 0.0


@compiled
def power_of_share(desk, room, h, share):
    """The sand's momentum times the velocity that a share of it leads to [J].

    Leaves the engine's state as it was, but for what its step computes anew.
    """
    nv = desk[d.NV]
    start = floats(room.start, nv)
    trial = floats(room.trial, nv)
    room_smooth = floats(room.smooth, nv)
    sand = floats(room.sand, nv)
    answer = floats(room.answer, nv)
    product = floats(room.product, nv)
    inertia = floats(room.inertia, nv * nv)
    matrix = floats(room.matrix, nv * nv)
    smooth = floats(desk[d.SMOOTH], nv)
    acceleration = floats(desk[d.ACCELERATION], nv)
    warmstart = floats(desk[d.WARMSTART], nv)
    constraint = floats(desk[d.CONSTRAINT], nv)
    rows = rows_of(desk[d.ROWS], 1)[0]
    bound = ints(desk[d.DATA] + rows.count, 1)[0] > 0
    for j in range(nv):
        smooth[j] = (room_smooth[j] + share * sand[j]) / h
    if bound:
        solve_inertia(desk[d.MODEL], desk[d.DATA], acceleration.ctypes.data, smooth.ctypes.data, 1)
        for j in range(nv):
            product[j] = warmstart[j]
        forward_constraint(desk[d.MODEL], desk[d.DATA])
        for j in range(nv):
            warmstart[j] = product[j]
    # Plain Euler takes the engine's accelerations, the others its forces: not the same where its
    # solver has stopped short.
    if bound and desk[d.INTEGRATOR] == d.PLAIN:
        qacc = floats(desk[d.QACC], nv)
        for j in range(nv):
            answer[j] = h * qacc[j]
    else:
        for j in range(nv):
            trial[j] = h * (smooth[j] + constraint[j] if bound else smooth[j])
        for k in range(nv * nv):
            matrix[k] = inertia[k]
        if not solve(matrix, trial, answer, nv):
            return math.inf
    power = 0.0
    for j in range(nv):
        power += sand[j] * (start[j] + answer[j])
    return power
