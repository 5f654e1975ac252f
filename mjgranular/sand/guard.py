"""What stands around a scheme's program: a state to go back to, and a look whether it is needed."""

from __future__ import annotations

from functools import cache
from typing import Any

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.keep import keep
from mjgranular.kernel.memory import table_at
from mjgranular.scheme.status import BAD_STATE, FINE
from mjgranular.scheme.wrenches import is_bad, take_back_wrenches, withdraw_wrenches


@cache
def guarded_program(program: Any) -> Any:
    """A scheme's program, called alike, that keeps the state it is called with if it is good."""

    @compiled
    def guarded(address, lead):
        table = table_at(address)
        if is_bad(table):
            return BAD_STATE
        keep(table)
        return program(address, lead)

    return guarded


@compiled
def finish_step(address):
    """Takes the wrenches back when `mj_step2` is through; `FINE`, or `BAD_STATE` if it was not."""
    take_back_wrenches(address)
    return BAD_STATE if is_bad(table_at(address)) else FINE


@compiled
def withdraw(address):
    """Takes back what is left of the wrenches that a Sand wrote: `FINE`."""
    withdraw_wrenches(table_at(address))
    return FINE
