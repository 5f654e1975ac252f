"""Sand as a damping matrix of each body, at the predicted velocity at the end of the step.

Each element has a symmetric matrix C for the velocity of its point (`warp.motions`). The
elements of a body sum to a 6 x 6 matrix for its spatial velocity (`warp.motions`). In joint space h
J^T C J has the sparsity of the inertia matrix, and MuJoCo Warp solves with the sum of both.

Added mass (`scheme.added`) gives an element the additional force (start - rate n.v') n. While
velocities are predicted, `rate` is added to C and `start` is a constant force, so one prediction is
exact where the force is linear. In the final equations of the step, and where (A5) limits the
force, C is the secant of the element's total force and there is no constant force.
"""

# Kernels are written in Warp's language, which Python type checkers do not understand.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false
# pyright: reportAssignmentType=false, reportAttributeAccessIssue=false

import functools
from typing import Any

import mujoco_warp as mjw
import warp as wp

from mjgranular.law.kernel import LawKernel, Level, Pose
from mjgranular.scheme.added import drift_of, momentum_of, most_given, share_after_turn
from mjgranular.scheme.newton import prolonged
from mjgranular.warp.grid import in_any_world, in_world, struct
from mjgranular.warp.motions import (
    Damping,
    Slot,
    WarpMotion,
    about,
    added_to,
    bounded,
    motion_by,
    motion_of,
    moved,
    resistance_of,
    secant_of,
    spatial,
    velocity_at,
    wrench_of,
)
from mjgranular.warp.translate import struct_of, translated

_STILL = 1e-3
"""Speed below which a point counts as at rest, in units of the softness. Chosen."""

_ALL_BUT = 0.05
"""Energy gain, relative to what the sand dissipates, below which forces nearly balance the load.
Chosen: at 2 ms the weight of a robot does this much work at MuJoCo's sleep tolerance."""

Tables = struct(
    "Tables",
    {
        "slots": wp.array(dtype=Slot),  # bodies in the sand
        "chain": wp.array(dtype=int),  # degrees of freedom that move each (`Slot`)
        "most": wp.array(dtype=float),  # bound on the damping of each, times the time step [kg]
        "dof_slots": wp.array(dtype=int),  # slots that each degree of freedom moves,
        "dof_first": wp.array(dtype=int),  # from this index on
        "rows": wp.array(dtype=int),  # of the numbers of the sparse inertia matrix
        "columns": wp.array(dtype=int),
        "row_first": wp.array(dtype=int),  # index of the first number of each row
        "roots": wp.array(dtype=int),  # bodies: one for each robot
        "root_first": wp.array(dtype=int),  # first degree of freedom of each robot
    },
)
"""What is the same in all worlds and steps."""

State = struct(
    "State",
    {
        # Of degrees of freedom.
        "predicted": wp.array2d(dtype=float),  # velocities at the end of the step
        "found": wp.array2d(dtype=float),  # final velocities of the last solution of the equations
        "gap": wp.array2d(dtype=float),  # difference between those predicted before and found
        "creep": wp.array2d(dtype=float),  # velocities removed from creeping robots, else zero
        "passive": wp.array2d(dtype=float),  # other passive forces
        "fluid": wp.array2d(dtype=float),  # damping by fluids, sparse as the inertia matrix
        # Of bodies.
        "share": wp.array2d(dtype=float),  # factor on the speed of moving sand after a turn
        "damping": wp.array2d(dtype=Damping),
        "start_force": wp.array2d(dtype=wp.spatial_vector),  # of sand that moves
        "limit": wp.array2d(dtype=float),  # sum of static resistance over the elements [N]
        # Results: see `WarpSand`.
        "depth": wp.array2d(dtype=float),
        "speed": wp.array2d(dtype=float),
        "force": wp.array2d(dtype=wp.vec3),
        "moment": wp.array2d(dtype=wp.vec3),
        "power": wp.array2d(dtype=float),
    },
)
"""What a step computes in each world; allocated once, as CUDA graphs require."""

_Pose, _Level = struct_of(Pose), struct_of(Level)
prolonged_by = translated(prolonged)
momentum_of_sand, share_of_speed = translated(momentum_of), translated(share_after_turn)
bound_of, drift_by = translated(most_given), translated(drift_of)


