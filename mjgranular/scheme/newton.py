"""Newton's method for the balance of momentum: elements, bodies and constraints at a velocity.

Unknown are the velocity at the end of the step and the elements' grips, which are eliminated
element by element (`law.multiplier`), so that nv equations are left.
"""

from __future__ import annotations

import math
from collections import namedtuple
from functools import cache
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import SCENE, floats, records
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme import desk as d
from mjgranular.scheme.balance import (
    add_bodies,
    body_motions,
    clear,
    motion_of,
    solve,
    sum_wrenches,
    weigh,
)
from mjgranular.scheme.constraints import leave
from mjgranular.scheme.forces import NEXT, tile_kernels
from mjgranular.scheme.layout import head_records
from mjgranular.scheme.wrenches import gravity_of

# Square of the difference of a grip and its velocity's: where the force may be taken for the law's,
# and where the residual may be trusted to fall along a step. Chosen.
_BEND, _STRAIGHT = 1e-8, 1e-6
_STUCK = 4  # steps that do not halve the residual
# How far forces that follow by their derivative may be from the law's: the square of that, in parts
# of the limit, and where it is worth a look, by the velocities of the joints instead of those of
# the elements. Chosen: in 2,990 steps of four robots driven at random what the law itself would
# have left was 1e-9 of the momentum at hand in the median, and 3e-6 in 99 of 100.
_MISFIT, _NEARLY = 1e-8, 1e-6
_SHORTEST = 0.1  # of a step
_NOTHING = 1e-150  # a speed that may be divided by

Way = namedtuple("Way", ["grips", "loose", "eps", "goal", "steps", "turn"])
Way.__doc__ = """How Newton's method is to go from where it begins.

Attributes:
    grips: to begin with: `FRESH` those of the velocity itself with the softness `loose`, `SAME`
        those that are there.
    loose: see there [m/s].
    eps: softness [m/s].
    goal: residual to be reached.
    steps: at most.
    turn: bend at which to give up.
"""


