"""Elements in the sand side by side, for the implicit scheme: blocks of up to `lanes` of one body.

A block is rows of numbers, one number for each lane. Loops over lanes are of a fixed length and of
arithmetic alone, and the compiler makes vector instructions of them; lanes that are left over hold
the last element once more, with no weight. A law with one lane has blocks of one element.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import column, held, summed
from mjgranular.kernel.motion import velocity_at
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.immersion import immerse_kernel
from mjgranular.scheme.layout import (
    ARM,
    BEND,
    FORCE,
    GRIP,
    IMMERSED,
    SLOPE,
    STIFFNESS,
    STRAY,
    VELOCITY,
    WEIGHT,
    WRENCH,
    block_size,
)

_ANSWER = 13  # numbers that `respond` gives

# Not literals, for each of which numba would compile a function anew.
FRESH, NEXT, SAME = (np.int64(n) for n in (0, 1, 2))
"""Where grips come from: the velocity itself, a step of Newton's method to it, what is there."""


@dataclass(frozen=True)
class BlockKernels:
    """Loops over the blocks of a law's elements, for one kind of surface.

    Attributes:
        size: numbers in a block.
        immerse: kernel `immerse(table, w)`: fills the workspace's blocks with the elements in the
            sand; how many blocks.
        move: kernel `move(block, motion, grips, eps, loose)`: velocities in a block from its body's
            spatial velocity, and grips.
        respond: kernel `respond(block, law, g, eps)`: forces and derivatives.
        add: kernel `add(block, wrench, stiffness)`: adds these to those of the body; the greatest
            bend.
        follow: kernel `follow(block, motion, wrench, eps)`: the forces that the derivatives say for
            the body's motion, and adds these to those of the body; the greatest `stray`.
    """

    size: int
    immerse: Any
    move: Any
    respond: Any
    add: Any
    follow: Any


@cache
def block_kernels(kernel: LawKernel, scene_dtype: np.dtype) -> BlockKernels:
    """The loops over a law's blocks.

    Args:
        kernel: of the law.
        scene_dtype: record of law and surface.
    """
    return BlockKernels(
        block_size(kernel),
        immerse_kernel(kernel, scene_dtype),
        move_kernel(kernel),
        respond_kernel(kernel),
        add_kernel(kernel.lanes),
        follow_kernel(kernel),
    )


def move_kernel(kernel: LawKernel) -> Any:
    """See `BlockKernels.move`."""
    lanes, grip = kernel.lanes, kernel.grip
    three = column(3, lanes)
    read, write, read_numbers = three.read, three.write, column(5 + kernel.numbers, lanes).read

    @compiled
    def move(block, motion, grips, eps, loose):
        if grips == NEXT:
            for lane in range(lanes):
                x, y, z = read(block, ARM * lanes + lane)
                u = read(block, VELOCITY * lanes + lane)
                p = read(block, GRIP * lanes + lane)
                immersed = read_numbers(block, IMMERSED * lanes + lane)
                v = velocity_at(motion, x, y, z)
                c = (v[0] - u[0], v[1] - u[1], v[2] - u[2])
                write(block, GRIP * lanes + lane, grip(immersed, u, p, c, eps))
                write(block, VELOCITY * lanes + lane, v)
            return
        for lane in range(lanes):
            x, y, z = read(block, ARM * lanes + lane)
            write(block, VELOCITY * lanes + lane, velocity_at(motion, x, y, z))
        if grips == FRESH:
            for lane in range(lanes):
                x, y, z = read(block, VELOCITY * lanes + lane)
                scale = 1.0 / math.sqrt(x * x + y * y + z * z + loose * loose)
                write(block, GRIP * lanes + lane, (scale * x, scale * y, scale * z))

    return move


def respond_kernel(kernel: LawKernel) -> Any:
    """See `BlockKernels.respond`."""
    lanes, simple = kernel.lanes, kernel.simple
    read, read_numbers = column(3, lanes).read, column(5 + kernel.numbers, lanes).read
    write = column(_ANSWER, lanes).write

    def in_lanes(respond: Any) -> Any:
        @compiled
        def respond_all(block, record, g, eps):
            law = held(record)
            for lane in range(lanes):
                v = read(block, VELOCITY * lanes + lane)
                p = read(block, GRIP * lanes + lane)
                immersed = read_numbers(block, IMMERSED * lanes + lane)
                write(block, FORCE * lanes + lane, respond(immersed, law, g, v, p, eps))

        return respond_all

    respond_all = in_lanes(kernel.respond)
    if simple is None:
        return respond_all
    respond_simple = in_lanes(kernel.respond_simple)

    @compiled
    def respond_either(block, law, g, eps):
        others = 0
        for lane in range(lanes):
            p = read(block, GRIP * lanes + lane)
            immersed = read_numbers(block, IMMERSED * lanes + lane)
            others += 0 if simple(immersed, p) else 1
        if others == 0:
            respond_simple(block, law, g, eps)
        else:
            respond_all(block, law, g, eps)

    return respond_either


