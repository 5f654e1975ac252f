"""Sand as a damping matrix of each body, by the velocity that the step is foreseen to end with.

Resistance F(v) of an element opposes its velocity. Its *secant* is a matrix C, symmetric and not
negative, with C v = -F(v):

    C = F F^T / -(F.v) + |F| / |v| (1 - v v^T / |v|^2) .

The first term alone would do; the second keeps other directions from being free. A force -C v' at
the velocity v' that the step ends with takes energy, whatever v' is, and is the law's own where v'
is the v that was foreseen.

All elements of a body together are a symmetric matrix of 6 x 6 for its spatial velocity (angular,
linear) about the centre of its tree, kept as three of 3 x 3 (`Damping`); brought to the degrees of
freedom, h J^T C J has the sparsity of the inertia matrix, and MuJoCo Warp solves with both.
"""

# The code of kernels is Warp's language, of which type checkers of Python know little.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false
# pyright: reportAssignmentType=false, reportAttributeAccessIssue=false

# Without `annotations` of the future: Warp reads types of local structs where they stand.
import functools
from typing import Any

import numpy as np
import warp as wp

from mjgranular.kernel.motion import Motion
from mjgranular.law.facet_slope import RAMP
from mjgranular.law.kernel import LawKernel, Level, Pose
from mjgranular.law.multiplier import TWO_LIMITS
from mjgranular.warp.translate import struct, struct_of, translated

SLOT_DTYPE = np.dtype(
    [(name, np.int32) for name in ("body", "root", "first", "end", "chain", "chain_end")]
)
Slot = struct("Slot", dict.fromkeys(SLOT_DTYPE.names or (), wp.int32))
"""A body in the sand: its id, its tree's root, its elements, its degrees of freedom in `chain`."""

Damping = struct("Damping", {"turn": wp.mat33, "mixed": wp.mat33, "slide": wp.mat33})
"""A symmetric matrix of 6 x 6 for (angular, linear), its blocks; `mixed` is (angular, linear)."""

# A force that is all but perpendicular to the motion has no secant; its power counts as at least
# this share of |F| |v|. Chosen.
_LEAST_POWER = 0.02

_Motion, _Pose, _Level = struct_of(Motion), struct_of(Pose), struct_of(Level)


@wp.func
def _soft(square: float, eps: float):
    return 1.0 / wp.sqrt(square + eps * eps)


@wp.func
def secant(force: wp.vec3, along: wp.vec3):
    """C of a force per speed [N s/m] and a direction of motion."""
    size = wp.length(force)
    power = -wp.dot(force, along)
    if not (power > 0.0):
        return wp.mat33()
    whole = wp.max(power, _LEAST_POWER * size)
    across = wp.identity(n=3, dtype=float) - wp.outer(along, along)
    return wp.outer(force, force) / whole + size * across


@wp.func
def spatial(vectors: wp.array2d(dtype=wp.spatial_vector), world: int, i: int):
    """A spatial vector of MuJoCo's as a motion."""
    both = vectors[world, i]
    return _Motion(wp.spatial_top(both), wp.spatial_bottom(both))


@wp.func
def velocity_at(motion: _Motion, arm: wp.vec3):
    """Velocity of a point from its place relative to the tree's centre."""
    return motion.linear + wp.cross(motion.angular, arm)


@wp.func
def added_to(d: Damping, c: wp.mat33, arm: wp.vec3):
    """The damping of a body with that of a point of it added."""
    r = wp.skew(arm)
    rc = r * c
    return Damping(d.turn - rc * r, d.mixed + rc, d.slide + c)


@wp.func
def wrench_of(d: Damping, motion: _Motion):
    """Force and moment -C v, as a motion (moment, force)."""
    moment = d.turn * motion.angular + d.mixed * motion.linear
    force = wp.transpose(d.mixed) * motion.angular + d.slide * motion.linear
    return _Motion(-moment, -force)