@cache
def newton_kernel(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """Makes the kernel `newton(table, desk, room, count, h, way)` for a law and a surface.

    Args:
        kernel: of the law.
        scene_dtype: record of law and surface.
    """
    of_blocks = tile_kernels(kernel, scene_dtype)
    move, respond, add, follow = of_blocks.move, of_blocks.respond, of_blocks.add, of_blocks.follow
    scene_records, size = records(scene_dtype), of_blocks.size

    @compiled
    def evaluate(table, desk, room, velocity, count, h, eps, grips, loose):
        """Residual and its derivative at a velocity.

        Forces on the elements are left in their blocks.

        Args:
            table: of addresses.
            desk: the solver's.
            room: the solver's.
            velocity: at the end of the step, nv numbers.
            count: of blocks of elements in the sand.
            h: time step [s].
            eps: softness [m/s].
            grips: `NEXT` those after a step of Newton's method to this velocity, `SAME` those
                that are there, `FRESH` those of the velocity itself with the softness `loose`.
            loose: see there [m/s].

        Returns:
            (norm of the residual, greatest bend).
        """
        nbody = desk[d.NBODY]
        motion = floats(room.motion, 6 * nbody)
        wrench = floats(room.own, 6 * nbody)
        stiffness = floats(room.stiffness, 36 * nbody)
        heads = head_records(desk[d.HEADS], count)
        scene = scene_records(table[SCENE], 1)
        law = scene[0].law
        g = gravity_of(table)
        body_motions(desk, room, velocity)
        clear(wrench)
        clear(stiffness)
        bend = 0.0
        for i in range(count):
            block = floats(desk[d.BLOCKS] + 8 * size * i, size)
            b = 6 * heads[i].body
            move(block, motion_of(motion, heads[i].body), grips, eps, loose)
            respond(block, law, g, eps)
            turn = add(block, wrench[b : b + 6], stiffness[6 * b : 6 * b + 36])
            bend = max(bend, turn)
        weigh(desk, room, velocity, h)
        add_bodies(desk, room, h)
        error, turn = leave(desk, room, velocity, h, grips)
        return error, max(bend, turn)

    @compiled
    def follow_all(desk, room, velocity, count, h, eps):
        """The sand's forces at a velocity, by their derivative where they were last evaluated.

        Returns:
            (norm of the residual with these forces, greatest stray).
        """
        nbody = desk[d.NBODY]
        motion = floats(room.motion, 6 * nbody)
        wrench = floats(room.own, 6 * nbody)
        heads = head_records(desk[d.HEADS], count)
        body_motions(desk, room, velocity)
        clear(wrench)
        stray = 0.0
        for i in range(count):
            block = floats(desk[d.BLOCKS] + 8 * size * i, size)
            b = 6 * heads[i].body
            away = follow(block, motion_of(motion, heads[i].body), wrench[b : b + 6], eps)
            stray = max(stray, away)
        weigh(desk, room, velocity, h)
        sum_wrenches(desk, room, h)
        return leave(desk, room, velocity, h, NEXT)[0], stray

    @compiled
    def newton(table, desk, room, count, h, way):
        """Newton's method from `room.velocity`, which ends where it got to.

        Steps are taken whole: grips that turn are how it finds out what holds and what slides, and
        the residual grows on the way. Only where grips have stopped turning, and the residual grows
        still, is there a kink between here and there, and half of the step is taken back.

        The last step is not looked at again. Where it is so short that the law is a straight line
        over it (`misfit`), forces follow by their derivative: the momenta balance with them, and
        they are the law's to within what is allowed. That the momenta balance is looked at, for one
        of MuJoCo's constraints may begin or end on the way.

        Args:
            table: of addresses.
            desk: the solver's.
            room: the solver's.
            count: of blocks of elements in the sand.
            h: time step [s].
            way: to go.

        Returns:
            (evaluations, residual; infinite where it says nothing yet).
        """
        nv = desk[d.NV]
        velocity = floats(room.velocity, nv)
        change = floats(room.change, nv)
        residual = floats(room.residual, nv)
        matrix = floats(room.matrix, nv * nv)
        error, bend = evaluate(table, desk, room, velocity, count, h, way.eps, way.grips, way.loose)
        done = 1
        stuck = 0
        while (
            done <= way.steps
            and stuck < _STUCK
            and bend < way.turn
            and (error > way.goal or bend > _BEND)
        ):
            if not solve(matrix, residual, change, nv):
                break
            for j in range(nv):
                velocity[j] -= change[j]
            if misfit(far(change, velocity), bend) <= _NEARLY:
                left, stray = follow_all(desk, room, velocity, count, h, way.eps)
                if left <= way.goal and misfit(stray, bend) <= _MISFIT:
                    return done, left
            found, bend = evaluate(table, desk, room, velocity, count, h, way.eps, NEXT, 0.0)
            done += 1
            back = 0.5
            while not found < error and bend < _STRAIGHT and back > _SHORTEST and done <= way.steps:
                for j in range(nv):
                    velocity[j] += back * change[j]
                back *= 0.5
                found, bend = evaluate(table, desk, room, velocity, count, h, way.eps, NEXT, 0.0)
                done += 1
            stuck += bend < _STRAIGHT and not found < 0.5 * error
            error = found
        return done, error if bend <= _BEND else math.inf

    return newton


@compiled
def misfit(stray, bend):
    """What is lost where a law is taken for a straight line over a step of Newton's method.

    A stress turns with the grip, which has to make up for its bend; and speed and grip change
    together, in a product of which only the parts of first order are known.

    Args:
        stray: square of the change, in parts of the speeds over which the law turns.
        bend: square of the difference between the grip and the velocity's own.

    Returns:
        Square of the force that is lost, in parts of the limit.
    """
    away = math.sqrt(stray)
    return (bend + away * (away + math.sqrt(bend))) ** 2


@compiled
def far(change, velocity):
    """Square of the size of a change of velocity, in parts of what has become of it."""
    part, whole = 0.0, _NOTHING
    for j in range(len(velocity)):
        part += change[j] * change[j]
        whole += velocity[j] * velocity[j]
    return part / whole
