"""Residual and Jacobian of the balance at a velocity, with the sand's forces there.

All that depends on law and surface is one program for each of them; the rest of the scheme is
compiled once and calls it by its address.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.intrinsics import call_forces
from mjgranular.kernel.memory import LAW, SCENE, WORKSPACE, records, table_at
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.balance import (
    add_stiffness,
    balance,
    find_motions,
    motion_of,
    sum_wrenches,
)
from mjgranular.scheme.dense import clear
from mjgranular.scheme.forces import NEXT, tile_kernels
from mjgranular.scheme.workspace import workspace_at
from mjgranular.scheme.wrenches import gravity_of

# Not literals: numba would compile a function for each of them.
FIND, RESPOND, DAMP, FOLLOW = (np.int64(n) for n in range(4))
"""Tasks of a law's program (`forces_program`)."""


@cache
def forces_program(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """Make the kernel `forces(address, task, eps, update, loose)`: a law's loops over all tiles.

    The arguments are the address of the table, one of the tasks above, and those of `evaluate`. It
    returns the greatest mismatch, for `FOLLOW` the greatest turn (`law.kernel`).
    """
    of_tiles = tile_kernels(kernel, scene_dtype)
    sample, move, add, follow = of_tiles.sample, of_tiles.move, of_tiles.add, of_tiles.follow
    respond, damp = of_tiles.respond, of_tiles.damp
    scene_records = records(scene_dtype)

    @compiled
    def forces(address, task, eps, update, loose):
        table = table_at(address)
        w = workspace_at(table[WORKSPACE])
        most = 0.0
        if task == FIND:
            sample(table, w)
        elif task == FOLLOW:
            for i in range(w.count):
                body = w.heads[i].body
                most = max(most, follow(w.tiles[i], motion_of(w, body), w.wrench[body], eps))
        else:
            scene = scene_records(table[SCENE], 1)
            law, g = scene[0].law, gravity_of(table)
            for i in range(w.count):
                tile, body = w.tiles[i], w.heads[i].body
                move(tile, motion_of(w, body), update, eps, loose)
                if task == DAMP:
                    damp(tile, law, g, eps)
                else:
                    respond(tile, law, g, eps)
                most = max(most, add(tile, w.wrench[body], w.stiffness[body]))
        return most

    return forces


@compiled
def find_elements(table, w):
    """Fill the workspace's tiles with the elements in the sand, and set `w.count`."""
    call_forces(table[LAW], table.ctypes.data, FIND, 0.0, NEXT, 0.0)


@compiled
def evaluate(table, w, task, eps, update, loose):
    """Set residual and Jacobian at `w.velocity`, and the forces on elements in their tiles.

    The task is `RESPOND`, or `DAMP` for secants of forces in the Jacobian instead of derivatives;
    `eps` is the softness [m/s]. `update` is the origin of multipliers: `NEXT`, those after a Newton
    step to this velocity; `FRESH` and `SAME` as for a `Search`, whose `loose` is given too. Return
    the size of the residual, and the greatest mismatch.
    """
    find_motions(w, w.velocity)
    for b in range(w.nbody):
        clear(w.wrench[b])
        clear(w.stiffness[b])
    mismatch = call_forces(table[LAW], table.ctypes.data, task, eps, update, loose)
    sum_wrenches(w)
    error, of_losses = balance(w, update)
    add_stiffness(w)
    return error, max(mismatch, of_losses)


@compiled
def follow_all(table, w, eps):
    """Set the residual at `w.velocity` with forces extrapolated by the Jacobian.

    These replace the forces that `evaluate` computed at the velocity before. Return the size of the
    residual, and the greatest turn (`law.kernel`).
    """
    find_motions(w, w.velocity)
    for b in range(w.nbody):
        clear(w.wrench[b])
    turn = call_forces(table[LAW], table.ctypes.data, FOLLOW, eps, NEXT, 0.0)
    sum_wrenches(w)
    return balance(w, NEXT)[0], turn
