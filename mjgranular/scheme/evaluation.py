"""Residual and Jacobian of the balance at a velocity, with the sand's forces there.

Three programs, each compiled once: one for each law and kind of surface finds the elements in the
sand, one for each law has their forces, and all the rest of the scheme calls these by address.
"""

from functools import cache, partial
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.intrinsics import call_forces
from mjgranular.kernel.memory import BESIDE, LAW, OFF, SCENE, WORKSPACE, records, table_at
from mjgranular.kernel.motion import read_motion
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.added import momentum_kernel, turn_kernel
from mjgranular.scheme.balance import add_stiffness, balance, find_motions, sum_wrenches
from mjgranular.scheme.dense import clear
from mjgranular.scheme.forces import (
    FRESH,
    LAST,
    NEXT,
    add_kernel,
    damp_kernel,
    follow_kernel,
    move_kernel,
    resistance_kernel,
    with_momentum,
)
from mjgranular.scheme.layout import tile_size
from mjgranular.scheme.sampling import sampling_kernel
from mjgranular.scheme.workspace import workspace_at
from mjgranular.scheme.wrenches import gravity_of

# Not literals: numba would compile a function for each of them.
RESPOND, DAMP, FOLLOW, SUM = (np.int64(n) for n in range(4))
"""Tasks of a law's program (`forces_program`)."""


@cache
def sampling_program(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """Make the kernel of `Scheme.sampling`: it fills the workspace's tiles and sets `w.count`."""
    size, added = tile_size(kernel), kernel.added
    note_momentum = None if added is None else momentum_kernel(kernel)
    charge_turns = None if added is None else turn_kernel(kernel)

    @partial(compiled, inline=True)
    def note_head(table, w, body, place, g, tile, number, live, is_first, lead):
        w.heads[number].body, w.heads[number].live = body.body, live
        if note_momentum is not None:
            note_momentum(w, body.body, tile, live, is_first)

    sample_all = sampling_kernel(kernel, scene_dtype, note_head, compact=True)

    @compiled
    def find(address, lead):
        table = table_at(address)
        w = workspace_at(table[WORKSPACE])
        w.h, w.count = lead, 0
        if table[OFF] != 0:
            return 0
        w.count = sample_all(table, w, w.tiles.ctypes.data, 8 * size, 0.0)
        if charge_turns is not None:
            charge_turns(w)
        return w.count

    return find


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
                turn = follow(
                    own.tiles[i], read_motion(w.motion[body], 0), w.wrench[body], eps, stores
                )
                most = max(most, turn)
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


@compiled
def call_laws(table, task, eps, update, loose):
    """Have the laws of all sands that act together do a task; return the greatest result."""
    most, address = 0.0, table.ctypes.data
    while address != 0:
        sand = table_at(address)
        result = call_forces(sand[LAW], address, table[WORKSPACE], task, eps, update, loose)
        most = max(most, result)
        address = sand[BESIDE]
    return most


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
    mismatch = call_laws(table, task, eps, update, loose)
    sum_wrenches(w)
    error, of_losses = balance(w, update)
    add_stiffness(w)
    return error, max(mismatch, of_losses)


@partial(compiled, merge=True)
def evaluate_last(table, w, eps):
    """Set residual and Jacobian at `w.velocity`, with forces linearized at the motions in `w`.

    With `find_last_motions` these are the last step's, and the multipliers too. Return the size of
    the residual, the greatest mismatch and the greatest turn (`law.kernel`).
    """
    for b in range(w.nbody):
        clear(w.wrench[b])
        clear(w.stiffness[b])
    mismatch = call_laws(table, RESPOND, eps, FRESH, eps)
    find_motions(w, w.velocity)
    for b in range(w.nbody):
        clear(w.wrench[b])
    turn = call_laws(table, FOLLOW, eps, LAST, 0.0)
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
    turn = call_laws(table, FOLLOW, eps, NEXT, 0.0)
    sum_wrenches(w)
    return balance(w, NEXT)[0], turn