@functools.cache
def resist_kernel(kernel: LawKernel, law_struct: Any, surface_struct: Any, remembers: bool) -> Any:
    """Make the Warp kernel that computes each body's damping, one thread per world and body.

    `remembers` says whether each world has its own heights.
    """
    element_struct = struct_of(kernel.element)
    sample = translated(kernel.sample)
    has_cull = kernel.cull is not None and kernel.probe is not None
    cull: Any = translated(kernel.cull) if has_cull else None
    ceiling: Any = translated(kernel.probe) if has_cull else None
    adds_mass = kernel.added is not None
    added: Any = translated(kernel.added) if adds_mass else None
    resistance = resistance_of(kernel)
    surface_in = in_world if remembers else in_any_world

    @wp.kernel(module="unique", enable_backward=False)
    def resist(
        tables: Tables,
        state: State,
        elements: wp.array(dtype=element_struct),
        laws: wp.array(dtype=law_struct),
        surface: surface_struct,
        first: bool,
        last: bool,
        time: wp.array(dtype=float),
        strength: wp.array(dtype=float),
        density: wp.array(dtype=float),
        height: wp.array(dtype=float),
        rise: wp.vec3,
        eps: float,
        timestep: wp.array(dtype=float),
        gravity: wp.array(dtype=wp.vec3),
        xpos: wp.array2d(dtype=wp.vec3),
        xmat: wp.array2d(dtype=wp.mat33),
        xipos: wp.array2d(dtype=wp.vec3),
        subtree_com: wp.array2d(dtype=wp.vec3),
        cvel: wp.array2d(dtype=wp.spatial_vector),
        cdof: wp.array2d(dtype=wp.spatial_vector),
        cdof_dot: wp.array2d(dtype=wp.spatial_vector),
        qvel: wp.array2d(dtype=float),
    ):
        world, s = wp.tid()
        slot = tables.slots[s]
        here = surface_in(surface, world)
        h = timestep[world % timestep.shape[0]]
        g = wp.length(gravity[world % gravity.shape[0]])
        law = laws[world % laws.shape[0]]
        strong = strength[world % strength.shape[0]]
        dense = density[world % density.shape[0]]
        # Raising the sand is the same as lowering the body.
        lift = height[world % height.shape[0]] * rise
        tree = subtree_com[world, slot.root] - lift
        now = spatial(cvel, world, slot.body)
        pose = _Pose(
            xpos[world, slot.body] - lift,
            xmat[world, slot.body],
            xipos[world, slot.body] - lift,
            tree,
            now,
        )
        ahead = motion_of(slot, tables.chain, cdof, state.predicted, world)
        sure = now  # the motion that the prediction started from
        past = now  # the previous prediction, which led to `sure`
        if not first:
            sure = motion_of(slot, tables.chain, cdof, state.found, world)
            change = motion_of(slot, tables.chain, cdof, state.gap, world)
            past = WarpMotion(sure.angular + change.angular, sure.linear + change.linear)
        level = _Level()
        if wp.static(has_cull):
            depth_here, normal = ceiling(here, pose.position)
            level = _Level(wp.transpose(pose.rotation) * normal, depth_here)
        bound = tables.most[s] / h
        soft = eps
        if not first or time[world] > 0.0:  # else the limit belongs to another episode
            soft = wp.max(eps, state.limit[world, s] / bound)
        old = now  # the motion before the body's rotation changed
        slower = float(1.0)  # not yet known
        drift = wp.vec3()
        if wp.static(adds_mass):
            turn = motion_of(slot, tables.chain, cdof_dot, qvel, world)
            spin = motion_by(slot.spin, slot.chain, tables.chain, cdof, qvel, world)
            drift = drift_by(spin, h)
            old = WarpMotion(now.angular - h * turn.angular, now.linear - h * turn.linear - drift)
            if not first:
                slower = state.share[world, s]
        has, had = float(0.0), float(0.0)  # energies of the body's moving sand
        limits = float(0.0)
        total = Damping()
        greatest = float(0.0)
        push, twist = wp.vec3(), wp.vec3()
        deepest, fastest = float(-wp.inf), float(0.0)
        for i in range(slot.first, slot.end):
            element = elements[i]
            if wp.static(has_cull):
                least = cull(element, level)
                deepest = wp.max(deepest, least)
                if not (least > 0.0):
                    continue
            place = sample(element, pose, law, here, g)
            deepest = wp.max(deepest, place.depth)
            if place.depth > 0.0:
                arm = place.point - tree
                v = velocity_at(ahead, arm)
                start = velocity_at(now, arm)
                before = velocity_at(sure, arm)
                # A point that has just stopped is not about to reverse. Trailing faces have no
                # resistance: a step that started from a reversed velocity would end far off.
                if wp.dot(v, before) < 0.0 and wp.length(before) > _STILL * eps:
                    v = before
                fastest = wp.max(fastest, wp.length(start))
                c = resistance(place, law, g, v, soft, strong, dense)
                tangent, kicked = c, wp.vec3()
                p = velocity_at(past, arm)
                beyond = wp.dot(before, before) > wp.dot(p, p) + soft * soft
                if beyond and not first and not last:
                    tangent, kicked = _yielding(c, v, soft)
                limits += wp.trace(c) * wp.sqrt(wp.dot(v, v) + soft * soft)
                if wp.static(adds_mass):
                    mass = added(place, start, h)
                    n = mass.normal
                    speed_now = wp.max(wp.dot(n, start), 0.0)
                    speed_old = wp.max(wp.dot(n, velocity_at(old, arm)), 0.0)
                    has += mass.before * speed_now * speed_now
                    had += mass.before * speed_old * speed_old
                    moved_along = momentum_of_sand(mass, start, drift, h)
                    rate, began = dense * moved_along.rate, slower * dense * moved_along.start
                    c, kicked = _with_momentum(c, tangent, kicked, n, rate, began, v, last)
                else:
                    c = tangent
                push += kicked
                twist += wp.cross(arm, kicked)
                trace = wp.trace(c)
                if trace > greatest:
                    greatest = trace
                    total = about(total, arm)
                total = added_to(total, c, arm)
        total = bounded(total, bound)
        state.limit[world, s] = limits
        state.share[world, s] = share_of_speed(has, had)
        state.damping[world, s] = total
        state.start_force[world, s] = wp.spatial_vector(twist - wp.cross(total.arm, push), push)
        state.depth[world, s] = deepest
        state.speed[world, s] = fastest

    return resist


