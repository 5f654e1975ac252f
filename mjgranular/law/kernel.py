"""The kernels of a law.

A law is two functions of an element. `sample` computes its place in the sand: depth, the point of
action, and other inputs of the force. `respond` computes the force and its derivatives. The loops
over elements belong to the schemes.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import check_compiled, compiled
from mjgranular.kernel.fields import packed
from mjgranular.kernel.lanes import aligned
from mjgranular.kernel.motion import Motion
from mjgranular.kernel.vector import Matrix, Vector, transposed
from mjgranular.law.multiplier import ONE_LIMIT, Multiplier


class Pose(NamedTuple):
    """Pose and motion of a body, world axes."""

    position: Vector  # of the body's frame [m]
    rotation: Matrix  # of the body's frame: `rotation @ v` is in the world
    com: Vector  # center of mass of the body [m]
    tree: Vector  # center of mass of its kinematic tree [m], the center of `motion`
    motion: Motion  # spatial velocity


class Level(NamedTuple):
    """A plane of sand in the frame of a body."""

    normal: Vector
    depth: float  # of the frame's origin [m]


class AddedMass(NamedTuple):
    """Sand that moves with an element, as a mass in one direction."""

    mass: float  # at the element's place at the start of the step [kg]
    before: float  # part of it that was there one step ago [kg]; the rest was at rest
    normal: Vector  # direction, a unit vector, world


@dataclass(frozen=True)
class LawKernel:
    """The kernels of a law under one kind of surface.

    Attributes:
        element: `NamedTuple` of what the kernels read of an element: fields of the law's elements,
            declared as in `kernel.fields`.
        samples: `NamedTuple` that describes an element in the sand: first `depth` of its deepest
            point [m], immersed `length` of a rod [m] or 0, `point` where force acts [m]; then other
            inputs of `respond`.
        sample: kernel `sample(element, pose, law, surface, g)`: returns one of `samples`. If its
            depth is not positive the element is dry, and the rest is not read.
        respond: kernel `respond(sample, law, g, v, p, eps)`: static resistance F(p) [N] for the
            friction multiplier `p` (`law.multiplier`), proportional to the size of `p`, and its
            derivative by `p`; and drag [N] for the velocity `v` of the point [m/s], and its
            derivative by `v`. If `eps` is 0 only the forces are used, and are the law's own; else
            rest is softened over that speed, and discontinuities of the law are ramps.
        multiplier: kind of its multiplier.
        lanes: number of elements of a body that `respond` processes side by side. More than one
            pays if a body has many elements and the kernel, with all that it calls, is
            `compiled(..., inline=True)` and pure arithmetic: then it runs in the lanes of the
            processor's vector unit, all branches for all elements.
        probe: probe of the surface, if that is an infinite plane; then `cull` is called first.
        cull: kernel `cull(element, level)`: depth of the element's deepest point [m] under a plane
            (`Level`), at a fraction of the cost of `sample`. For laws that divide bodies into many
            elements, most of which are above the sand.
        side_by_side: whether `cull` and `sample` take all lanes at once, as `kernel.lanes`.
        complexity: kernel `complexity(sample, law, p, eps)`: 0 if the element has no force, 1 if
            `respond_simple` is sufficient, else 2. If `eps` is 0 the multiplier may have any size.
        respond_simple: a faster `respond`, for lanes that are all simple.
        added: kernel `added(sample, v, h)`: the sand that moves with the element (`AddedMass`),
            from the velocity of its point at the start of the step [m/s] and the time step [s]. Its
            inertia needs the implicit scheme.
    """

    element: type
    samples: type
    sample: Any
    respond: Any
    multiplier: Multiplier = ONE_LIMIT
    lanes: int = 1
    probe: Any = None
    cull: Any = None
    side_by_side: bool = False
    complexity: Any = None
    respond_simple: Any = None
    added: Any = None

    def __post_init__(self) -> None:
        first = getattr(self.samples, "_fields", ())[:3]
        if first != ("depth", "length", "point"):
            raise InputError(
                f"the first fields of {self.samples.__name__} must be depth, length and point, in "
                f"this order, not {', '.join(first) or 'none'}"
            )
        check_compiled("LawKernel: sample", self.sample)
        check_compiled("LawKernel: respond", self.respond)

    def pack(self, elements: np.ndarray) -> np.ndarray:
        """Return the elements as a program reads them, shape (tiles, numbers of an element, lanes).

        A tile is up to `lanes` elements of one body side by side. Unused lanes at a body's end
        repeat its last element.
        """
        numbers = packed(elements, self.element)
        tiles = [np.zeros((0, numbers.shape[1], self.lanes))]
        for count in np.bincount(elements["slot"]):
            mine, numbers = numbers[:count], numbers[count:]
            mine = np.concatenate([mine, np.repeat(mine[-1:], -count % self.lanes, axis=0)])
            shape = (-1, self.lanes, numbers.shape[1])
            tiles.append(mine.reshape(shape).transpose(0, 2, 1))
        return aligned(np.concatenate(tiles))


@cache
def level_kernel(probe: Any) -> Any:
    """Make a kernel `level(surface, pose)`: a plane in the frame of a body (`Level`)."""

    @compiled
    def level(surface, pose):
        depth, normal = probe(surface, pose.position)
        return Level(transposed(pose.rotation) @ normal, depth)

    return level
