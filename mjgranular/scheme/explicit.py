"""The explicit scheme: the law at the current state, once a step.

MuJoCo's Euler integrator is the leapfrog in disguise. It computes `v' = v + h a(x, v)` and then
`x' = x + h v'`: with positions at the times `t`, the velocities belong to `t - h/2`. For forces of
position alone that is second order. Drag is a force of velocity, and taken at `v` it is half a step
late; on the paper's 10 m/s impact at 1e-4 s this alone costs 1 % of the depth. So velocities are
led by half a step, `v + (h/2) a` with `a` the acceleration of the last step (Adams-Bashforth of
second order for the velocity, leapfrog for the position). It costs one sum along the joint chain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import mujoco

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import (
    BODIES,
    BODY_COUNT,
    NBODY,
    WARNINGS,
    XFRC,
    floats,
    ints,
    table_at,
)
from mjgranular.kernel.records import body_records
from mjgranular.scheme.scheme import Scheme, schemes


@dataclass(frozen=True)
class Explicit(Scheme):
    """The law at the current state.

    Attributes:
        half_step: take velocities where positions are, half a step ahead of `qvel`. Without it
            the scheme is of first order in depth too.
    """

    name: ClassVar[str] = "explicit"
    title: ClassVar[str] = "the law at the current state, once a step; needs small steps"

    half_step: bool = True

    @property
    def lead(self) -> float:
        return 0.5 if self.half_step else 0.0

    def program(self, kernel: Any) -> Any:
        return explicit_program(kernel)

    def check(self, model: mujoco.MjModel) -> None:
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            raise InputError(
                "the integrator RK4 cannot be stepped with a force from outside: mj_step1 and "
                "mj_step2 would silently be Euler; set the model's integrator to Euler, implicit "
                "or implicitfast"
            )


schemes.add(Explicit.name, Explicit)


@compiled
def add_wrenches(table):
    """Adds the bodies' wrenches to `xfrc_applied`, and takes back those of the last call.

    A row that still holds what the last call wrote is first restored to what it was before that
    call; a row that does not has been written by the user since (or reset, or copied), and is
    wholly the user's.

    Args:
        table: the simulation's (`kernel.memory`).

    Returns:
        -1, or the row in `bodies` of the first wrench that is not finite; then nothing is written.
    """
    bodies = body_records(table[BODIES], table[BODY_COUNT])
    xfrc = floats(table[XFRC], 6 * table[NBODY])
    for slot in range(len(bodies)):
        total = 0.0
        for k in range(6):
            total += bodies[slot].wrench[k]
        if not math.isfinite(total):
            return slot
    for slot in range(len(bodies)):
        body = bodies[slot]
        row = xfrc[6 * body.body : 6 * body.body + 6]
        untouched = True
        for k in range(6):
            untouched = untouched and row[k] == body.written[k]
        for k in range(6):
            if not untouched:
                body.own[k] = row[k]
            row[k] = body.own[k] + body.wrench[k]
            body.written[k] = row[k]
    return -1


@compiled
def take_back_wrenches(address):
    """Restores `xfrc_applied` to what it was before `add_wrenches`, to the last bit."""
    table = table_at(address)
    bodies = body_records(table[BODIES], table[BODY_COUNT])
    xfrc = floats(table[XFRC], 6 * table[NBODY])
    for slot in range(len(bodies)):
        body = bodies[slot]
        for k in range(6):
            xfrc[6 * body.body + k] = body.own[k]
            body.written[k] = body.own[k]


BAD_STATE = -2
"""What a program returns when MuJoCo has found numbers in the state that are none."""

_BAD = tuple(
    2 * int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{what}")) for what in ("QPOS", "QVEL", "QACC")
)


@compiled
def is_bad(table):
    """Whether MuJoCo has found NaN, infinite or huge numbers in the state, and reset it."""
    # mjWarningStat is {int lastinfo; int number;}: the address is that of the first number.
    numbers = ints(table[WARNINGS], _BAD[2] + 1)
    return numbers[_BAD[0]] + numbers[_BAD[1]] + numbers[_BAD[2]] > 0


@cache
def explicit_program(kernel: Any) -> Any:
    """One compiled call for law and scheme: the wrenches of `kernel`, added to `xfrc_applied`."""

    @compiled
    def program(address, lead):
        table = table_at(address)
        if is_bad(table):
            return BAD_STATE
        kernel(table, lead)
        return add_wrenches(table)

    return program


def largest_step(rate: float) -> float:
    """The largest step at which an explicit drag cannot overshoot [s].

    Args:
        rate: the drag's derivative by velocity over the mass it acts on [1/s].

    Returns:
        1 / rate: Adams-Bashforth of second order is stable for `h * rate <= 1`.
    """
    return math.inf if rate == 0 else 1 / rate