@wp.func
def _yielding(c: wp.mat33, v: wp.vec3, soft: float):
    """Return the damping of an element loaded beyond its limit, and the constant force.

    Its resistance equals the limit at any speed: constant along the motion, damping across it.
    """
    speed = wp.length(v)
    kicked = wp.vec3()
    if speed > 0.0:
        u = v / speed
        kicked = -wp.sqrt(speed * speed + soft * soft) * (c * u)
        p = wp.identity(n=3, dtype=float) - wp.outer(u, u)
        c = p * c * p
    return c, kicked


@wp.func
def _with_momentum(
    c: wp.mat33,
    tangent: wp.mat33,
    kicked: wp.vec3,
    n: wp.vec3,
    rate: float,
    start: float,
    v: wp.vec3,
    last: bool,
):
    """Return the damping of an element including its added mass, and the constant force.

    Damping by resistance is `c` at the predicted velocity v; the prediction uses `tangent` instead,
    with the constant force `kicked`. `rate` is m / h of the sand along the normal n [kg/s], `start`
    is m' s_b / h [N]. `last` is whether these are the final equations of the step.
    """
    speed = wp.length(v)
    if speed > 0.0:
        # Divided by the speed, because the secant needs forces in that form.
        u = v / speed
        s = wp.dot(n, u)
        if s <= 0.0:
            rate = 0.0
        force = -(c * u)
        a = start / speed - rate * s
        bound, _by_power, _per_speed = bound_of(n, force, u)
        if a <= bound:
            c += rate * wp.outer(n, n)
        if last or a > bound:
            return secant_of(force + wp.min(a, bound) * n, c, u), wp.vec3()
        tangent += rate * wp.outer(n, n)
        kicked += start * n
    return tangent, kicked


@wp.kernel(enable_backward=False)
def assemble_forces(
    tables: Tables,
    state: State,
    cdof: wp.array2d(dtype=wp.spatial_vector),
    cvel: wp.array2d(dtype=wp.spatial_vector),
    force: wp.array2d(dtype=float),
):
    """Add the sand's forces at the present velocities to the other passive forces."""
    world, i = wp.tid()
    axis = spatial(cdof, world, i)
    total = state.passive[world, i]
    for k in range(tables.dof_first[i], tables.dof_first[i + 1]):
        s = tables.dof_slots[k]
        arm = state.damping[world, s].arm
        now = moved(spatial(cvel, world, tables.slots[s].body), arm)
        wrench = wrench_of(state.damping[world, s], now)
        kicked = spatial(state.start_force, world, s)
        total += wp.dot(axis.angular, wrench.angular + kicked.angular)
        total += wp.dot(velocity_at(axis, arm), wrench.linear + kicked.linear)
    force[world, i] = total