@functools.cache
def resist_kernel(kernel: LawKernel, law_struct: Any, surface_struct: Any) -> Any:
    """Makes the Warp kernel that gives each body its damping: one thread a world and body.

    Args:
        kernel: of the law, translated.
        law_struct: struct of the law's parameters.
        surface_struct: struct of the surface.
    """
    element_struct = struct_of(kernel.element)
    sample, respond = translated(kernel.sample), translated(kernel.respond)
    has_cull = kernel.cull is not None and kernel.probe is not None
    cull = translated(kernel.cull) if has_cull else _never_dry
    ceiling = translated(kernel.probe) if has_cull else _no_ceiling
    adds_mass = kernel.added is not None
    added = translated(kernel.added) if adds_mass else _nothing_added
    if kernel.multiplier is TWO_LIMITS:
        damping_of = _two_limits(respond)
    elif "spread_1" in kernel.samples._fields:
        damping_of = _facet(respond)
    else:
        damping_of = _one_limit(respond)

    @wp.kernel(module="unique", enable_backward=False)
    def resist(
        slots: wp.array(dtype=Slot),
        elements: wp.array(dtype=element_struct),
        laws: wp.array(dtype=law_struct),
        surface: surface_struct,
        chain: wp.array(dtype=int),
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
        foreseen: wp.array2d(dtype=float),
        damping: wp.array2d(dtype=Damping),
        kick: wp.array2d(dtype=wp.spatial_vector),
        depth: wp.array2d(dtype=float),
    ):
        world, s = wp.tid()
        slot = slots[s]
        h = timestep[world % timestep.shape[0]]
        g = wp.length(gravity[world % gravity.shape[0]])
        law = laws[world % laws.shape[0]]
        strong = strength[world % strength.shape[0]]
        dense = density[world % density.shape[0]]
        # Sand that is higher is a body that is lower.
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
        angular, linear = wp.vec3(), wp.vec3()
        for k in range(slot.chain, slot.chain_end):
            axis = cdof[world, chain[k]]
            rate = foreseen[world, chain[k]]
            angular += rate * wp.spatial_top(axis)
            linear += rate * wp.spatial_bottom(axis)
        ahead = _Motion(angular, linear)
        level = _Level()
        if wp.static(has_cull):
            depth_here, normal = ceiling(surface, pose.position)
            level = _Level(wp.transpose(pose.rotation) * normal, depth_here)
        total = Damping()
        push, twist = wp.vec3(), wp.vec3()
        deepest = float(-wp.inf)
        for i in range(slot.first, slot.end):
            element = elements[i]
            if wp.static(has_cull) and not (cull(element, level) > 0.0):
                continue
            found = sample(element, pose, law, surface, g)
            deepest = wp.max(deepest, found.depth)
            if found.depth > 0.0:
                arm = found.point - tree
                v = velocity_at(ahead, arm)
                c = damping_of(found, law, g, v, eps, strong, dense)
                if wp.static(adds_mass):
                    start = velocity_at(now, arm)
                    mass = added(found, start, h)
                    n = mass.normal
                    c += (dense * mass.mass / h) * wp.outer(n, n)
                    kicked = (dense * mass.before / h * wp.dot(n, start)) * n
                    push += kicked
                    twist += wp.cross(arm, kicked)
                total = added_to(total, c, arm)
        damping[world, s] = total
        kick[world, s] = wp.spatial_vector(twist, push)
        depth[world, s] = deepest

    return resist


@wp.func
def _never_dry(element: Any, level: Any):
    return 1.0


@wp.func
def _no_ceiling(surface: Any, point: wp.vec3):
    return 0.0, wp.vec3()


@wp.func
def _nothing_added(found: Any, v: wp.vec3, h: float):
    return 0.0


@functools.cache
def _one_limit(respond: Any) -> Any:
    """Makes the function for a law with one limit: static resistance and drag have one secant."""

    @wp.func
    def damping_of(
        found: Any, law: Any, g: float, v: wp.vec3, eps: float, strong: float, dense: float
    ):
        square = wp.dot(v, v)
        speed = wp.sqrt(square)
        u = wp.vec3(0.0, 0.0, -1.0)
        per_speed = float(0.0)
        if speed > 0.0:
            per_speed = 1.0 / speed
            u = per_speed * v
        static, by_p, drag, by_v = respond(found, law, g, v, u, eps)
        force = (strong * _soft(square, eps)) * static + (dense * per_speed) * drag
        return secant(force, u)

    return damping_of


@functools.cache
def _facet(respond: Any) -> Any:
    """Makes the function for facets, which a turn of the motion makes lead or not.

    On the ramp over which a face begins to lead, its force changes with the direction of motion by
    much more than by its secant: as much is added across the motion, where it does nothing to the
    force at the velocity that is foreseen.
    """

    @wp.func
    def damping_of(
        found: Any, law: Any, g: float, v: wp.vec3, eps: float, strong: float, dense: float
    ):
        square = wp.dot(v, v)
        speed = wp.sqrt(square)
        u = wp.vec3(0.0, 0.0, -1.0)
        per_speed = float(0.0)
        if speed > 0.0:
            per_speed = 1.0 / speed
            u = per_speed * v
        soft = strong * _soft(square, eps)
        static, by_p, drag, by_v = respond(found, law, g, v, u, eps)
        c = secant(soft * static + (dense * per_speed) * drag, u)
        n = found.normal
        lead = wp.dot(n, u)
        edge = wp.abs(wp.dot(u, found.spread_1)) + wp.abs(wp.dot(u, found.spread_2))
        edge = wp.max(edge, RAMP)
        if wp.abs(lead) < edge and eps > 0.0:
            toward = wp.normalize(u + (edge - lead) * n)
            whole, by_p2, drag2, by_v2 = respond(found, law, g, v, toward, eps)
            across = n - lead * u
            c += (soft * wp.length(whole) / (2.0 * edge)) * wp.outer(across, across)
        return c

    return damping_of


