"""Momentum of the sand that moves with elements (added mass), taken implicitly.

Derivation, equations (A2) to (A5) and proof of passivity: docs/laws/rft.md, "Sand that moves
along". No element takes energy from the sand, for any motion.
"""

import math
from functools import cache, partial
from typing import Any, NamedTuple

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.fields import column, rows
from mjgranular.kernel.lanes import choose
from mjgranular.kernel.motion import Motion, read_motion, velocity_at, write_motion
from mjgranular.kernel.vector import Matrix, Vector, cross, dot, norm, outer, transposed, vector
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.dense import add_scaled, clear
from mjgranular.scheme.layout import ARM, FORCE, SAMPLE, SLACK, SLOPE, VELOCITY, added_row

_NOTHING = 1e-150  # smallest speed to divide by


class Momentum(NamedTuple):
    """Momentum of moving sand, as stored in a tile: a = start - rate max(n.v', 0)."""

    normal: Vector
    rate: float  # m / h [kg/s]
    start: float  # m' s_b / h [N]


@partial(compiled, inline=True)
def one_of(mask, a, b):
    """Select a vector by lane: from `a` where the mask holds, else from `b`."""
    return vector(choose(mask, a.x, b.x), choose(mask, a.y, b.y), choose(mask, a.z, b.z))


@partial(compiled, inline=True)
def momentum_of(sand, v, drift, h):
    """Return the `Momentum` of moving sand (`AddedMass`) for an element's initial velocity.

    The velocities that the step finds are beside the true ones by the `drift` of its tree.
    """
    s = max(dot(sand.normal, v), 0.0)
    start = sand.before * s + sand.mass * dot(sand.normal, drift)
    return Momentum(sand.normal, sand.mass / h, max(start, 0.0) / h)


@partial(compiled, inline=True)
def drift_of(spin, h):
    """Return by how much turning moves a tree's center beside its frame's origin in a step [m/s].

    `spin` is the motion of the tree by the rotations of its free joint. What that adds to the
    velocity of the origin in a step of h [s], so that the center goes straight, moves no sand.
    """
    return -h * cross(spin.angular, spin.linear)


@partial(compiled, inline=True)
def most_given(n, force, v):
    """Return the bound on a in (A5), not negative, and the values that its derivative by v needs.

    Those are whether it is the bound of power; and 1 / (n.v), or 0 where the element trails. The
    resistance `force` at v and v itself may both be divided by the same speed.
    """
    s = dot(n, v)
    leads = s > _NOTHING
    compression, power = -dot(n, force), -dot(force, v)
    per_speed = choose(leads, 1.0 / choose(leads, s, 1.0), 0.0)
    by_power = power < compression * s
    bound = choose(by_power, power * per_speed, compression)
    return choose(bound > 0.0, bound, 0.0), by_power, per_speed


@partial(compiled, inline=True)
def share_after_turn(now, before):
    """Return by how much a body's sand slows down, from its energy now and before a turn (A4)."""
    return math.sqrt(before / now) if now > before else 1.0


@compiled
def motion_before_turn(w, body):
    """Set the motion of a body at present velocities, with the axes of the last step's start.

    Also the drift of its tree (`drift_of`), which is subtracted.

    Joint velocities are those that the last step moved with. `cdof_dot` gives the rate of change of
    the joint axes, so that a normal and a point's velocity, both fixed to the body, had the product
    n.(V + W x r) with this motion one step ago, to first order in the time step.
    """
    both = w.before[body]
    motion, spin = both[:6], both[6:]
    clear(both)
    k = body
    while k > 0 and w.body_dofnum[k] == 0:
        k = w.body_parentid[k]
    j = w.body_dofadr[k] + w.body_dofnum[k] - 1 if k > 0 else -1
    while j >= 0:
        add_scaled(motion, w.qvel[j], w.cdof[j])
        add_scaled(motion, -w.h * w.qvel[j], w.cdof_dot[j])
        if w.dof_spins[j] != 0:
            add_scaled(spin, w.qvel[j], w.cdof[j])
        j = w.dof_parentid[j]
    turning, before = read_motion(spin, 0), read_motion(motion, 0)
    drift = drift_of(turning, w.h)
    write_motion(spin, 0, Motion(turning.angular, drift))
    write_motion(motion, 0, Motion(before.angular, before.linear - drift))