@wp.kernel(enable_backward=False)
def assemble_damping(
    tables: Tables,
    state: State,
    timestep: wp.array(dtype=float),
    cdof: wp.array2d(dtype=wp.spatial_vector),
    metric: wp.array2d(dtype=float),
):
    """Add h J^T C J, in the sparsity of the inertia matrix, to the damping of fluids."""
    world, k = wp.tid()
    i = tables.rows[k]
    left, right = spatial(cdof, world, i), spatial(cdof, world, tables.columns[k])
    total = float(0.0)
    for m in range(tables.dof_first[i], tables.dof_first[i + 1]):
        s = tables.dof_slots[m]
        arm = state.damping[world, s].arm
        wrench = wrench_of(state.damping[world, s], moved(right, arm))
        total -= wp.dot(left.angular, wrench.angular)
        total -= wp.dot(velocity_at(left, arm), wrench.linear)
    metric[world, k] = state.fluid[world, k] + timestep[world % timestep.shape[0]] * total


@wp.kernel(enable_backward=False)
def predict(
    timestep: wp.array(dtype=float),
    qvel: wp.array2d(dtype=float),
    qacc: wp.array2d(dtype=float),
    state: State,
):
    """Predict the velocities at the end of the step from these accelerations."""
    world, i = wp.tid()
    state.predicted[world, i] = (
        qvel[world, i] + timestep[world % timestep.shape[0]] * qacc[world, i]
    )


@wp.kernel(enable_backward=False)
def predict_again(
    tables: Tables,
    state: State,
    again: bool,
    timestep: wp.array(dtype=float),
    inertia: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    qacc: wp.array2d(dtype=float),
):
    """Predict the velocities at the end of the step again, with extrapolation.

    One thread per world and robot. The same method as on the CPU (`scheme.newton`).
    """
    world, r = wp.tid()
    h = timestep[world % timestep.shape[0]]
    product, square = float(0.0), float(0.0)
    for i in range(tables.root_first[r], tables.root_first[r + 1]):
        change = state.predicted[world, i] - qvel[world, i] - h * qacc[world, i]
        fall = state.gap[world, i] - change
        state.gap[world, i] = change
        weight = inertia[world, tables.row_first[i + 1] - 1]
        product += weight * change * fall
        square += weight * fall * fall
    beyond = prolonged_by(product, square)
    for i in range(tables.root_first[r], tables.root_first[r + 1]):
        ended = qvel[world, i] + h * qacc[world, i]
        state.predicted[world, i] = ended
        if again:  # else `gap` and `found` are of the last step, or of a world that diverged
            state.predicted[world, i] += beyond * (ended - state.found[world, i])
        state.found[world, i] = ended


@wp.kernel(enable_backward=False)
def warm_start(
    state: State,
    timestep: wp.array(dtype=float),
    disabled: int,
    qvel: wp.array2d(dtype=float),
    qacc_warmstart: wp.array2d(dtype=float),
    time: wp.array(dtype=float),
):
    """Predict the velocities at the end of the step by repeating the last change."""
    world, i = wp.tid()
    change = timestep[world % timestep.shape[0]] * qacc_warmstart[world, i]
    if disabled != 0 or not wp.isfinite(change):  # of a world that diverged, for example
        change = 0.0
    if time[world] > 0.0 and state.creep[world, i] != 0.0:  # not from another episode
        change = state.creep[world, i]
    state.predicted[world, i] = qvel[world, i] + change


@wp.kernel(enable_backward=False)
def wrenches_of_step(
    tables: Tables,
    state: State,
    xipos: wp.array2d(dtype=wp.vec3),
    subtree_com: wp.array2d(dtype=wp.vec3),
    cdof: wp.array2d(dtype=wp.spatial_vector),
):
    """Compute force, moment about the center of mass and power, at the step's final velocity."""
    world, s = wp.tid()
    slot = tables.slots[s]
    arm = state.damping[world, s].arm
    motion = moved(motion_of(slot, tables.chain, cdof, state.predicted, world), arm)
    wrench = wrench_of(state.damping[world, s], motion)
    lever = xipos[world, slot.body] - subtree_com[world, slot.root] - arm
    f = wrench.linear
    state.force[world, s] = f
    state.moment[world, s] = wrench.angular - wp.cross(lever, f)
    state.power[world, s] = wp.dot(f, motion.linear) + wp.dot(wrench.angular, motion.angular)