@cache
def add_kernel(lanes: int) -> Any:
    """See `BlockKernels.add`."""
    read, read_nine = column(3, lanes).read, column(9, lanes).read
    write_six, write_all = column(6, lanes).write, column(36, lanes).write
    add_six, add_all = column(6, 1).add, column(36, 1).add
    wrench_of, total = wrench_kernel(lanes), summed(lanes)

    @partial(compiled, inline=True)
    def stiffness_of(block, lane):
        """K on the point becomes B^T K B on the body, with B = (-[r]x, 1)."""
        x, y, z = read(block, ARM * lanes + lane)
        k0, k1, k2, k3, k4, k5, k6, k7, k8 = read_nine(block, SLOPE * lanes + lane)
        m = block[WEIGHT * lanes + lane]
        k0, k1, k2, k3, k4, k5 = m * k0, m * k1, m * k2, m * k3, m * k4, m * k5
        k6, k7, k8 = m * k6, m * k7, m * k8
        return (
            stiffness_row(y * k6 - z * k3, y * k7 - z * k4, y * k8 - z * k5, x, y, z)
            + stiffness_row(z * k0 - x * k6, z * k1 - x * k7, z * k2 - x * k8, x, y, z)
            + stiffness_row(x * k3 - y * k0, x * k4 - y * k1, x * k5 - y * k2, x, y, z)
            + stiffness_row(k0, k1, k2, x, y, z)
            + stiffness_row(k3, k4, k5, x, y, z)
            + stiffness_row(k6, k7, k8, x, y, z)
        )

    @compiled
    def add_one(block, wrench, stiffness):
        add_six(wrench, 0, wrench_of(block, 0))
        add_all(stiffness, 0, stiffness_of(block, 0))
        return block[BEND]

    @compiled
    def add_lanes(block, wrench, stiffness):
        for lane in range(lanes):
            write_six(block, WRENCH * lanes + lane, wrench_of(block, lane))
            write_all(block, STIFFNESS * lanes + lane, stiffness_of(block, lane))
        for row in range(6):
            wrench[row] += total(block, (WRENCH + row) * lanes)
        for row in range(36):
            stiffness[row] += total(block, (STIFFNESS + row) * lanes)
        bend = 0.0
        for lane in range(lanes):
            bend = max(bend, block[BEND * lanes + lane])
        return bend

    return add_one if lanes == 1 else add_lanes


@cache
def wrench_kernel(lanes: int) -> Any:
    """Makes a kernel `wrench_of(block, lane)`: moment and force about the centre of the tree."""
    read = column(3, lanes).read

    @partial(compiled, inline=True)
    def wrench_of(block, lane):
        x, y, z = read(block, ARM * lanes + lane)
        fx, fy, fz = read(block, FORCE * lanes + lane)
        m = block[WEIGHT * lanes + lane]
        fx, fy, fz = m * fx, m * fy, m * fz
        return y * fz - z * fy, z * fx - x * fz, x * fy - y * fx, fx, fy, fz

    return wrench_of


@cache
def follow_kernel(kernel: LawKernel) -> Any:
    """See `BlockKernels.follow`."""
    lanes, stray, numbers = kernel.lanes, kernel.stray, column(5 + kernel.numbers, kernel.lanes)
    read, write, read_nine = column(3, lanes).read, column(3, lanes).write, column(9, lanes).read
    write_six, wrench_of, total = column(6, lanes).write, wrench_kernel(lanes), summed(lanes)
    read_numbers = numbers.read

    @compiled
    def follow(block, motion, wrench, eps):
        most = 0.0
        for lane in range(lanes):
            x, y, z = read(block, ARM * lanes + lane)
            ux, uy, uz = read(block, VELOCITY * lanes + lane)
            fx, fy, fz = read(block, FORCE * lanes + lane)
            k0, k1, k2, k3, k4, k5, k6, k7, k8 = read_nine(block, SLOPE * lanes + lane)
            immersed = read_numbers(block, IMMERSED * lanes + lane)
            vx, vy, vz = velocity_at(motion, x, y, z)
            cx, cy, cz = vx - ux, vy - uy, vz - uz
            fx -= k0 * cx + k1 * cy + k2 * cz
            fy -= k3 * cx + k4 * cy + k5 * cz
            fz -= k6 * cx + k7 * cy + k8 * cz
            write(block, FORCE * lanes + lane, (fx, fy, fz))
            write_six(block, WRENCH * lanes + lane, wrench_of(block, lane))
            block[STRAY * lanes + lane] = stray(immersed, (ux, uy, uz), (cx, cy, cz), eps)
        for row in range(6):
            wrench[row] += total(block, (WRENCH + row) * lanes)
        for lane in range(lanes):
            most = max(most, block[STRAY * lanes + lane])
        return most

    return follow


@partial(compiled, inline=True)
def stiffness_row(a, b, c, x, y, z):
    """A row (a, b, c) (-[r]x, 1) of a 6 x 6 matrix."""
    return y * c - z * b, z * a - x * c, x * b - y * a, a, b, c
