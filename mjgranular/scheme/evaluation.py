"""Residual and Jacobian of the balance at a velocity, with the sand's forces there.

Three programs, each compiled once: one for each law and kind of surface finds the elements in the
sand (`sampling`), one for each law has their forces (`forces`), and all the rest of the scheme
calls these by address.
"""

from functools import partial

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.intrinsics import call_forces
from mjgranular.kernel.memory import BESIDE, LAW, WORKSPACE, table_at
from mjgranular.scheme.balance import add_stiffness, balance, find_motions, sum_wrenches
from mjgranular.scheme.dense import clear
from mjgranular.scheme.forces import FOLLOW, FRESH, LAST, NEXT, RESPOND


@compiled
def call_laws(table, w, task, eps, update, loose):
    """Set the wrenches of all sands that act together by a task of their laws, and the derivatives.

    `FOLLOW` keeps the derivatives. Return the greatest result.
    """
    for b in range(w.nbody):
        clear(w.wrench[b])
        if task != FOLLOW:
            clear(w.stiffness[b])
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
    mismatch = call_laws(table, w, task, eps, update, loose)
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
    mismatch = call_laws(table, w, RESPOND, eps, FRESH, eps)
    find_motions(w, w.velocity)
    turn = call_laws(table, w, FOLLOW, eps, LAST, 0.0)
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
    turn = call_laws(table, w, FOLLOW, eps, NEXT, 0.0)
    sum_wrenches(w)
    return balance(w, NEXT)[0], turn
