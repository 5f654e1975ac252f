"""What a law computes at every step, and where it is told to compute it.

A law is three scalar kernels over its elements. `immerse` looks at where an element is: depth, the
point where force acts, and whatever of the geometry the forces need, as numbers. `resist` gives the
force at a velocity, for a scheme that takes forces as they come. `respond` gives the force and its
derivative with rest made soft over a small speed, for a scheme that solves for the velocity at the
end of the step. The loops over elements belong to the schemes.
"""

from __future__ import annotations

import math
from collections import namedtuple
from dataclasses import dataclass
from typing import Any

from mjgranular.kernel.compiled import compiled

Pose = namedtuple("Pose", ["position", "rotation", "com", "tree", "motion"])
Pose.__doc__ = """Where a body is and how it moves, world axes.

Attributes:
    position: of the body's frame [m], 3 numbers.
    rotation: of the body's frame, 9 numbers, row by row.
    com: centre of mass of the body [m].
    tree: centre of mass of its kinematic tree [m], the centre of `motion`.
    motion: spatial velocity, angular [rad/s] before linear [m/s].
"""

GEOMETRY_SIZE = 18
"""The most numbers that a law may keep of an immersed element's geometry."""


@dataclass(frozen=True)
class LawKernel:
    """The scalar kernels of a law under one kind of surface.

    Attributes:
        elements: kernel `elements(address, size)`: the law's elements at an address
            (`kernel.memory.records`), with fields `body` and `slot`, ordered by body.
        immerse: kernel `immerse(element, pose, law, surface, g)`; a tuple of numbers: depth of the
            element's deepest point [m] (not positive: dry, and the rest is not read), immersed
            length of a rod [m] or 0, the point where force acts [m] (x, y, z), and up to
            `GEOMETRY_SIZE` numbers of its geometry.
        resist: kernel `resist(immersed, law, g, v, d)`: the force [N] (x, y, z) on the element
            that `immerse` described, from the velocity of its point [m/s] for what depends on the
            direction of motion (`v`) and for what grows with speed (`d`, which may lead).
        respond: kernel `respond(immersed, law, g, v, eps, reach, shares)`, with the numbers of
            `immersed` in an array, to be taken one by one: the force and, row by
            row, the nine numbers of minus its derivative by velocity [N s/m]. Static resistance,
            which jumps where the motion turns round, is made soft by `grip`, with which it is to
            be written; a law may have two such limits, each with its share.
        speeds: kernel `speeds(immersed, v, c)`: the two speeds that `grip` is given, and how they
            change with a change `c` of the velocity; `speed_of_all` where there is one.
    """

    elements: Any
    immerse: Any
    resist: Any
    respond: Any
    speeds: Any
    numbers: int


@compiled
def in_world(pose, x, y, z):
    """World coordinates of a direction in the frame of a body."""
    r = pose.rotation
    return (
        r[0] * x + r[1] * y + r[2] * z,
        r[3] * x + r[4] * y + r[5] * z,
        r[6] * x + r[7] * y + r[8] * z,
    )


@compiled
def grip(speed, limit, eps, reach, share):
    """Dry friction with a limit, made soft: limit v / sqrt(v^2 + eps^2).

    The derivative along the motion falls to nothing where the limit is reached, and Newton's method
    leaps from there. So it takes the share of the limit that the element was last found to need
    for one of the two factors phi in 1 - phi^2: that is right at the solution and stiff on the way
    (the primal-dual method of Chan, Golub and Mulet, SIAM J. Sci. Comput. 20 (1999), for the same
    function in image processing).

    Below `reach`, the softness it was last solved for, an element is taken to hold: it is looked at
    with the force it had then, at the speed that gives this force now, and goes on from there along
    the tangent.

    Args:
        speed: not negative [m/s].
        limit: of the friction [N].
        eps: speed at which it has grown to 0.7 of its limit [m/s].
        reach: at least `eps` [m/s].
        share: of the limit that was needed; negative where that is not known.

    Returns:
        (gain, along, across) [N s/m]: the force is `-gain v`, and minus its derivative `along` in
        the direction of motion, `across` at right angles to it.
    """
    if speed < reach and eps < reach:
        held = speed * (eps / reach)
        size = math.sqrt(held * held + eps * eps)
        across = limit / size
        along = across * (eps / size) * (eps / size)
        return across * (eps / reach) + along * (1.0 - eps / reach), along, across
    size = math.sqrt(speed * speed + eps * eps)
    across = limit / size
    along = across * (eps / size) * (eps / size)
    if share >= 0.0:
        along = across * (1.0 - share * (speed / size))
    return across, along, across


@compiled
def new_share(speed, change, eps, share):
    """The share of its limit that an element needs after a step of Newton's method.

    Args:
        speed: before the step [m/s].
        change: of the speed [m/s].
        eps: as in `grip`.
        share: that the step was made with.
    """
    size = math.sqrt(speed * speed + eps * eps)
    if share < 0.0:
        share = speed / size
    return min(max((speed + (1.0 - share * (speed / size)) * change) / size, 0.0), 1.0)


@compiled
def speed_of_all(immersed, v, c):
    """Speed and its change for a change `c` of velocity, where one limit holds against both."""
    speed = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    change = v[0] * c[0] + v[1] * c[1] + v[2] * c[2]
    return speed, 0.0, change / speed if speed > 0.0 else 0.0, 0.0
