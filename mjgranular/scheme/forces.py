"""Forces on tiles of elements, their derivatives, and their sums per body."""

import math
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.fields import column, rows
from mjgranular.kernel.lanes import total_of
from mjgranular.kernel.memory import SCENE, WORKSPACE, held, records, table_at
from mjgranular.kernel.motion import read_motion, velocity_at
from mjgranular.kernel.vector import (
    Matrix,
    Vector,
    across,
    cross,
    diagonal,
    dot,
    norm,
    outer,
    vector,
)
from mjgranular.law.kernel import LawKernel
from mjgranular.law.multiplier import multiplier_of
from mjgranular.scheme import layout
from mjgranular.scheme.added import added_kernel, kink_kernel
from mjgranular.scheme.workspace import workspace_at
from mjgranular.scheme.wrenches import gravity_of

# Not literals: numba would compile a function for each of them.
FRESH, NEXT, SAME, LAST = (np.int64(n) for n in range(4))
"""Origins of multipliers: the velocity itself, a Newton step to it, the stored ones, the last
step."""
RESPOND, DAMP, FOLLOW, SUM = (np.int64(n) for n in range(4))
"""Tasks of a law's program (`forces_program`)."""

# In effect no softness [m/s], except at zero speed. Chosen: far below any motion, far above the
# square root of the smallest number.
_HARD = 1e-150


class Response(NamedTuple):
    """Response of a law to a velocity and a multiplier, to first order in both."""

    force: Vector  # [N]
    slope: Matrix  # minus its derivative by the velocity [N s/m]
    mismatch: float  # square of the difference between this multiplier and the velocity's


def move_kernel(kernel: LawKernel) -> Any:
    """Make the kernel `move(tile, motion, multipliers, eps, loose)`.

    It sets the velocities in a tile from its body's spatial velocity, and the multipliers.
    """
    lanes, update = kernel.lanes, kernel.multiplier.update
    vectors, all_vectors = column(Vector, lanes), rows(Vector, lanes)
    read, write, read_sample = vectors.read, vectors.write, column(kernel.samples, lanes).read
    read_all, write_all = all_vectors.read, all_vectors.write

    @compiled
    def move(tile, motion, multipliers, eps, loose):
        if multipliers == NEXT:
            for lane in range(lanes):
                before = read(tile, layout.VELOCITY * lanes + lane)
                p = read(tile, layout.MULTIPLIER * lanes + lane)
                sample = read_sample(tile, layout.SAMPLE * lanes + lane)
                v = velocity_at(motion, read(tile, layout.ARM * lanes + lane))
                p = update(sample, before, p, v - before, eps)
                write(tile, layout.MULTIPLIER * lanes + lane, p)
        arms = read_all(tile, layout.ARM * lanes)
        write_all(tile, layout.VELOCITY * lanes, velocity_at(motion, arms))
        if multipliers == FRESH:
            for lane in range(lanes):
                p = multiplier_of(read(tile, layout.VELOCITY * lanes + lane), loose)
                write(tile, layout.MULTIPLIER * lanes + lane, p)

    return move


@cache
def linearized(kernel: LawKernel, respond: Any) -> Any:
    """Make a kernel `linearize(sample, law, g, v, p, eps)` that returns a `Response`.

    With `w` the velocity's own multiplier, static resistance is F(w) at convergence. Until then
    `F(p) + F'(p) (w - p)` replaces it, which equals `F'(p) w`, since `F(p)` is `F'(p) p`.
    """
    own, by_velocity = kernel.multiplier.own, kernel.multiplier.by_velocity

    @partial(compiled, inline=True)
    def linearize(sample, law, g, v, p, eps):
        _, by_p, drag, by_v = respond(sample, law, g, v, p, eps)
        w = own(sample, v, eps)
        slope = -(by_p @ by_velocity(sample, v, p, eps)) - by_v
        return Response(by_p @ w + drag, slope, dot(w - p, w - p))

    return linearize


