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
from functools import cache, partial
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import (
    BODIES,
    BODY_COUNT,
    CONTACTS,
    ELEMENT_COUNT,
    ELEMENTS,
    SCENE,
    records,
    table_at,
)
from mjgranular.kernel.motion import add_force, velocity_at, velocity_change
from mjgranular.kernel.records import body_records, contact_records
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.scheme import Scheme, refuse_runge_kutta, schemes
from mjgranular.scheme.sheets import forces_on_sheets
from mjgranular.scheme.status import BAD_STATE, FINE, check_options
from mjgranular.scheme.wrenches import (
    add_wrenches,
    gravity_of,
    is_bad,
    place_of,
    pose_at,
)


@dataclass(frozen=True)
class Explicit(Scheme):
    """The law at the current state.

    Attributes:
        half_step: take velocities where positions are, half a step ahead of `qvel`. Without it
            the scheme is of first order in depth too.
        longest_step: the longest time step that may be set later [s]: the sand then refuses to go
            on, since longer ones may give energy.
    """

    name: ClassVar[str] = "explicit"
    title: ClassVar[str] = "the law at the current state, once a step; needs small steps"

    half_step: bool = True
    longest_step: float = 1e9  # any

    def __post_init__(self) -> None:
        if not self.longest_step > 0.0:
            raise InputError(
                f"Explicit: longest_step must be positive, not {self.longest_step:g} s"
            )

    @property
    def step_limit(self) -> float:
        return self.longest_step

    @property
    def lead(self) -> float:
        return 0.5 if self.half_step else 0.0

    def program(self, kernel: LawKernel, scene: np.dtype) -> Any:
        return explicit_program(kernel, scene)

    def check(self, model: mujoco.MjModel) -> None:
        refuse_runge_kutta(model)


schemes.add(Explicit.name, Explicit)


@compiled
def lead_velocity(table, body, lead):
    """Notes the change of a body's velocity within `lead` in its record."""
    wx, wy, wz, vx, vy, vz = velocity_change(table, body.last_dof, lead)
    change = body.change
    change[0], change[1], change[2] = wx, wy, wz
    change[3], change[4], change[5] = vx, vy, vz


@cache
def explicit_program(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """One compiled call for law and scheme: the wrenches of the law, added to `xfrc_applied`."""
    forces = forces_of(kernel, scene_dtype)

    @compiled
    def program(address, lead):
        table = table_at(address)
        if is_bad(table):
            return BAD_STATE
        status = check_options(table)
        if status != FINE:
            return status
        forces(table, lead)
        return add_wrenches(table)

    return program


def forces_of(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """Makes a kernel `forces(table, lead)`: wrenches of bodies, contacts of elements."""
    if kernel.sheets is not None:
        return forces_on_sheets(kernel, scene_dtype)
    element_records, immerse, resist = kernel.elements, kernel.immerse, kernel.resist
    level, skim = kernel.level, kernel.skim
    scene_records = records(scene_dtype)

    @partial(compiled, inline=True)
    def forces(table, lead):
        elements = element_records(table[ELEMENTS], table[ELEMENT_COUNT])
        contacts = contact_records(table[CONTACTS], table[ELEMENT_COUNT])
        bodies = body_records(table[BODIES], table[BODY_COUNT])
        scene = scene_records(table[SCENE], 1)
        law = scene[0].law
        surface = scene[0].surface
        g = gravity_of(table)
        first = 0
        for slot in range(len(bodies)):
            body = bodies[slot]
            for k in range(6):
                body.wrench[k] = 0.0
            place = place_of(table, body)
            around = level(surface, pose_at(place))
            dry = True
            for i in range(first, body.end):
                element, contact = elements[i], contacts[i]
                depth = skim(element, around)
                if depth <= 0.0:
                    contact.depth = depth
                    continue
                immersed = immerse(element, pose_at(place), law, surface, g)
                contact.depth = immersed[0]
                if immersed[0] <= 0.0:
                    continue
                pose = pose_at(place)  # anew: numbers kept from above would cost more
                if dry:  # most bodies of a robot are above the sand
                    dry = False
                    lead_velocity(table, body, lead)
                change = body.change
                tx, ty, tz = pose.tree
                contact.length = immersed[1]
                x, y, z = immersed[2], immersed[3], immersed[4]
                vx, vy, vz = velocity_at(pose.motion, x - tx, y - ty, z - tz)
                # Drag takes the velocity ahead, static resistance the direction of the velocity
                # now: led as well, it creeps five times faster under load.
                cx, cy, cz = velocity_at(
                    (change[0], change[1], change[2], change[3], change[4], change[5]),
                    x - tx,
                    y - ty,
                    z - tz,
                )
                fx, fy, fz = resist(immersed, law, g, (vx, vy, vz), (vx + cx, vy + cy, vz + cz))
                contact.point[0], contact.point[1], contact.point[2] = x, y, z
                contact.velocity[0], contact.velocity[1], contact.velocity[2] = vx, vy, vz
                contact.force[0], contact.force[1], contact.force[2] = fx, fy, fz
                ix, iy, iz = pose.com
                add_force(body.wrench, fx, fy, fz, x - ix, y - iy, z - iz)
            first = body.end

    return forces


def largest_step(rate: float) -> float:
    """The largest step at which an explicit drag cannot overshoot [s].

    Args:
        rate: the drag's derivative by velocity over the mass it acts on [1/s].

    Returns:
        1 / rate: Adams-Bashforth of second order is stable for `h * rate <= 1`.
    """
    return math.inf if rate == 0 else 1 / rate
