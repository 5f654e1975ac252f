"""What a law computes at every step, and where it is told to compute it.

A law is four scalar kernels over its elements. `immerse` looks at where an element is: depth, the
point where force acts, and whatever of the geometry the forces need, as numbers. `resist` gives the
force at a velocity, for a scheme that takes forces as they come. `respond` gives the force and its
derivative with rest made soft over a small speed, for a scheme that solves for the velocity at the
end of the step; `grip` is what that scheme keeps of static resistance on the way. The loops over
elements belong to the schemes.
"""

from __future__ import annotations

import math
from collections import namedtuple
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

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


@compiled
def no_level(surface, pose):
    """Of a surface that is no plane, or for a law that does not skim."""
    return 0.0


@compiled
def look_closer(element, level):
    """Where nothing but `immerse` can tell whether an element is in the sand."""
    return math.inf


@dataclass(frozen=True)
class Sheets:
    """A law's elements side by side under a surface that is a plane, and kernels for all of a few.

    A sheet holds `LawKernel.lanes` elements of one body, in the order of the elements; it is rows
    of numbers, one number for each lane. Lanes left over at a body's end hold elements on which no
    force acts. A *block* is rows of what is known of the elements at an instant.

    Attributes:
        lay: function `lay(elements)`: the sheets, shape (number of sheets, rows, lanes), body by
            body. It stands in the table in place of the elements.
        rows: of a sheet.
        skim: kernel `skim(sheet, level, depths)`: writes the depths of the deepest points [m], from
            what `LawKernel.level` gave; how many of them are not negative or zero.
        immerse: function `immerse(first)` that makes a kernel
            `immerse(sheet, pose, level, up, law, g, block)`: writes the numbers that
            `LawKernel.immerse` gives to the block, from index `first` on; `up` is the plane's
            normal in the world. Where an element is dry no force may come of them.
        resist: function `resist(first, velocity, drag, force)` that makes a kernel
            `resist(block, law, g)`: what `LawKernel.resist` gives, from and to the rows of the
            block that begin at these indices.
    """

    lay: Any
    rows: int
    skim: Any
    immerse: Any
    resist: Any


@partial(compiled, inline=True)
def stray_of_all(immersed, v, c, eps):
    """How far a change of velocity leads, beside the speed (see `LawKernel.stray`)."""
    far = c[0] * c[0] + c[1] * c[1] + c[2] * c[2]
    return far / (v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + eps * eps)