@cache
def unsoftened(kernel: LawKernel, respond: Any) -> Any:
    """Make a kernel `force_of(sample, law, g, v, led, eps)`: the law's force without softening.

    Static resistance takes the direction of the velocity `v`, drag the velocity `led`.
    """
    own = kernel.multiplier.own

    @partial(compiled, inline=True)
    def force_of(sample, law, g, v, led, eps):
        static, _, drag, _ = respond(sample, law, g, led, own(sample, v, _HARD), 0.0)
        return static + drag

    return force_of


@partial(compiled, inline=True)
def no_response(sample, law, g, v, p, eps):
    """Return the zero response of an unloaded element (see `LawKernel.complexity`)."""
    return vector(0.0, 0.0, 0.0), diagonal(0.0), vector(0.0, 0.0, 0.0), diagonal(0.0)


def in_tiles(kernel: LawKernel, of_one: Any, kind: Any, second: int) -> Any:
    """Make a kernel `respond(tile, law, g, eps)`, by the fastest variant valid in all lanes.

    `of_one` makes the kernel of one element, with results of a `kind`, from a law's `respond`. Its
    arguments are the velocity and what is in the row `second`: the multiplier, or without softening
    the velocity for drag.
    """
    lanes, complexity, soft = kernel.lanes, kernel.complexity, second == layout.MULTIPLIER
    read, read_sample = column(Vector, lanes).read, column(kernel.samples, lanes).read
    write = column(kind, lanes).write
    direction = layout.MULTIPLIER if soft else layout.VELOCITY

    def in_lanes(variant: Any) -> Any:
        respond_one = of_one(kernel, variant)

        @compiled
        def respond_all(tile, record, g, eps):
            law = held(record)
            for lane in range(lanes):
                sample = read_sample(tile, layout.SAMPLE * lanes + lane)
                v = read(tile, layout.VELOCITY * lanes + lane)
                p = read(tile, second * lanes + lane)
                result = respond_one(sample, law, g, v, p, eps)
                write(tile, layout.FORCE * lanes + lane, result)

        return respond_all

    respond_all = in_lanes(kernel.respond)
    if complexity is None:
        return respond_all
    respond_none, respond_simple = in_lanes(no_response), in_lanes(kernel.respond_simple)

    @compiled
    def respond(tile, law, g, eps):
        most = 0
        for lane in range(lanes):
            sample = read_sample(tile, layout.SAMPLE * lanes + lane)
            p = read(tile, direction * lanes + lane)
            most = max(most, complexity(sample, law, p, eps if soft else 0.0))
        if most == 0:
            respond_none(tile, law, g, eps)
        elif most == 1:
            respond_simple(tile, law, g, eps)
        else:
            respond_all(tile, law, g, eps)

    return respond


@cache
def resistance_kernel(kernel: LawKernel) -> Any:
    """Make a kernel `resist(tile, law, g, eps)`: `respond` without added mass."""
    return in_tiles(kernel, linearized, Response, layout.MULTIPLIER)


def force_kernel(kernel: LawKernel) -> Any:
    """Make the explicit scheme's kernel `force(tile, law, g, eps)`, with `eps` 0."""
    return in_tiles(kernel, unsoftened, Vector, layout.LED)


def damp_kernel(kernel: LawKernel) -> Any:
    """Make the kernel `damp(tile, law, g, eps)`: `respond` with secants in place of derivatives.

    See `secant`. Multipliers must be those of the velocities.
    """
    resist, lanes = resistance_kernel(kernel), kernel.lanes
    read, slopes = column(Vector, lanes).read, column(Matrix, lanes)
    read_slope, write_slope = slopes.read, slopes.write

    @compiled
    def damp(tile, record, g, eps):
        resist(tile, record, g, eps)
        for lane in range(lanes):
            v = read(tile, layout.VELOCITY * lanes + lane)
            speed = norm(v)
            # At zero velocity there is no secant; softened rest has its derivative there.
            moves = speed > _HARD
            inverse = 1.0 / speed if moves else 0.0
            force = inverse * read(tile, layout.FORCE * lanes + lane)
            slope = read_slope(tile, layout.SLOPE * lanes + lane)
            slope = secant(force, slope, inverse * v) if moves else slope
            write_slope(tile, layout.SLOPE * lanes + lane, slope)

    return with_momentum(kernel, damp)


