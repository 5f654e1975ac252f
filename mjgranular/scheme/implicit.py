"""The implicit scheme: forces at the velocities of the end of the step, found before it is made.

Static resistance is dry friction with a limit. Taken at the start of a step it chatters, creeps or
explodes; taken at the end of it, it holds what it can hold. With v' the velocities at the end, f
the sand's forces on its elements and J their Jacobian, one step of MuJoCo is

    A (v' - v) = h (q + q_c(v') + J^T f(v'))

where A is the inertia (with the integrator's own implicit damping), q all smooth forces and q_c
those of MuJoCo's constraints, which answer to the sand as the sand does to them. It is solved for
v' by Newton's method: nv equations, whatever the number of elements, since what the elements of a
body add to the derivative is one 6 x 6 matrix, as if it were inertia.

Rest is made soft over a speed eps far below anything visible: a static force grows to its limit
over speeds of that size. What part of the limit is called on, the element's grip, is unknown beside
the velocity, and Newton's method finds both (`law.multiplier`). It starts from the velocity
that MuJoCo's last acceleration leads to. Nothing of our own is carried from step to step: the force
is a function of MuJoCo's state, so that what is copied, saved or reset goes on alike, to the last
bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import (
    bias_forces,
    constraint_references,
    forward_acceleration,
    forward_actuation,
    tendon_bias_forces,
)
from mjgranular.kernel.memory import (
    BODIES,
    BODY_COUNT,
    DESK,
    floats,
    ints,
    table_at,
)
from mjgranular.kernel.motion import velocity_at
from mjgranular.kernel.records import body_records
from mjgranular.kernel.vector import dot, vector
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme import desk as d
from mjgranular.scheme.balance import (
    body_motions,
    clear,
    copy,
    motion_of,
    prepare_inertia,
)
from mjgranular.scheme.constraints import prepare_rows
from mjgranular.scheme.forces import FRESH, SAME, tile_kernels
from mjgranular.scheme.handover import hand_over, tell_contacts, warm_engine
from mjgranular.scheme.layout import ARM, head_records
from mjgranular.scheme.newton import Way, newton_kernel
from mjgranular.scheme.passive import NO_ENERGY, passive_share, power_bound
from mjgranular.scheme.scheme import Desk, Scheme, refuse_runge_kutta, schemes
from mjgranular.scheme.softness import fastest_of, goal_of, softness
from mjgranular.scheme.status import BAD_STATE, FINE, bits_of, check_options
from mjgranular.scheme.wrenches import (
    add_wrenches,
    is_bad,
    withdraw_wrenches,
)

# Residuals, in parts of the momentum at hand: between two softnesses; above that a step is counted
# as unfinished, and the direct way as lost. What is left between may be one of the law's own jumps.
# Chosen.
_COARSE, _ROUNDED, _LOST = 1e-3, 1e-6, 1e-3
_TURNED = 0.1  # square of the difference of a grip and its velocity's; chosen
# In parts of what the step would change without sand: speeds of which all elements may be at rest.
_SLOW = 1e-3
_FINER = 1e-2  # from one softness to the next, where the direct way is lost
_BEGUN = 10.0  # how much softer a hold may be at the velocity found for that to be tried
# Of Newton's method; not literals, for each of which numba would compile anew.
_STEPS_NEAR, _STEPS, _STEPS_COARSE = (np.int64(n) for n in (8, 40, 6))
_NOTHING = 1e-150  # a momentum that may be divided by


@dataclass(frozen=True)
class Implicit(Scheme):
    """Forces at the end of the step: holds still, for steps of any size.

    Attributes:
        evaluations: of all forces in one step, after which no finer softness is begun: it makes do
            with a softer rest for this step, and counts it (`Report.solver`).
    """

    name: ClassVar[str] = "implicit"
    title: ClassVar[str] = "forces at the end of the step: exact rest, large steps"
    whole_state: ClassVar[bool] = True
    integrators: ClassVar[tuple[str, ...]] = ("EULER", "IMPLICIT", "IMPLICITFAST")

    evaluations: int = 80

    def __post_init__(self) -> None:
        if self.evaluations < 1:
            raise InputError(f"Implicit: evaluations must be at least 1, not {self.evaluations}")

    @property
    def lead(self) -> float:
        return 1.0

    def program(self, kernel: LawKernel, scene: np.dtype) -> Any:
        return implicit_program(kernel, scene, self.evaluations)

    def desk(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        elements: np.ndarray,
        kernel: LawKernel,
        *,
        within: bool = False,
    ) -> Desk:
        return d.make_desk(
            model,
            elements,
            kernel,
            within=within,
            model_address=model._address,
            data_address=data._address,
            of_model=lambda name: getattr(model, name).ctypes.data,
            of_data=lambda name: getattr(data, name).ctypes.data,
        )

    def check(self, model: mujoco.MjModel) -> None:
        refuse_runge_kutta(model)
        if not bits_of(self.integrators) >> int(model.opt.integrator) & 1:
            raise InputError(
                "the implicit scheme foresees the steps of the integrators Euler, implicit and "
                "implicitfast: set one of them, or scheme='explicit'"
            )


schemes.add(Implicit.name, Implicit)


@cache
def implicit_program(kernel: LawKernel, scene_dtype: np.dtype, most: int) -> Any:
    """One compiled call for law and scheme: the wrenches that the end of the step asks for.

    Args:
        kernel: of the law.
        scene_dtype: record of law and surface.
        most: evaluations after which no finer softness is begun.
    """
    sample_all = tile_kernels(kernel, scene_dtype).sample
    newton = newton_kernel(kernel, scene_dtype)

    @compiled
    def find_velocity(table, desk, room, count, h, coarse, fine, scale):
        """Solves for the velocity at the end of the step.

        Returns:
            (evaluations, residual in parts of `scale`, the softness that was reached, the one that
            was sought).
        """
        nv = desk[d.NV]
        velocity = floats(room.velocity, nv)
        start = floats(room.start, nv)
        before = floats(desk[d.WARMSTART], nv)
        goal = goal_of(fine) * scale
        done = 0
        if fastest_of(desk, count) < _SLOW * coarse:
            # At rest what was is what will be.
            way = Way(FRESH, fine, fine, goal, _STEPS_NEAR, _TURNED)
            done, error = newton(table, desk, room, count, h, way)
            if error <= goal:
                return done, error / scale, fine, fine

        # In motion the last acceleration, which is part of MuJoCo's state, is a good guess. What is
        # slower than the step may change is not taken to slide.
        known = True
        for j in range(nv):
            known = known and math.isfinite(before[j])
        for j in range(nv):
            velocity[j] = start[j] + h * before[j] if known else start[j]
        loose = max(coarse, fine)
        way = Way(FRESH, loose, fine, goal, _STEPS, math.inf)
        more, error = newton(table, desk, room, count, h, way)
        done += more
        if goal < error <= _LOST * scale:
            # What begins to move in this step is rounded more than its velocity before can say.
            moved = softness(desk, count, velocity)
            if moved > _BEGUN * fine:
                fine = moved
                goal = goal_of(fine) * scale
                loose = max(coarse, fine)
                way = Way(SAME, fine, fine, goal, _STEPS_COARSE, math.inf)
                more, error = newton(table, desk, room, count, h, way)
                done += more
        if error <= _LOST * scale:
            return done, error / scale, fine, fine

        # Lost: from a coarse softness to the fine one. What holds keeps its grip.
        copy(velocity, start)
        eps = loose
        grips = FRESH
        while eps > fine and done < most:
            way = Way(grips, eps, eps, _COARSE * scale, _STEPS_COARSE, math.inf)
            more, _ = newton(table, desk, room, count, h, way)
            done += more
            grips = SAME
            eps = max(_FINER * eps, fine)
        way = Way(grips, eps, eps, goal, _STEPS, math.inf)
        more, error = newton(table, desk, room, count, h, way)
        return done + more, error / scale, eps, fine

    @compiled
    def program(address, lead):
        table = table_at(address)
        if is_bad(table):
            return BAD_STATE
        status = check_options(table)
        if status != FINE:
            return status
        desk = d.desk_at(table[DESK])
        d.read_options(table, desk)
        bodies = body_records(table[BODIES], table[BODY_COUNT])
        withdraw_wrenches(table)
        for slot in range(len(bodies)):
            clear(bodies[slot].wrench)
        count = sample_all(table, desk)
        if count > 0:
            forward_smooth(desk)
            room = d.open_room(desk)
            coarse, fine, scale = begin(desk, room, count, lead)
            scale = max(scale, _NOTHING)
            done, error, soft, fine = find_velocity(
                table, desk, room, count, lead, coarse, fine, scale
            )
            warm_engine(desk, room, lead)
            share = 1.0
            if power_bound(desk, room, error, scale) > NO_ENERGY:
                share = passive_share(desk, room, error, lead)
            hand_over(desk, room, bodies, share)
            tell_contacts(table, desk, count, share)
            account = d.account_records(desk[d.ACCOUNT], 1)[0]
            account.steps += 1
            account.evaluations += done
            account.most = max(account.most, done)
            account.softened += soft > fine
            account.unfinished += not error <= _ROUNDED
            account.residual = error
            account.worst = max(account.worst, error)
        return add_wrenches(table)

    return program


@compiled
def forward_smooth(desk):
    """Has the engine find the accelerations of all smooth forces but the sand's."""
    model, data = desk[d.MODEL], desk[d.DATA]
    if desk[d.WITHIN] != 0:
        constraint_references(model, data)
        bias_forces(model, data, 0, desk[d.BIAS])
        tendon_bias_forces(model, data, desk[d.BIAS])
    forward_actuation(model, data)
    forward_acceleration(model, data)