@wp.kernel(enable_backward=False)
def stop_creep(
    tables: Tables,
    state: State,
    timestep: wp.array(dtype=float),
    tolerance: wp.array(dtype=float),
    dof_length: wp.array(dtype=float),
    inertia: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    qacc: wp.array2d(dtype=float),
):
    """Stop robots that only creep, and store the creep velocity; one thread per world and robot.

    A robot creeps if it is slower than MuJoCo's sleep tolerance and gains much less energy than the
    sand dissipates: the forces nearly balance the load.
    """
    world, r = wp.tid()
    h = timestep[world % timestep.shape[0]]
    first, end = tables.root_first[r], tables.root_first[r + 1]
    taken, gained, fastest = float(0.0), float(0.0), float(0.0)
    for s in range(tables.slots.shape[0]):
        if tables.slots[s].root == tables.roots[r]:
            taken -= h * state.power[world, s]
    for i in range(first, end):
        v = state.predicted[world, i]
        fastest = wp.max(fastest, dof_length[i] * wp.abs(v))
        for k in range(tables.row_first[i], tables.row_first[i + 1]):
            j = tables.columns[k]
            gained += inertia[world, k] * v * (state.predicted[world, j] - qvel[world, j])
            if j != i:
                gained += inertia[world, k] * state.predicted[world, j] * (v - qvel[world, i])
    slow = fastest < tolerance[world % tolerance.shape[0]]
    stops = slow and taken > 0.0 and gained <= _ALL_BUT * taken
    for i in range(first, end):
        state.creep[world, i] = 0.0
        if stops:
            state.creep[world, i] = state.predicted[world, i]
            qacc[world, i] = -qvel[world, i] / h


class Constraints:
    """Regularization and reference of constraints, which stay as stiff as without sand.

    MuJoCo's integrator `discrete` scales the regularization D of a constraint by the ratio of its
    metric to the inertia matrix. In MuJoCo Warp that metric contains the sand's damping, on the CPU
    it does not: uncorrected, joint limits of a robot in sand would be a thousand times too stiff.

    `mujoco_warp.fwd_actuation` assembles the metric and scales D by it. This class relies on two of
    its properties only: a larger D in gives a D out that is larger by the same factor; and what it
    adds to a reference, for adhesion, is proportional to the change of 1 / D.
    """

    def __init__(self, d: Any) -> None:
        self._regularization = wp.zeros_like(d.efc.D)
        self._reference = wp.zeros_like(d.efc.aref)

    def find(self, m: Any, d: Any) -> None:
        """Have MuJoCo Warp scale them by its metric while it contains no sand."""
        mjw.fwd_actuation(m, d)
        wp.copy(self._regularization, d.efc.D)
        wp.copy(self._reference, d.efc.aref)

    def solve(self, m: Any, d: Any) -> None:
        """Solve MuJoCo Warp's equations with sand in the metric, except for constraints."""
        self._restore(d)
        mjw.fwd_actuation(m, d)
        self._restore(d)
        mjw.fwd_acceleration(m, d, factorize=True)
        mjw.solve(m, d)

    def prepare(self, m: Any, d: Any) -> None:
        """Set inputs for which MuJoCo Warp's own scaling, by the current metric, returns them."""
        self._restore(d)
        mjw.fwd_actuation(m, d)
        wp.launch(
            _prepare,
            dim=d.efc.D.shape,
            inputs=[d.nefc, self._regularization, self._reference],
            outputs=[d.efc.D, d.efc.aref],
            device=d.efc.D.device,
        )

    def _restore(self, d: Any) -> None:
        wp.copy(d.efc.D, self._regularization)
        wp.copy(d.efc.aref, self._reference)


@wp.kernel(enable_backward=False)
def _prepare(
    nefc: wp.array(dtype=int),
    regularization: wp.array2d(dtype=float),
    reference: wp.array2d(dtype=float),
    scaled: wp.array2d(dtype=float),
    moved: wp.array2d(dtype=float),
):
    """Invert the scaling of D and of the reference in advance; both are found scaled.

    With s = D / D_scaled, what is added to the reference of D s is 1 / s of what was added to that
    of D, because it is proportional to 1 / D_out - 1 / D_in.
    """
    world, row = wp.tid()
    if row >= nefc[world]:
        return
    right, found = regularization[world, row], scaled[world, row]
    if not (right > 0.0 and found > 0.0):
        return
    shift = moved[world, row] - reference[world, row]
    scaled[world, row] = right * (right / found)
    moved[world, row] = reference[world, row] - shift * (found / right)
