"""Bodies in the sand as records, their motions, and the matrices of 6 x 6 that resist them."""

# The code of kernels is Warp's language, of which type checkers of Python know little.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false
# pyright: reportAttributeAccessIssue=false

# Without `annotations` of the future: Warp reads types of local structs where they stand.
import numpy as np
import warp as wp

from mjgranular.kernel.motion import Motion
from mjgranular.warp.structs import struct
from mjgranular.warp.translate import struct_of

SLOT_DTYPE = np.dtype(
    [(name, np.int32) for name in ("body", "root", "first", "end", "chain", "chain_end")]
)
Slot = struct("Slot", dict.fromkeys(SLOT_DTYPE.names or (), wp.int32))
"""A body in the sand: its id, its tree's root, its elements, its degrees of freedom in `chain`."""

Damping = struct(
    "Damping", {"turn": wp.mat33, "mixed": wp.mat33, "slide": wp.mat33, "arm": wp.vec3}
)
"""A symmetric matrix of 6 x 6 for (angular, linear), its blocks; `mixed` is (angular, linear).

It is about the point that is resisted most, which `arm` leads to from the centre of the body's
tree. That one moves least: about any other, the power of what turns about a foot that stands would
be a small difference of large numbers."""

WarpMotion = struct_of(Motion)


@wp.func
def spatial(vectors: wp.array2d(dtype=wp.spatial_vector), world: int, i: int):
    """A spatial vector of MuJoCo's as a motion."""
    both = vectors[world, i]
    return WarpMotion(wp.spatial_top(both), wp.spatial_bottom(both))


@wp.func
def velocity_at(motion: WarpMotion, arm: wp.vec3):
    """Velocity of a point from its place relative to the one that the motion is about."""
    return motion.linear + wp.cross(motion.angular, arm)


@wp.func
def moved(motion: WarpMotion, arm: wp.vec3):
    """The same motion about another point."""
    return WarpMotion(motion.angular, velocity_at(motion, arm))


@wp.func
def motion_of(
    slot: Slot,
    chain: wp.array(dtype=int),
    cdof: wp.array2d(dtype=wp.spatial_vector),
    rates: wp.array2d(dtype=float),
    world: int,
):
    """The motion of a body about the centre of its tree, from rates of its degrees of freedom."""
    angular, linear = wp.vec3(), wp.vec3()
    for k in range(slot.chain, slot.chain_end):
        axis = spatial(cdof, world, chain[k])
        rate = rates[world, chain[k]]
        angular += rate * axis.angular
        linear += rate * axis.linear
    return WarpMotion(angular, linear)


@wp.func
def added_to(d: Damping, c: wp.mat33, arm: wp.vec3):
    """The damping of a body with that of a point of it added."""
    r = wp.skew(arm - d.arm)
    rc = r * c
    return Damping(d.turn - rc * r, d.mixed + rc, d.slide + c, d.arm)


@wp.func
def about(d: Damping, arm: wp.vec3):
    """The damping of a body about another point."""
    s = wp.skew(arm - d.arm)
    crossed = d.mixed * s
    turn = d.turn + crossed + wp.transpose(crossed) - s * d.slide * s
    return Damping(turn, d.mixed - s * d.slide, d.slide, arm)


@wp.func
def _norm(c: wp.mat33):
    """The greatest sum of sizes in a row: no direction is resisted by more."""
    rows = wp.vec3(1.0, 1.0, 1.0)
    sizes = wp.vec3(
        wp.dot(wp.abs(c[0]), rows), wp.dot(wp.abs(c[1]), rows), wp.dot(wp.abs(c[2]), rows)
    )
    return wp.max(sizes)


@wp.func
def bounded(d: Damping, most: float):
    """The damping of a body, made less where it is above a bound [N s/m]."""
    part = wp.min(1.0, most / _norm(d.slide))
    return Damping(part * d.turn, part * d.mixed, part * d.slide, d.arm)


@wp.func
def wrench_of(d: Damping, motion: WarpMotion):
    """Force and moment -C v of a motion about its point, as a motion (moment, force)."""
    moment = d.turn * motion.angular + d.mixed * motion.linear
    force = wp.transpose(d.mixed) * motion.angular + d.slide * motion.linear
    return WarpMotion(-moment, -force)
