"""The implicit scheme: forces at the velocities of the end of the step, predicted before it.

Static resistance is dry friction with a limit. Evaluated at the start of a step it chatters, creeps
or explodes; evaluated at its end, it holds any load up to its limit. With v' the velocities at the
end, f the sand's forces on its elements and J their Jacobian, one step of MuJoCo is

    A (v' - v) = h (q + q_c(v') + J^T f(v'))

where A is the inertia (with the integrator's own implicit damping), q all smooth forces and q_c
those of MuJoCo's constraints, which are coupled to the sand's. Sands that act in the same step are
solved together: the last of them, with its own workspace, sums up the forces of all (`BESIDE`).
docs/architecture.md has the modules in reading order; the equations are in docs/scheme.md.

The scheme carries no state from step to step: the force is a function of MuJoCo's state, so that
copied, saved or reset states continue identically, to the last bit.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular._util.checks import check_count
from mjgranular.errors import InputError
from mjgranular.kernel import engine
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.elementary import bits_of
from mjgranular.kernel.intrinsics import call_forces, call_step
from mjgranular.kernel.memory import BESIDE, LAW, SAMPLING, WORKSPACE, table_at
from mjgranular.kernel.records import bodies_of, contacts_of, options_at
from mjgranular.kernel.vector import cross, dot, norm, read_vector, write_vector
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.balance import is_unsupported, make_metric, prepare_inertia
from mjgranular.scheme.constraints import prepare_constraints
from mjgranular.scheme.dense import add_scaled, clear, copy, inner
from mjgranular.scheme.forces import SAME, SUM, forces_program
from mjgranular.scheme.layout import FORCE, INDEX, VELOCITY
from mjgranular.scheme.passivity import passive_share
from mjgranular.scheme.sampling import sampling_program
from mjgranular.scheme.scheme import BAD_METRIC, FINE, Scheme, Workspace, check_options
from mjgranular.scheme.solver import UNFINISHED, find_velocity, lane_vector
from mjgranular.scheme.workspace import (
    DISCRETE,
    make_workspace,
    open_constraints,
    read_options,
    workspace_at,
)
from mjgranular.scheme.wrenches import add_wrenches, find_bad_wrench, withdraw_wrenches

# The momentum at hand is at least that of this speed in all joints, also where constraints alone
# load them [m/s, rad/s]. Chosen: gravity adds 100 times as much in a step.
_LEAST = 1e-4


@dataclass(frozen=True)
class Implicit(Scheme):
    """Forces at the end of the step: bodies rest without motion, for steps of any size.

    Attributes:
        evaluations: limit on evaluations of all forces per step. If the law's forces are not found
            by then, the step uses damping, and is counted (`Report.solver`).
    """

    name: ClassVar[str] = "implicit"
    whole_state: ClassVar[bool] = True

    evaluations: int = 320

    def __post_init__(self) -> None:
        check_count("Implicit: evaluations", self.evaluations)

    @property
    def lead(self) -> float:
        return 1.0

    def program(self, kernel: LawKernel, scene: np.dtype) -> Any:
        return implicit_program

    def sampling(self, kernel: LawKernel, scene: np.dtype) -> Any:
        return sampling_program(kernel, scene)

    def forces(self, kernel: LawKernel, scene: np.dtype) -> Any:
        return forces_program(kernel, scene["law"])

    def workspace(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        kernel: LawKernel,
        tiles: int,
        within: bool,
    ) -> Workspace:
        options = {"within": int(within), "evaluations": self.evaluations}
        return make_workspace(model, data, kernel, tiles, options)

    def check(self, model: mujoco.MjModel) -> None:
        super().check(model)
        options = model.opt
        # As Python: it would be compiled again in every process.
        if is_unsupported.py_func(options.integrator, options.solver, options.enableflags):
            raise InputError(self.refusal(BAD_METRIC))


@compiled
def implicit_program(address, lead):
    """Compute the wrenches at the end of the step; see `Scheme.program`."""
    table = table_at(address)
    status = check_options(table)
    if status != FINE:
        return status
    options = options_at(table)
    if is_unsupported(options.integrator, options.solver, options.enableflags):
        return BAD_METRIC
    w = workspace_at(table[WORKSPACE])
    read_options(table, w)
    withdraw_all(table)
    call_step(table[SAMPLING], address, lead)  # fills the tiles
    mark_immersed(table, w)
    if w.immersed[0] != 0:
        open_constraints(table[WORKSPACE], w)
        find_smooth_forces(w)
        prepare_inertia(w)
        prepare_constraints(w)
        begin(w)
        done, error = find_velocity(table, w)
        warm_start(w)
        share = passive_share(w, error)
        write_results(table, w, share)
        if w.count > 0:  # the others have counted this step themselves
            count_step(w.statistics[0], done, error)
    return add_all(table)


@compiled
def withdraw_all(table):
    """Remove the wrenches of all sands that act together, the latest first, and clear them."""
    address = table.ctypes.data
    while address != 0:
        sand = table_at(address)
        withdraw_wrenches(sand)
        bodies = bodies_of(sand)
        for slot in range(len(bodies)):
            clear(bodies[slot].wrench)
        address = sand[BESIDE]


@compiled
def add_all(table):
    """Add the wrenches of all sands that act together, the earliest first; see `add_wrenches`."""
    count, address = 0, table.ctypes.data
    while address != 0:
        sand = table_at(address)
        bad = find_bad_wrench(sand)
        if bad >= 0:
            return bad if count == 0 else 0
        count += 1
        address = sand[BESIDE]
    for number in range(count - 1, -1, -1):
        sand = table_at(table.ctypes.data)
        for _ in range(number):
            sand = table_at(sand[BESIDE])
        add_wrenches(sand)
    return FINE


@compiled
def find_smooth_forces(w):
    """Have the engine compute q, all smooth forces except the sand's, and their accelerations."""
    model, data = w.model, w.data
    if w.within != 0:  # inside the step, what follows passive forces is not yet computed
        engine.constraint_references(model, data)
        engine.bias_forces(model, data, 0, w.qfrc_bias.ctypes.data)
        engine.tendon_bias_forces(model, data, w.qfrc_bias.ctypes.data)
    engine.forward_actuation(model, data)
    if w.integrator == DISCRETE:
        make_metric(w)
    else:
        clear(w.shift)
    engine.forward_acceleration(model, data)


