"""Strategy of the search for the velocity at the end of the step, and the softness of rest.

A force that holds a load P grows to its limit L over a small speed eps: docs/scheme.md, "Softness".

Where elements hold, Newton's method starts from what each mobilized in the last step, which the
velocities at its end still have: P / L = v / sqrt(v^2 + eps^2). These are seen in that step's
configuration (`balance.find_last_motions`); in today's they are disturbed by joints that turn.
Newton's method finds nearly all velocities. Where it fails, forces are treated as damping
(`newton.damp`), from which it starts over, and then the solution is followed from soft forces to
hard ones (`continuation`).
"""

import math
from functools import partial

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import BESIDE, WORKSPACE, table_at
from mjgranular.kernel.vector import cross, norm, read_vector, vector
from mjgranular.scheme.balance import find_last_motions, find_motions
from mjgranular.scheme.dense import copy
from mjgranular.scheme.forces import FRESH, LAST, SAME
from mjgranular.scheme.layout import ARM
from mjgranular.scheme.newton import DAMPINGS, Search, damp, newton
from mjgranular.scheme.workspace import workspace_at

# The softness of rest [m/s]: a body held for a year moves 0.03 mm at 0.7 of its limit. Added to it
# is a share of the speeds that cancel in an element's own, the largest of all elements, since their
# rounding would dominate a smaller softness. Both chosen; robots need as many evaluations with a
# share of 1e-5, and 5 % fewer with 1e-4, where they hold less well.
_SOFT = 1e-12
_SOFT_SHARE = 1e-6
# Target residuals at rest and in motion, where rounding in holding forces is larger, relative to
# the momentum. Chosen; at rest a step starts with the multipliers of its velocities, and after
# 1e-12, a tenth of the softness for gravity's 0.1 m/s per step, with wrong ones.
_AT_REST, _IN_MOTION = 1e-13, 1e-8
UNFINISHED = 1e-6  # relative residual above which a step counts as unfinished; chosen
_NEAR = 1e-3  # relative residual below which one more try is made with a larger softness; chosen
_TURNED = 0.1  # square of the difference between a multiplier and its velocity's; chosen
# Speed, relative to what the step would change without sand, below which all elements may hold.
# Chosen: a smaller one takes more evaluations for robots that stand, a larger one for robots that
# are driven at random.
_SLOW = 0.1
_BEGUN = 10.0  # largest ratio of the softness at the velocity found for which it is retried
# Limits for Newton's method: from rest, in motion, with another softness, and after damping. Not
# literals: numba would compile a function for each. Chosen.
_STEPS_NEAR, _STEPS, _STEPS_SOFT, _STEPS_FROM_NEAR = map(np.int64, (8, 40, 6, 12))
_ROUNDS = 3  # of damping and Newton's method; chosen
# For `continuation`: the softness at its beginning, in parts of the speeds, and the factor by which
# it grows if there is no solution; the least ratio of one softness to the last, and the steps of
# Newton's method after which it falls; the residual of solutions on the way; and the softness [m/s]
# at which there is next to no force. All chosen.
_SOFTEST, _SOFTER, _SHARE, _FEW, _ON_PATH, _NO_FORCE = 3.0, 100.0, 0.1, 4, 1e-7, 1e9


@partial(compiled, merge=True)
def find_velocity(table, w):
    """Solve for `w.velocity` at the end of the step; return evaluations and relative residual."""
    velocity = w.velocity
    fine = softness(table, w, velocity)
    # The greatest speed of an element initially at rest after a step without sand.
    for j in range(w.nv):
        w.trial[j] = w.h * w.qacc_smooth[j]
    find_motions(w, w.trial)
    coarse = fastest(table, w)
    goal = goal_of(fine) * w.scale
    done = 0
    find_last_motions(w)
    if fastest(table, w) < _SLOW * coarse:
        # The same elements hold as in the last step.
        copy(velocity, w.start)
        done, error = newton(table, w, Search(LAST, fine, fine, goal, _STEPS_NEAR, _TURNED))
        if error <= goal:
            return done, error / w.scale

    # In motion the last acceleration, which is part of MuJoCo's state, is a good guess.
    # Elements slower than the step may change are not assumed to slide.
    known = True
    for j in range(w.nv):
        known = known and math.isfinite(w.qacc_warmstart[j])
    for j in range(w.nv):
        velocity[j] = w.start[j] + (w.h * w.qacc_warmstart[j] if known else 0.0)
    loose = max(coarse, fine)
    more, error = newton(table, w, Search(FRESH, loose, fine, goal, _STEPS, math.inf))
    done += more
    if goal < error <= _NEAR * w.scale:
        # Bodies that start to move in this step have more rounding than their velocity showed.
        moved = softness(table, w, velocity)
        if moved > _BEGUN * fine:
            fine = moved
            goal = goal_of(fine) * w.scale
            loose = max(coarse, fine)
            more, error = newton(table, w, Search(SAME, fine, fine, goal, _STEPS_SOFT, math.inf))
            done += more
    if error <= UNFINISHED * w.scale:
        return done, error / w.scale

    # Damping leads close to the solution, and Newton's method starts over from there. At last the
    # step is made with damping: each element's force opposes the velocity that results. All in one
    # loop, since a second call of `damp` would be compiled again.
    copy(velocity, w.start)
    for trial in range(_ROUNDS + 1):
        if trial == _ROUNDS:
            more, error = continuation(table, w, loose, fine, goal, w.evaluations - done - DAMPINGS)
            done += more
            if error <= UNFINISHED * w.scale:
                break
        error = damp(table, w, fine)
        done += DAMPINGS
        if trial == _ROUNDS or done >= w.evaluations:
            break
        copy(w.near, velocity)
        more, error = newton(table, w, Search(FRESH, fine, fine, goal, _STEPS_FROM_NEAR, math.inf))
        done += more
        if error <= UNFINISHED * w.scale:
            break
        copy(velocity, w.near)
    return done, error / w.scale