def with_momentum(kernel: LawKernel, respond: Any) -> Any:
    """Extend a kernel for forces on a tile by added mass."""
    if kernel.added is None:
        return respond
    add_momentum = added_kernel(kernel)

    @compiled
    def respond_and_add(tile, record, g, eps):
        respond(tile, record, g, eps)
        add_momentum(tile)

    return respond_and_add


@partial(compiled, inline=True)
def add_total(array, first, v):
    """Add a vector (summed over lanes) to three numbers of an array."""
    array[first] += total_of(v.x)
    array[first + 1] += total_of(v.y)
    array[first + 2] += total_of(v.z)


@cache
def add_kernel(lanes: int) -> Any:
    """Make the kernel `add(tile, wrench, stiffness)`.

    It adds forces and derivatives to those of the body, and returns the greatest mismatch.
    """
    read, read_weight = rows(Vector, lanes).read, rows(float, lanes).read
    read_slope = rows(Matrix, lanes).read

    @compiled
    def add(tile, wrench, stiffness):
        weight, arm = read_weight(tile, layout.WEIGHT * lanes), read(tile, layout.ARM * lanes)
        force = weight * read(tile, layout.FORCE * lanes)
        add_total(wrench, 0, cross(arm, force))
        add_total(wrench, 3, force)
        # K on the point becomes B^T K B on the body, with B = (-[r]x, 1): r x K above K.
        below = weight * read_slope(tile, layout.SLOPE * lanes)
        above = cross(arm, below)
        add_row(stiffness, 0, arm, above.x)
        add_row(stiffness, 6, arm, above.y)
        add_row(stiffness, 12, arm, above.z)
        add_row(stiffness, 18, arm, below.x)
        add_row(stiffness, 24, arm, below.y)
        add_row(stiffness, 30, arm, below.z)
        mismatch = 0.0
        for lane in range(lanes):
            mismatch = max(mismatch, tile[layout.MISMATCH * lanes + lane])
        return mismatch

    return add


@partial(compiled, inline=True)
def add_row(stiffness, first, arm, row):
    """Add row (-[r]x, 1)."""
    add_total(stiffness, first, cross(arm, row))
    add_total(stiffness, first + 3, row)


@cache
def follow_kernel(kernel: LawKernel) -> Any:
    """Make the kernel `follow(tile, motion, wrench, eps, stores)`.

    It extrapolates forces by the derivatives to the body's motion, adds them to those of the body,
    and returns the greatest `turn`. `stores` is whether the tile keeps these forces.
    """
    lanes, turn = kernel.lanes, kernel.multiplier.turn
    vectors, slopes, all_weights = rows(Vector, lanes), rows(Matrix, lanes), rows(float, lanes)
    read_all, write_all, read_slopes = vectors.read, vectors.write, slopes.read
    read_weight = all_weights.read
    read, read_sample = column(Vector, lanes).read, column(kernel.samples, lanes).read
    read_slope = column(Matrix, lanes).read
    is_near_kink = None if kernel.added is None else kink_kernel(kernel)

    @compiled
    def follow(tile, motion, wrench, eps, stores):
        arm = read_all(tile, layout.ARM * lanes)
        change = velocity_at(motion, arm) - read_all(tile, layout.VELOCITY * lanes)
        slopes = read_slopes(tile, layout.SLOPE * lanes)
        force = read_all(tile, layout.FORCE * lanes) - slopes @ change
        if stores:
            write_all(tile, layout.FORCE * lanes, force)
        force = read_weight(tile, layout.WEIGHT * lanes) * force
        add_total(wrench, 0, cross(arm, force))
        add_total(wrench, 3, force)
        for lane in range(lanes):
            v = read(tile, layout.VELOCITY * lanes + lane)
            change_here = velocity_at(motion, read(tile, layout.ARM * lanes + lane)) - v
            sample = read_sample(tile, layout.SAMPLE * lanes + lane)
            slope = read_slope(tile, layout.SLOPE * lanes + lane)
            is_near = False
            if is_near_kink is not None:
                is_near = is_near_kink(tile, lane, change_here, slope @ change_here)
            tile[layout.TURN * lanes + lane] = 1.0 if is_near else turn(sample, v, change_here, eps)
        most = 0.0
        for lane in range(lanes):
            most = max(most, tile[layout.TURN * lanes + lane])
        return most

    return follow