@compiled
def mark_immersed(table, w):
    """Flag the bodies with an element in a sand, and their ancestors: the world too, if any is."""
    immersed = w.immersed
    for body in range(w.nbody):
        immersed[body] = 0
    address = table.ctypes.data
    while address != 0:
        sand = table_at(address)
        own = workspace_at(sand[WORKSPACE])
        for i in range(own.count):
            body = own.heads[i].body
            while immersed[body] == 0:
                immersed[body] = 1
                body = w.body_parentid[body]
        address = sand[BESIDE]


@partial(compiled, inline=True)
def turns(w, j):
    """Return whether a degree of freedom turns."""
    return norm(read_vector(w.cdof[j], 0)) > 0.0


@compiled
def begin(w):
    """Read v and h q; v' starts as v. `w.scale` is the size of both momenta.

    It is a sum over joints. The three world-aligned axes of a free joint count by their norm.
    """
    scale, pushes, speeds, least = 0.0, 0.0, 0.0, 0.0
    for j in range(w.nv):
        w.start[j] = w.velocity[j] = w.qvel[j]
        w.smooth[j] = w.h * (w.qfrc_smooth[j] + w.shift[j])
        light = math.sqrt(w.weight[j])
        least += 1.0 / light
        push, speed = abs(w.smooth[j]) * light, abs(w.qvel[j]) / light
        if turns(w, j):
            scale += push + speed
            continue
        pushes, speeds = pushes + push * push, speeds + speed * speed
        after = j + 1
        if after == w.nv or w.dof_jntid[after] != w.dof_jntid[j] or turns(w, after):
            scale += math.sqrt(pushes) + math.sqrt(speeds)
            pushes, speeds = 0.0, 0.0
    w.scale = max(scale, _LEAST * least)


@compiled
def warm_start(w):
    """Start the engine's constraint solver at the predicted acceleration.

    From elsewhere it stops within about 1e-6 of the solution. That is little in motion, but at rest
    it disturbs the forces that the sand holds. From here it only confirms the solution. It solves
    for the acceleration without the integrator's own damping C: (1 + M^-1 C) (v' - v) / h.
    """
    if w.nefc == 0:
        return
    rate, damped, answer = w.rate, w.product, w.solution
    for j in range(w.nv):
        rate[j] = (w.velocity[j] - w.start[j]) / w.h
    copy(w.qacc_warmstart, rate)
    if w.damped != 0:
        for i in range(w.nv):
            damped[i] = inner(w.damping[i], rate)
        engine.solve_inertia(w.model, w.data, answer.ctypes.data, damped.ctypes.data, 1)
        add_scaled(w.qacc_warmstart, 1.0, answer)


@compiled
def write_results(table, w, share):
    """Write what a step found to the records of all sands that act together."""
    address = table.ctypes.data
    while address != 0:
        sand = table_at(address)
        own = workspace_at(sand[WORKSPACE])
        if table[BESIDE] != 0:  # else `w.wrench` has the forces of this sand alone
            for b in range(w.nbody):
                clear(w.wrench[b])
            call_forces(sand[LAW], address, table[WORKSPACE], SUM, 0.0, SAME, 0.0)
        if own.count > 0:
            write_body_wrenches(w, bodies_of(sand), share)
            write_contacts(sand, own, share)
        address = sand[BESIDE]


@compiled
def count_step(statistics, done, error):
    """Count a step, its evaluations and its relative residual."""
    statistics.steps += 1
    statistics.evaluations += done
    statistics.most = max(statistics.most, done)
    statistics.unfinished += not error <= UNFINISHED
    statistics.residual = error
    statistics.worst = max(statistics.worst, error)


@compiled
def write_body_wrenches(w, bodies, share):
    """Write the bodies' wrenches about their own centers of mass, force before moment."""
    for slot in range(len(bodies)):
        body = bodies[slot]
        if w.immersed[body.body] == 0:
            continue
        moment = read_vector(w.wrench[body.body], 0)
        force = read_vector(w.wrench[body.body], 3)
        arm = read_vector(w.xipos[body.body], 0) - read_vector(w.subtree_com[body.root], 0)
        write_vector(body.wrench, 0, share * force)
        write_vector(body.wrench, 3, share * (moment - cross(arm, force)))


@compiled
def write_contacts(table, w, share):
    """Write the forces on elements to their contacts, and their power at the end of the step."""
    contacts = contacts_of(table)
    for i in range(w.count):
        tile = w.tiles[i]
        for lane in range(w.heads[i].live):
            contact = contacts[bits_of(tile[INDEX * w.lanes + lane])]
            force = share * lane_vector(w, tile, FORCE, lane)
            write_vector(contact.force, 0, force)
            contact.power = dot(force, lane_vector(w, tile, VELOCITY, lane))