@compiled
def begin(desk, room, count, h):
    """Reads the state, and says how softly to begin and to end.

    Returns:
        (coarse softness [m/s], fine softness [m/s], size of the momentum at hand).
    """
    nv, nbody = desk[d.NV], desk[d.NBODY]
    velocity = floats(room.velocity, nv)
    start = floats(room.start, nv)
    trial = floats(room.trial, nv)
    room_smooth = floats(room.smooth, nv)
    weight = floats(room.weight, nv)
    motion = floats(room.motion, 6 * nbody)
    room_wet = floats(room.wet, nbody)
    qvel = floats(desk[d.QVEL], nv)
    smooth = floats(desk[d.SMOOTH], nv)
    acceleration = floats(desk[d.ACCELERATION], nv)
    parents = ints(desk[d.BODY_PARENT], nbody)
    prepare_inertia(desk, room, h)
    prepare_rows(desk, room)
    clear(room_wet)
    heads = head_records(desk[d.HEADS], count)
    for i in range(count):
        body = heads[i].body
        while body > 0 and room_wet[body] == 0.0:
            room_wet[body] = 1.0
            body = parents[body]
    size = 0.0
    for j in range(nv):
        start[j] = qvel[j]
        velocity[j] = qvel[j]
        room_smooth[j] = h * smooth[j]
        trial[j] = h * acceleration[j]
        light = math.sqrt(weight[j])
        size += abs(room_smooth[j]) * light + abs(qvel[j]) / light

    # How much the elements' velocities would change in the step without sand: what is slower than
    # that may stop.
    body_motions(desk, room, trial)
    coarse = 0.0
    lanes = desk[d.LANES]
    for i in range(count):
        w = motion_of(motion, heads[i].body)
        arm = d.vectors_at(desk, i, ARM)
        for lane in range(lanes):
            v = velocity_at(w, vector(arm[lane], arm[lanes + lane], arm[2 * lanes + lane]))
            coarse = max(coarse, dot(v, v))
    return math.sqrt(coarse), softness(desk, count, qvel), size
