"""Sand that is moved along with elements: its momentum, taken implicitly.

An element that drives into sand takes along some of what is in front of it, a mass m in the
direction n (`law.kernel.AddedMass`). Of that, m' was moved along a step ago, and the rest was at
rest. By the end of the step all of it moves as the element does, and the element has paid for that:

    h f = -n (m n.v' - m' n.v)

This is linear in v', with m n n^T beside the inertias of the bodies in the Jacobian. Sand that is
left behind keeps its momentum. Nothing is carried from step to step: m and m' follow from where the
element is and the velocity that has brought it there.

Sand in motion pushes on what slows down. As m is at least m', that gives no more than it loses,

    h f n.v' <= m' (n.v)^2 / 2 - m (n.v')^2 / 2 .
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.fields import column, rows
from mjgranular.kernel.vector import Matrix, Vector, dot, outer
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.layout import FORCE, SAMPLE, SLOPE, VELOCITY, added_row


class Momentum(NamedTuple):
    """What a tile keeps of sand that is moved along: f = (start - rate n.v') n."""

    normal: Vector
    rate: float  # m / h [kg/s]
    start: float  # m' n.v / h [N]


@cache
def momentum_kernel(kernel: LawKernel) -> Any:
    """Makes a kernel `note_momentum(tile, live, h)`: looks at what elements move along.

    It is asked at the start of a step of `h` seconds, when velocities in tiles are those. Of the
    first `live` elements it returns the energy of the sand that moves with them [J].
    """
    added, lanes, first = kernel.added, kernel.lanes, added_row(kernel) * kernel.lanes
    read, read_sample = column(Vector, lanes).read, column(kernel.samples, lanes).read
    write = column(Momentum, lanes).write

    @compiled
    def note_momentum(tile, live, h):
        energy = 0.0
        for lane in range(lanes):
            v = read(tile, VELOCITY * lanes + lane)
            sand = added(read_sample(tile, SAMPLE * lanes + lane), v, h)
            speed = dot(sand.normal, v)
            momentum = sand.before * speed
            write(tile, first + lane, Momentum(sand.normal, sand.mass / h, momentum / h))
            energy += 0.5 * momentum * speed if lane < live else 0.0
        return energy

    return note_momentum


@cache
def added_kernel(kernel: LawKernel) -> Any:
    """Makes a kernel `add_momentum(tile)`: adds this to forces and derivatives of a tile."""
    lanes, first = kernel.lanes, added_row(kernel) * kernel.lanes
    vectors, slopes = rows(Vector, lanes), rows(Matrix, lanes)
    read, write = vectors.read, vectors.write
    read_slope, write_slope = slopes.read, slopes.write
    read_momentum = rows(Momentum, lanes).read

    @compiled
    def add_momentum(tile):
        sand = read_momentum(tile, first)
        n = sand.normal
        force = (sand.start - sand.rate * dot(n, read(tile, VELOCITY * lanes))) * n
        write(tile, FORCE * lanes, read(tile, FORCE * lanes) + force)
        slope = read_slope(tile, SLOPE * lanes) + outer(sand.rate * n, n)
        write_slope(tile, SLOPE * lanes, slope)

    return add_momentum
