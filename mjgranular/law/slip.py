"""Skin that slides along itself, as a rolling wheel's: sand does not follow all of its motion.

docs/laws/rft.md, "Faster motion", derives (S6) to (S8). What is hidden, and how much of it sand
does not follow, is known from a facet's motion at the start of a step; it does not change in it.
"""

from functools import partial

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.lanes import choose, root
from mjgranular.kernel.motion import velocity_at
from mjgranular.kernel.vector import cross, dot, norm, outer, transposed

SLIP = 2.0
"""tan(theta): sand follows motion at up to 63 degrees to the normal of a skin that slides along
itself. Chosen: between 1.5 and 3 no error of docs/validity.md changes by more than 0.5 points."""

# Skin hides motion if its radius is at most so many times its width, chosen: the shells of legs do.
_WIDEST = 2.0
# Square of a speed that counts as rest, in units of g times the width; chosen.
_SLOW = 1e-6
_NONE = 1e-30  # a square that counts as zero


@partial(compiled, inline=True)
def hidden_motion(law, facet, pose, centre, normal, g):
    """Return the hidden motion over the speed, q (S7), and the share of it in the traction (S8)."""
    motion = pose.motion
    turn = cross(transposed(pose.rotation) @ motion.angular, facet.normal)
    first = _along(facet.edges[0], facet.spread[0], turn, facet.face)
    second = _along(facet.edges[1], facet.spread[1], turn, facet.face)
    h = pose.rotation @ (first * facet.edges[0] + second * facet.edges[1])
    h = (1.0 - facet.flat) * (h - dot(h, normal) * normal)
    v = velocity_at(motion, centre - pose.tree)
    lead = dot(v, normal)
    across = v - lead * normal
    most = law.slip * choose(lead > 0.0, lead, 0.0)
    square, both, beyond = dot(h, h), dot(h, across), dot(across, across) - most * most
    rest = both * both - square * beyond
    q = (both - root(choose(rest > 0.0, rest, 0.0))) / choose(square > _NONE, square, 1.0)
    q = choose(q < 1.0, q, 1.0)
    q = choose(beyond > 0.0, choose(q > 0.0, q, 0.0), 0.0)
    slow = _SLOW * g * facet.face + _NONE
    gone = q * root(square)
    share = 2.0 * gone / (gone + root(dot(across, across) + slow))
    return (
        (1.0 / root(dot(v, v) + slow)) * h,
        q,
        choose(share < 1.0, share, 1.0),
    )


@partial(compiled, inline=True)
def _along(edge, spread, turn, width):
    """Return how much of an edge the skin slides along itself while its normal turns (S6) [1/s]."""
    square = dot(spread, spread)
    curved = _WIDEST * _WIDEST * width * width * square > dot(edge, edge)
    return choose(curved, dot(spread, turn), 0.0) / choose(curved, square, 1.0)


@partial(compiled, inline=True)
def followed(facet, m, u):
    """Return the direction of motion that sand follows, and the motion in it per unit speed (S7)."""
    hidden = facet.hidden - dot(facet.hidden, m) * m
    followed = u - facet.slips * hidden
    size = norm(followed)
    return (1.0 / size) * followed, size


@partial(compiled, inline=True)
def opposed(force, share, m, u):
    """Return a force with a share of its traction turned against the motion u (S8).

    Also what `turned` needs: the share, at least such that no energy is added, the direction of
    slip, that of the traction, and the traction over the motion along the skin.
    """
    traction = force - dot(force, m) * m
    along = u - dot(u, m) * m
    size, speed = norm(traction), norm(along)
    power = dot(force, u)
    if power > 0.0:
        share = max(share, min(power / (dot(traction, u) + size * speed), 1.0))
    per, per_speed = 1.0 / (size + _NONE), 1.0 / (speed + _NONE)
    along = per_speed * along
    force = force - share * (traction + size * along)
    force = force - max(dot(force, u), 0.0) * u  # of skin that begins to lead
    return force, share, along, per * traction, size * per_speed


@partial(compiled, inline=True)
def turned(column, share, m, along, traction):
    """Return how a force after `opposed` changes with a change of the one before."""
    across = column - dot(column, m) * m
    return column - share * (across + dot(traction, column) * along)


@partial(compiled, inline=True)
def turned_slope(by_p, force, m, u, followed, size, opposing):
    """Return the derivative of |p| S(p / |p|) by p for the force after `opposed`.

    `by_p` is that of the force before it, by the motion that sand follows, of a `size` per speed.
    """
    after, share, along, traction, per = opposing
    by_u = (1.0 / size) * (by_p - outer(force, followed))
    by_u = by_u - outer(by_u @ u, u)
    across = by_u - outer(m, transposed(by_u) @ m)
    by_u = by_u - share * (across + outer(along, transposed(by_u) @ traction))
    side = cross(m, along)
    return outer(after, u) + by_u - (share * per) * outer(side, side)