@cache
def forces_program(kernel: LawKernel, law_dtype: np.dtype) -> Any:
    """Make the kernel `forces(address, work, task, eps, update, loose)`: a law's loops over tiles.

    The arguments are the address of the sand's table, that of the workspace that has the motions of
    the bodies and sums up forces, one of the tasks above, and those of `evaluate`. `SUM` adds the
    forces in the tiles. It returns the greatest mismatch, for `FOLLOW` the greatest turn
    (`law.kernel`).
    """
    move, damp = move_kernel(kernel), damp_kernel(kernel)
    respond = with_momentum(kernel, resistance_kernel(kernel))
    add, follow = add_kernel(kernel.lanes), follow_kernel(kernel)
    laws = records(law_dtype)  # the law is the first field of a scene

    @compiled
    def forces(address, work, task, eps, update, loose):
        table = table_at(address)
        own, w = workspace_at(table[WORKSPACE]), workspace_at(work)
        most = 0.0
        if task == FOLLOW:
            for i in range(own.count):
                body, stores = own.heads[i].body, update != LAST
                motion = read_motion(w.motion[body], 0)
                most = max(most, follow(own.tiles[i], motion, w.wrench[body], eps, stores))
        elif task == SUM:
            for i in range(own.count):
                body = own.heads[i].body
                add(own.tiles[i], w.wrench[body], w.stiffness[body])
        else:
            law, g = laws(table[SCENE], 1)[0], gravity_of(table)
            for i in range(own.count):
                tile, body = own.tiles[i], own.heads[i].body
                move(tile, read_motion(w.motion[body], 0), update, eps, loose)
                if task == DAMP:
                    damp(tile, law, g, eps)
                else:
                    respond(tile, law, g, eps)
                most = max(most, add(tile, w.wrench[body], w.stiffness[body]))
        return most

    return forces


# The secant of a force: damping that equals it at one velocity, and dissipates at any other.
# docs/scheme.md, "Damping", has the formula of the secant Z, for which Z v = -F(v). Both engines
# use it (`scheme.newton`, `warp.damping`).

# A force nearly perpendicular to the motion has no secant; its power counts as at least this share
# of |F| |v|. Chosen.
_LEAST_POWER = 0.02


@partial(compiled, inline=True)
def secant(force, slope, u):
    """Return Z of a force F / |v| [N s/m] that moves along u = v / |v|.

    The slope is minus the force's derivative by the velocity, a matrix [N s/m].
    """
    size, power = norm(force), -dot(force, u)
    resists = power > 0.0
    inverse = 1.0 / max(power, _LEAST_POWER * size) if resists else 0.0
    least = size if resists else 0.0
    # Y by its two eigenvalues.
    a = across(u)
    b = cross(u, a)
    by_a, by_b = slope @ a, slope @ b
    aa, bb, ab = dot(a, by_a), dot(b, by_b), 0.5 * (dot(a, by_b) + dot(b, by_a))
    middle, half = 0.5 * (aa + bb), 0.5 * (aa - bb)
    radius = math.sqrt(half * half + ab * ab)
    first, second = max(middle + radius, least), max(middle - radius, least)
    middle = 0.5 * (first + second)
    part = 0.5 * (first - second) / radius if radius > 0.0 else 0.0
    aa, bb, ab = middle + part * half, middle - part * half, part * ab
    turn = outer(aa * a + ab * b, a) + outer(ab * a + bb * b, b)
    return outer(inverse * force, force) + turn