@cache
def momentum_kernel(kernel: LawKernel) -> Any:
    """Make a kernel `note_momentum(w, body, tile, live, is_first)` that stores moving sand.

    It is called at the start of a step, when tiles hold the velocities of that time. It adds the
    energy of the first `live` elements' sand, now and before the body turned, to `w.energy`.
    """
    added, lanes, first = kernel.added, kernel.lanes, added_row(kernel) * kernel.lanes
    read, read_sample = column(Vector, lanes).read, column(kernel.samples, lanes).read
    write = column(Momentum, lanes).write

    @compiled
    def note_momentum(w, body, tile, live, is_first):
        if is_first:
            motion_before_turn(w, body)
        before, weld, h = read_motion(w.before[body], 0), w.body_weldid[body], w.h
        drift = read_motion(w.before[body], 6).linear
        for lane in range(lanes):
            v = read(tile, VELOCITY * lanes + lane)
            sand = added(read_sample(tile, SAMPLE * lanes + lane), v, h)
            s = max(dot(sand.normal, v), 0.0)
            had = max(dot(sand.normal, velocity_at(before, read(tile, ARM * lanes + lane))), 0.0)
            write(tile, first + lane, momentum_of(sand, v, drift, h))
            if lane < live:
                w.energy[weld, 0] += sand.before * s * s
                w.energy[weld, 1] += sand.before * had * had

    return note_momentum


@cache
def turn_kernel(kernel: LawKernel) -> Any:
    """Make a kernel `charge_turns(w)`: turning a body adds no energy to its sand.

    Energies are those of rigid bodies, and are cleared for the next step.
    """
    lanes = kernel.lanes
    start = (added_row(kernel) + 4) * lanes  # of `Momentum.start`
    starts = rows(float, lanes)
    read, write = starts.read, starts.write

    @compiled
    def charge_turns(w):
        for i in range(w.count):
            energy = w.energy[w.body_weldid[w.heads[i].body]]
            share = share_after_turn(energy[0], energy[1])
            write(w.tiles[i], start, share * read(w.tiles[i], start))
        for i in range(w.count):
            clear(w.energy[w.body_weldid[w.heads[i].body]])

    return charge_turns


@cache
def added_kernel(kernel: LawKernel) -> Any:
    """Make a kernel `add_momentum(tile)`: add a n to forces and derivatives of a tile."""
    lanes, first = kernel.lanes, added_row(kernel) * kernel.lanes
    vectors, slopes = rows(Vector, lanes), rows(Matrix, lanes)
    read, write = vectors.read, vectors.write
    read_slope, write_slope = slopes.read, slopes.write
    read_momentum, write_slack = rows(Momentum, lanes).read, rows(float, lanes).write

    @compiled
    def add_momentum(tile):
        sand, v = read_momentum(tile, first), read(tile, VELOCITY * lanes)
        force, slope = read(tile, FORCE * lanes), read_slope(tile, SLOPE * lanes)
        n = sand.normal
        s = dot(n, v)
        rate = choose(s > _NOTHING, sand.rate, 0.0)
        a = sand.start - rate * s
        # (A5), with the derivative of the bound by v', which is constant where it is zero.
        bound, by_power, per_speed = most_given(n, force, v)
        across = transposed(slope)
        of_power = per_speed * (across @ v - force - bound * n)
        by_v = one_of(bound > 0.0, one_of(by_power, of_power, across @ n), 0.0 * n)
        limited = a > bound
        write_slack(tile, first + SLACK * lanes, bound - a)
        a = choose(limited, bound, a)
        change = one_of(limited, by_v, -rate * n)
        write(tile, FORCE * lanes, force + a * n)
        write_slope(tile, SLOPE * lanes, slope - outer(n, change))

    return add_momentum


@cache
def kink_kernel(kernel: LawKernel) -> Any:
    """Make a kernel `is_near_kink(tile, lane, by_v, by_force)`: whether (A5) may begin or end.

    The last two arguments are changes of velocity and force.
    """
    lanes, first = kernel.lanes, added_row(kernel) * kernel.lanes
    read = column(Momentum, lanes).read

    @partial(compiled, inline=True)
    def is_near_kink(tile, lane, by_v, by_force):
        sand = read(tile, first + lane)
        most = norm(by_force) + 2.0 * sand.rate * norm(by_v)
        return sand.start > 0.0 and abs(tile[first + SLACK * lanes + lane]) <= most

    return is_near_kink