@dataclass(frozen=True)
class LawKernel:
    """The scalar kernels of a law under one kind of surface.

    Attributes:
        elements: kernel `elements(address, size)`: the law's elements at an address
            (`kernel.memory.records`), with fields `body` and `slot`, ordered by body.
        immerse: kernel `immerse(element, pose, law, surface, g)`; a tuple of numbers: depth of the
            element's deepest point [m] (not positive: dry, and the rest is not read), immersed
            length of a rod [m] or 0, the point where force acts [m] (x, y, z), and `numbers` of its
            geometry.
        resist: kernel `resist(immersed, law, g, v, d)`: the force [N] (x, y, z) on the element
            that `immerse` described, from the velocity of its point [m/s] for what depends on the
            direction of motion (`v`) and for what grows with speed (`d`, which may lead).
        respond: kernel `respond(immersed, law, g, v, p, eps)`, with what `immerse` gave. Static
            resistance, which jumps where the motion turns round, is a function of the element's
            *grip* p = v / sqrt(v^2 + eps^2), which is unknown beside v (see `next_grip`). It gives
            the force at `v` [N] (3), as it is where the linearized equation for p holds; minus its
            derivative by velocity, row by row (9) [N s/m]; and the bend, the square of the
            difference between `p` and the velocity's own grip. Where that is nothing both are the
            law's.
        grip: kernel `grip(immersed, v, p, c, eps)`: the grip after a step of Newton's method that
            changes the velocity `v` by `c`; `grip_of_all` where one limit holds against motion in
            all directions.
        numbers: how many `immerse` gives of the geometry, behind the point.
        stray: kernel `stray(immersed, v, c, eps)`: the square of a change `c` of the velocity `v`,
            in parts of the speeds over which the force turns; `stray_of_all` where it turns with
            the velocity as a whole.
        lanes: how many elements of a body `respond` and `grip` are asked for side by side. More
            than one pays where a body has many elements and both kernels, with all that they
            call, are `compiled(..., inline=True)` and pure arithmetic: then they are done in the
            lanes of the processor's vector unit, all branches for all elements.
        simple: kernel `simple(immersed, p)`: whether `respond_simple` would do. Both or none.
        respond_simple: a quicker `respond`, for blocks of elements that are all simple.
        level: kernel `level(surface, pose)`: what `skim` needs to know of the surface, once a body;
            a surface's own `level`, if it has one.
        skim: kernel `skim(element, level)`: the depth of the element's deepest point [m] at a
            fraction of the cost of `immerse`, which is asked where it is positive. For laws that
            cut bodies into many elements, most of which are above the sand.
        sheets: the same for several elements at once; then `level` has to be there, and `immerse`,
            `resist` and `skim` are not asked.
    """

    elements: Any
    immerse: Any
    resist: Any
    respond: Any
    grip: Any
    numbers: int
    stray: Any = stray_of_all
    lanes: int = 1
    simple: Any = None
    respond_simple: Any = None
    level: Any = no_level
    skim: Any = look_closer
    sheets: Sheets | None = None

    def lay(self, elements: np.ndarray) -> np.ndarray:
        """The elements as a program reads them: sheets, or the records that they are."""
        return elements if self.sheets is None else self.sheets.lay(elements)


_HERE = (0.0, 0.0, 0.0)
WORLD = Pose(_HERE, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), _HERE, _HERE, (0.0,) * 6)
"""Of the world itself."""


@partial(compiled, inline=True)
def in_world(pose, x, y, z):
    """World coordinates of a direction in the frame of a body."""
    r = pose.rotation
    return (
        r[0] * x + r[1] * y + r[2] * z,
        r[3] * x + r[4] * y + r[5] * z,
        r[6] * x + r[7] * y + r[8] * z,
    )


@partial(compiled, inline=True)
def next_grip(v, p, c, eps):
    """The part of a limit that is called on, p = v / sqrt(v^2 + eps^2), after a Newton step.

    Friction with a limit, -limit v / sqrt(v^2 + eps^2), has next to no derivative along the motion
    where the limit is reached, and Newton's method for v leaps from there. So v and p are both
    unknown, and `sqrt(v^2 + eps^2) p = v` is linearized: equal at the solution, stiff on the way
    (the primal-dual method of Chan, Golub and Mulet, SIAM J. Sci. Comput. 20 (1999), for the same
    function in image processing).

    Args:
        v: velocity before the step [m/s], 3 numbers.
        p: grip before the step, 3 numbers.
        c: change of the velocity [m/s], 3 numbers.
        eps: softness [m/s], the speed at which friction has grown to 0.7 of its limit.

    Returns:
        Three numbers, the size of which is not more than 1.
    """
    size = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + eps * eps)
    scale = 1.0 / size
    growth = (v[0] * c[0] + v[1] * c[1] + v[2] * c[2]) * scale
    x = (v[0] + c[0] - growth * p[0]) * scale
    y = (v[1] + c[1] - growth * p[1]) * scale
    z = (v[2] + c[2] - growth * p[2]) * scale
    total = x * x + y * y + z * z
    if total > 1.0:
        scale = 1.0 / math.sqrt(total)
        x, y, z = scale * x, scale * y, scale * z
    return x, y, z


@partial(compiled, inline=True)
def grip_of_all(immersed, v, p, c, eps):
    """`next_grip` for a law with one limit against motion in all directions."""
    return next_grip(v, p, c, eps)
