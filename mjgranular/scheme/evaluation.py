"""Residual and Jacobian of the balance at a velocity, with the sand's forces there."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import SCENE, records
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
from mjgranular.scheme.wrenches import gravity_of


@cache
def evaluation_kernel(kernel: LawKernel, scene_dtype: np.dtype, *, damped: bool = False) -> Any:
    """Make the kernel `evaluate(table, w, eps, update, loose)`.

    Args:
        kernel: kernel of the law.
        scene_dtype: record of law and surface.
        damped: whether the Jacobian contains the secants of forces instead of their derivatives.
    """
    of_tiles = tile_kernels(kernel, scene_dtype)
    move, add = of_tiles.move, of_tiles.add
    respond = of_tiles.damp if damped else of_tiles.respond
    scene_records = records(scene_dtype)

    @compiled
    def evaluate(table, w, eps, update, loose):
        """Set residual and Jacobian at `w.velocity`, and the forces on elements in their tiles.

        Args:
            table: table of addresses.
            w: the workspace.
            eps: softness [m/s].
            update: origin of multipliers: `NEXT`, those after a Newton step to this velocity;
                `FRESH` and `SAME` as for a `Search`.
            loose: softness of the first multipliers, `Search.loose` [m/s].

        Returns:
            (size of the residual, greatest mismatch).
        """
        scene = scene_records(table[SCENE], 1)
        law = scene[0].law
        g = gravity_of(table)
        find_motions(w, w.velocity)
        for b in range(w.nbody):
            clear(w.wrench[b])
            clear(w.stiffness[b])
        mismatch = 0.0
        for i in range(w.count):
            tile, body = w.tiles[i], w.heads[i].body
            move(tile, motion_of(w, body), update, eps, loose)
            respond(tile, law, g, eps)
            mismatch = max(mismatch, add(tile, w.wrench[body], w.stiffness[body]))
        sum_wrenches(w)
        error, of_losses = balance(w, update)
        add_stiffness(w)
        return error, max(mismatch, of_losses)

    return evaluate


@cache
def following_kernel(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """Make the kernel `follow_all(w, eps)`; arguments as for `evaluation_kernel`."""
    follow = tile_kernels(kernel, scene_dtype).follow

    @compiled
    def follow_all(w, eps):
        """Set the residual at `w.velocity` with forces extrapolated by the Jacobian.

        The forces that `evaluate` computed at the velocity before are replaced by these.

        Returns:
            (size of the residual, greatest turn: `law.kernel`).
        """
        find_motions(w, w.velocity)
        for b in range(w.nbody):
            clear(w.wrench[b])
        turn = 0.0
        for i in range(w.count):
            body = w.heads[i].body
            turn = max(turn, follow(w.tiles[i], motion_of(w, body), w.wrench[body], eps))
        sum_wrenches(w)
        return balance(w, NEXT)[0], turn

    return follow_all
