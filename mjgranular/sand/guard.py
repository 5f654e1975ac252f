"""Guard around a scheme's program: a snapshot of the state, and the check that needs it."""

from __future__ import annotations

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.intrinsics import call_step
from mjgranular.kernel.memory import STATE, STATE_SIZE, UPDATE, floats, table_at
from mjgranular.kernel.snapshot import kept_time, save_snapshot
from mjgranular.relief.grid import TIME
from mjgranular.scheme.status import BAD_STATE, FINE
from mjgranular.scheme.wrenches import is_bad, take_back_wrenches, withdraw_wrenches


@compiled
def forget_after_reset(table):
    """Clear a surface's memory if time has gone back: the simulation starts over."""
    state, time = floats(table[STATE], table[STATE_SIZE]), kept_time(table)
    if time < state[TIME]:
        for k in range(len(state)):
            state[k] = 0.0
    state[TIME] = time


@compiled
def guarded_step(program, address, lead):
    """Call a scheme's program, and keep the state that it is called with if that is good.

    A surface with memory is updated after it. Return what the program returns, or `BAD_STATE`.
    """
    table = table_at(address)
    if is_bad(table):
        return BAD_STATE
    save_snapshot(table)
    if table[UPDATE] == 0:
        return call_step(program, address, lead)
    forget_after_reset(table)
    failed = call_step(program, address, lead)
    if failed == FINE:
        call_step(table[UPDATE], address, 0.0)
    return failed


@compiled
def finish_step(address):
    """Remove the wrenches after `mj_step2`; return `FINE`, or `BAD_STATE` if the state is bad."""
    take_back_wrenches(address)
    return BAD_STATE if is_bad(table_at(address)) else FINE


@compiled
def withdraw(address):
    """Remove what is left of the wrenches that a Sand wrote; return `FINE`."""
    withdraw_wrenches(table_at(address))
    return FINE
