"""The way to the velocity at the end of the step, and how softly rest is held.

A static force that holds grows to its limit L over a small speed eps,

    f = -L v / sqrt(v^2 + eps^2),    v = eps P / sqrt(L^2 - P^2) under a load P,

which is far below anything visible, and grows with speeds that cancel in an element's own, whose
rounding a finer hold would drown in. Newton's method finds nearly all velocities. Where it is lost,
forces are taken for damping (`scheme.damping`) until it finds its way; and if it never does, the
step is made with that damping.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import cross, norm, read_vector, vector
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.balance import find_motions
from mjgranular.scheme.damping import damping_kernel
from mjgranular.scheme.dense import copy
from mjgranular.scheme.forces import FRESH, SAME
from mjgranular.scheme.layout import ARM, VELOCITY
from mjgranular.scheme.newton import Search, newton_kernel

# The softness of what is at rest [m/s]: what holds for a year moves 0.03 mm at 0.7 of its limit.
# Beside it, a share of the speeds that cancel in an element's own, the largest of all elements: a
# hold finer than their rounding would drown in it. Both chosen; robots need as many evaluations
# with a share of 1e-5 and 5 % fewer with 1e-4, where they hold less.
_SOFT = 1e-12
_SOFT_SHARE = 1e-6
# Residuals to be reached at rest and in motion, where rounding in what holds is larger, in parts of
# the momentum at hand. Chosen; at rest a step begins with the multipliers that velocities stand
# for, and after 1e-12, which is a tenth of the softness in one of gravity's 0.1 m/s a step, with
# wrong ones.
_AT_REST, _IN_MOTION = 1e-13, 1e-8
# Residual in the same parts above which Newton's method is lost. What is left below may be one of
# the law's own jumps. Chosen.
_LOST = 1e-3
_TURNED = 0.1  # square of the difference of a multiplier and its velocity's; chosen
# In parts of what the step would change without sand: speeds of which all elements may be at rest.
_SLOW = 1e-3
_BEGUN = 10.0  # how much softer a hold may be at the velocity found for that to be tried
# Of Newton's method, from rest, in motion, with a softer rest and after damping; and of damping.
# Not literals, for each of which numba would compile anew. Chosen.
_STEPS_NEAR, _STEPS, _STEPS_SOFT, _STEPS_FROM_NEAR = (np.int64(n) for n in (8, 40, 6, 12))
_STEPS_DAMPED = np.int64(8)


@cache
def solver_kernel(kernel: LawKernel, scene_dtype: np.dtype, most: int) -> Any:
    """Makes the kernel `find_velocity(table, w)` for a law and a surface.

    Args:
        kernel: of the law.
        scene_dtype: record of law and surface.
        most: evaluations after which a step that is lost is made with damping.
    """
    newton = newton_kernel(kernel, scene_dtype)
    damp = damping_kernel(kernel, scene_dtype)

    @compiled
    def find_velocity(table, w):
        """Solves for the velocity at the end of the step, `w.velocity`.

        Args:
            table: of addresses.
            w: the workspace, with the velocity at the start of the step.

        Returns:
            (evaluations, residual in parts of `w.scale`).
        """
        velocity = w.velocity
        fine = softness(w, velocity)
        coarse = speed_without_sand(w)
        goal = goal_of(fine) * w.scale
        done = 0
        if fastest(w) < _SLOW * coarse:
            # At rest what was is what will be.
            search = Search(FRESH, fine, fine, goal, _STEPS_NEAR, _TURNED)
            done, error = newton(table, w, search)
            if error <= goal:
                return done, error / w.scale

        # In motion the last acceleration, which is part of MuJoCo's state, is a good guess. What is
        # slower than the step may change is not taken to slide.
        known = True
        for j in range(w.nv):
            known = known and math.isfinite(w.qacc_warmstart[j])
        for j in range(w.nv):
            velocity[j] = w.start[j] + (w.h * w.qacc_warmstart[j] if known else 0.0)
        loose = max(coarse, fine)
        search = Search(FRESH, loose, fine, goal, _STEPS, math.inf)
        more, error = newton(table, w, search)
        done += more
        if goal < error <= _LOST * w.scale:
            # What begins to move in this step is rounded more than its velocity before can say.
            moved = softness(w, velocity)
            if moved > _BEGUN * fine:
                fine = moved
                goal = goal_of(fine) * w.scale
                loose = max(coarse, fine)
                search = Search(SAME, fine, fine, goal, _STEPS_SOFT, math.inf)
                more, error = newton(table, w, search)
                done += more
        if error <= _LOST * w.scale:
            return done, error / w.scale

        # Lost: damping leads near, and Newton's method begins anew from there.
        copy(velocity, w.start)
        while True:
            error = damp(table, w, fine, _STEPS_DAMPED)
            done += _STEPS_DAMPED
            if done >= most:
                return done, error / w.scale
            copy(w.near, velocity)
            search = Search(FRESH, fine, fine, goal, _STEPS_FROM_NEAR, math.inf)
            more, error = newton(table, w, search)
            done += more
            if error <= _LOST * w.scale:
                return done, error / w.scale
            copy(velocity, w.near)

    return find_velocity


@compiled
def goal_of(eps):
    """Residual to be reached, in parts of the momentum at hand."""
    return _AT_REST + _IN_MOTION * (eps - _SOFT) / eps


@compiled
def softness(w, velocity):
    """The fine softness at a velocity of the joints [m/s].

    With it grow the velocities of joints that cancel in that of a body: the rounding of its rest.
    Those of slides count by a bound of their sum, sqrt(n) times their norm: the axes of the world
    change nothing.
    """
    largest = 0.0
    last = -1
    for i in range(w.count):
        body = w.heads[i].body
        if body == last:
            continue
        last = body
        arm = size(lane_vector(w, w.tiles[i], ARM, 0))
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
    return _SOFT + _SOFT_SHARE * largest


@compiled
def speed_without_sand(w):
    """The greatest speed of an element at rest after a step without sand [m/s]."""
    for j in range(w.nv):
        w.trial[j] = w.h * w.qacc_smooth[j]
    find_motions(w, w.trial)
    most = 0.0
    for i in range(w.count):
        motion = w.motion[w.heads[i].body]
        turning, moving = read_vector(motion, 0), read_vector(motion, 3)
        for lane in range(w.lanes):
            arm = lane_vector(w, w.tiles[i], ARM, lane)
            most = max(most, norm(moving + cross(turning, arm)))
    return most


@compiled
def fastest(w):
    """The greatest speed of an element at the start of the step [m/s]."""
    most = 0.0
    for i in range(w.count):
        for lane in range(w.lanes):
            most = max(most, norm(lane_vector(w, w.tiles[i], VELOCITY, lane)))
    return most


@compiled
def lane_vector(w, tile, row, lane):
    """A vector of one element of a tile: three rows, one number of each."""
    lanes = w.lanes
    first = row * lanes + lane
    return vector(tile[first], tile[first + lanes], tile[first + 2 * lanes])


@compiled
def size(v):
    """|x| + |y| + |z|."""
    return abs(v.x) + abs(v.y) + abs(v.z)