@functools.cache
def _two_limits(respond: Any) -> Any:
    """Makes the function for a law with a limit along the surface's normal and one across."""

    @wp.func
    def damping_of(
        found: Any, law: Any, g: float, v: wp.vec3, eps: float, strong: float, dense: float
    ):
        n = found.normal
        v_n = wp.dot(v, n)
        v_t = v - v_n * n
        square = wp.dot(v_t, v_t)
        t = wp.vec3(1.0, 0.0, 0.0) - n[0] * n
        if wp.abs(n[0]) > 0.7:
            t = wp.vec3(0.0, 1.0, 0.0) - n[1] * n
        t = wp.normalize(t)
        along, by_p, drag, by_v = respond(found, law, g, v, n, eps)
        across, by_p2, drag_2, by_v2 = respond(found, law, g, v, t, eps)
        a = -strong * wp.dot(along, n) * _soft(v_n * v_n, eps)
        b = -strong * wp.dot(across, t) * _soft(square, eps)
        c = b * wp.identity(n=3, dtype=float) + (a - b) * wp.outer(n, n)
        speed = wp.length(v)
        if speed > 0.0:
            c += secant((dense / speed) * drag, v / speed)
        return c

    return damping_of


@wp.kernel(enable_backward=False)
def assemble_forces(
    slots: wp.array(dtype=Slot),
    dof_slots: wp.array(dtype=int),
    dof_first: wp.array(dtype=int),
    cdof: wp.array2d(dtype=wp.spatial_vector),
    cvel: wp.array2d(dtype=wp.spatial_vector),
    damping: wp.array2d(dtype=Damping),
    kick: wp.array2d(dtype=wp.spatial_vector),
    other: wp.array2d(dtype=float),
    force: wp.array2d(dtype=float),
):
    """Adds the sand's forces at the present velocities to what other passive forces there are."""
    world, i = wp.tid()
    axis = spatial(cdof, world, i)
    total = other[world, i]
    for k in range(dof_first[i], dof_first[i + 1]):
        s = dof_slots[k]
        wrench = wrench_of(damping[world, s], spatial(cvel, world, slots[s].body))
        kicked = spatial(kick, world, s)
        total += wp.dot(axis.angular, wrench.angular + kicked.angular)
        total += wp.dot(axis.linear, wrench.linear + kicked.linear)
    force[world, i] = total


@wp.kernel(enable_backward=False)
def assemble_damping(
    rows: wp.array(dtype=int),
    columns: wp.array(dtype=int),
    dof_slots: wp.array(dtype=int),
    dof_first: wp.array(dtype=int),
    timestep: wp.array(dtype=float),
    cdof: wp.array2d(dtype=wp.spatial_vector),
    damping: wp.array2d(dtype=Damping),
    other: wp.array2d(dtype=float),
    metric: wp.array2d(dtype=float),
):
    """Adds h J^T C J, in the sparsity of the inertia matrix, to the damping of fluids."""
    world, k = wp.tid()
    i = rows[k]
    left, right = spatial(cdof, world, i), spatial(cdof, world, columns[k])
    total = float(0.0)
    for m in range(dof_first[i], dof_first[i + 1]):
        wrench = wrench_of(damping[world, dof_slots[m]], right)
        total -= wp.dot(left.angular, wrench.angular) + wp.dot(left.linear, wrench.linear)
    metric[world, k] = other[world, k] + timestep[world % timestep.shape[0]] * total


@wp.kernel(enable_backward=False)
def foresee(
    timestep: wp.array(dtype=float),
    qvel: wp.array2d(dtype=float),
    qacc: wp.array2d(dtype=float),
    foreseen: wp.array2d(dtype=float),
):
    """Velocities that the step ends with at these accelerations."""
    world, i = wp.tid()
    foreseen[world, i] = qvel[world, i] + timestep[world % timestep.shape[0]] * qacc[world, i]


@wp.kernel(enable_backward=False)
def wrenches_of_step(
    slots: wp.array(dtype=Slot),
    chain: wp.array(dtype=int),
    subtree_com: wp.array2d(dtype=wp.vec3),
    xipos: wp.array2d(dtype=wp.vec3),
    cdof: wp.array2d(dtype=wp.spatial_vector),
    velocity: wp.array2d(dtype=float),
    damping: wp.array2d(dtype=Damping),
    kick: wp.array2d(dtype=wp.spatial_vector),
    force: wp.array2d(dtype=wp.vec3),
    moment: wp.array2d(dtype=wp.vec3),
):
    """Force, and moment about the centre of mass, at the velocity that the step ends with."""
    world, s = wp.tid()
    slot = slots[s]
    angular, linear = wp.vec3(), wp.vec3()
    for k in range(slot.chain, slot.chain_end):
        axis = cdof[world, chain[k]]
        rate = velocity[world, chain[k]]
        angular += rate * wp.spatial_top(axis)
        linear += rate * wp.spatial_bottom(axis)
    wrench = wrench_of(damping[world, s], _Motion(angular, linear))
    f = wrench.linear + wp.spatial_bottom(kick[world, s])
    about_tree = wrench.angular + wp.spatial_top(kick[world, s])
    force[world, s] = f
    arm = xipos[world, slot.body] - subtree_com[world, slot.root]
    moment[world, s] = about_tree - wp.cross(arm, f)