@compiled
def continuation(table, w, coarse, fine, goal, most):
    """Follow the solution from a large softness, where it is nearly linear, down to `fine`.

    Return the evaluations and the residual. After `most` evaluations it is infinite, and the
    velocity the one at the softness reached, or at the start if there is none.
    """
    velocity, near, before = w.velocity, w.near, w.found
    copy(near, w.start)
    find_motions(w, near)
    eps, share = _SOFTEST * (fastest(table, w) + coarse), _SHARE
    reached = last = math.inf  # the softness at `near` and at `before`
    done = 0
    while done < most and (reached < math.inf or eps < _NO_FORCE):
        # Extrapolated linearly: what holds moves in proportion to the softness.
        beyond = (eps - reached) / (reached - last) if last < math.inf else 0.0
        for j in range(w.nv):
            velocity[j] = near[j] + beyond * (near[j] - before[j])
        loose = eps if last < math.inf else min(reached, _SOFTER * eps)
        target = goal if eps == fine else _ON_PATH * w.scale
        steps = _STEPS_SOFT if reached < math.inf else _STEPS
        more, error = newton(table, w, Search(FRESH, loose, eps, target, steps, math.inf))
        done += more
        if error <= UNFINISHED * w.scale:
            if eps == fine:
                return done, error
            copy(before, near)
            copy(near, velocity)
            last, reached = reached, eps
            share = max(_SHARE, share**1.5) if more <= _FEW else share
        elif reached < math.inf:
            share = math.sqrt(share)
        else:
            eps *= _SOFTER
            continue
        eps = max(fine, share * reached)
    copy(velocity, near)
    return done, math.inf


@compiled
def goal_of(eps):
    """Return the target residual, relative to the momentum."""
    return _AT_REST + _IN_MOTION * (eps - _SOFT) / eps


@compiled
def softness(table, w, velocity):
    """Return the final softness at a joint velocity [m/s].

    It grows with the joint velocities that cancel in that of a body: its rest has their rounding.
    """
    largest, address = 0.0, table.ctypes.data
    while address != 0:
        sand = table_at(address)
        largest = max(largest, cancelled(w, workspace_at(sand[WORKSPACE]), velocity))
        address = sand[BESIDE]
    return _SOFT + _SOFT_SHARE * largest


@compiled
def cancelled(w, own, velocity):
    """Return the largest sum of speeds that may cancel in that of an element of one sand [m/s].

    Slide joints count by a bound of their sum, sqrt(n) times their norm, which does not depend on
    the world's axes.
    """
    largest, last = 0.0, -1
    for i in range(own.count):
        body = own.heads[i].body
        if body == last:
            continue
        last = body
        arm = size(lane_vector(own, own.tiles[i], ARM, 0))
        while body > 0 and w.body_dofnum[body] == 0:
            body = w.body_parentid[body]
        j = w.body_dofadr[body] + w.body_dofnum[body] - 1 if body > 0 else -1
        total, slides, square = 0.0, 0.0, 0.0
        while j >= 0:
            turning, moving = read_vector(w.cdof[j], 0), read_vector(w.cdof[j], 3)
            if size(turning) == 0.0:
                slides += 1.0
                square += (velocity[j] * size(moving)) ** 2
            else:
                total += abs(velocity[j]) * (arm * size(turning) + size(moving))
            j = w.dof_parentid[j]
        largest = max(largest, total + math.sqrt(slides * square))
    return largest


@compiled
def fastest(table, w):
    """Return the greatest speed of an element at the motions of the bodies [m/s]."""
    most, address = 0.0, table.ctypes.data
    while address != 0:
        sand = table_at(address)
        own = workspace_at(sand[WORKSPACE])
        for i in range(own.count):
            motion = w.motion[own.heads[i].body]
            turning, moving = read_vector(motion, 0), read_vector(motion, 3)
            for lane in range(own.lanes):
                arm = lane_vector(own, own.tiles[i], ARM, lane)
                most = max(most, norm(moving + cross(turning, arm)))
        address = sand[BESIDE]
    return most


@compiled
def lane_vector(w, tile, row, lane):
    """Return a vector of one element of a tile: three rows, one number of each."""
    lanes = w.lanes
    first = row * lanes + lane
    return vector(tile[first], tile[first + lanes], tile[first + 2 * lanes])


@compiled
def size(v):
    """Return |x| + |y| + |z|."""
    return abs(v.x) + abs(v.y) + abs(v.z)
