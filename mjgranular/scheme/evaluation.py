"""Residual and Jacobian of the balance at a velocity, with the sand's forces there.

Three programs, each compiled once: one for each law and kind of surface finds the elements in the
sand, one for each law has their forces, and all the rest of the scheme calls these by address.
"""

from functools import cache
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.intrinsics import call_forces, call_step
from mjgranular.kernel.memory import LAW, SAMPLING, SCENE, WORKSPACE, records, table_at
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.balance import (
    add_stiffness,
    balance,
    find_motions,
    motion_of,
    sum_wrenches,
)
from mjgranular.scheme.dense import clear
from mjgranular.scheme.forces import (
    FRESH,
    LAST,
    NEXT,
    add_kernel,
    damp_kernel,
    follow_kernel,
    move_kernel,
    respond_kernel,
    sample_kernel,
)
from mjgranular.scheme.workspace import workspace_at
from mjgranular.scheme.wrenches import gravity_of

# Not literals: numba would compile a function for each of them.
RESPOND, DAMP, FOLLOW = (np.int64(n) for n in range(3))
"""Tasks of a law's program (`forces_program`)."""


@cache
def sampling_program(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """Make the kernel of `Scheme.sampling`: it fills the workspace's tiles and sets `w.count`."""
    sample = sample_kernel(kernel, scene_dtype)

    @compiled
    def find(address, lead):
        table = table_at(address)
        w = workspace_at(table[WORKSPACE])
        sample(table, w)
        return w.count

    return find


@cache
def forces_program(kernel: LawKernel, law_dtype: np.dtype) -> Any:
    """Make the kernel `forces(address, task, eps, update, loose)`: a law's loops over all tiles.

    The arguments are the address of the table, one of the tasks above, and those of `evaluate`. It
    returns the greatest mismatch, for `FOLLOW` the greatest turn (`law.kernel`).
    """
    move, respond, damp = move_kernel(kernel), respond_kernel(kernel), damp_kernel(kernel)
    add, follow = add_kernel(kernel.lanes), follow_kernel(kernel)
    laws = records(law_dtype)  # the law is the first field of a scene

    @compiled
    def forces(address, task, eps, update, loose):
        table = table_at(address)
        w = workspace_at(table[WORKSPACE])
        most = 0.0
        if task == FOLLOW:
            for i in range(w.count):
                body, stores = w.heads[i].body, update != LAST
                turn = follow(w.tiles[i], motion_of(w, body), w.wrench[body], eps, stores)
                most = max(most, turn)
        else:
            law, g = laws(table[SCENE], 1)[0], gravity_of(table)
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
    call_step(table[SAMPLING], table.ctypes.data, w.h)


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
def evaluate_last(table, w, eps):
    """Set residual and Jacobian at `w.velocity`, with forces linearized at the motions in `w`.

    With `find_last_motions` these are the last step's, and the multipliers too. Return the size of
    the residual, the greatest mismatch and the greatest turn (`law.kernel`).
    """
    for b in range(w.nbody):
        clear(w.wrench[b])
        clear(w.stiffness[b])
    mismatch = call_forces(table[LAW], table.ctypes.data, RESPOND, eps, FRESH, eps)
    find_motions(w, w.velocity)
    for b in range(w.nbody):
        clear(w.wrench[b])
    turn = call_forces(table[LAW], table.ctypes.data, FOLLOW, eps, LAST, 0.0)
    sum_wrenches(w)
    error, of_losses = balance(w, FRESH)
    add_stiffness(w)
    return error, max(mismatch, of_losses), turn


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
