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
itself. Chosen: between 1.5 and 3 no error in docs/laws/rft.md changes by more than 2.3 points."""

# Square of a speed that counts as rest, in units of g times the width; chosen.
_SLOW = 1e-6
# Skin that slides along itself by more of its speed counts as doing that; chosen: the contact of
# a wheel that rolls without slip has no speed.
_FASTEST = 3.0
_SIXTH = 1.0 / 6.0
_NONE = 1e-30  # a square that counts as zero


@partial(compiled, inline=True)
def hidden_motion(law, facet, pose, centre, s, t, normal, g, ramp):
    """Return what a facet that slides along itself has of `FacetSample`, from `skips` on.

    `s` and `t` are where on the facet its `centre` is. A facet that leads by less than `ramp`, the
    sine of its angle to the motion, is taken to lead by that.
    """
    motion = pose.motion
    turn = cross(transposed(pose.rotation) @ motion.angular, facet.normal)
    first, second = dot(facet.hides[0], turn), dot(facet.hides[1], turn)
    h = first * facet.edges[0] + second * facet.edges[1]
    turn = first * facet.spread[0] + second * facet.spread[1]  # along directions that are round
    turn_1, turn_2 = dot(facet.spread[0], h), dot(facet.spread[1], h)
    h = pose.rotation @ h
    h = h - dot(h, normal) * normal
    v = velocity_at(motion, centre - pose.tree)
    lead, speed = dot(v, normal), root(dot(v, v))
    across, least = v - lead * normal, ramp * speed
    # The facet's middle, and its skin there, which is farther out than the mean of the facet.
    bulge = _SIXTH * (dot(facet.edges[0], facet.spread[0]) + dot(facet.edges[1], facet.spread[1]))
    turn_0 = s * turn_1 + t * turn_2
    lead = lead + turn_0
    turn_1 = turn_1 - bulge * dot(turn, facet.spread[0])
    turn_2 = turn_2 - bulge * dot(turn, facet.spread[1])
    most = law.slip * choose(lead > least, lead, least)
    square, both, beyond = dot(h, h), dot(h, across), dot(across, across) - most * most
    rest = both * both - square * beyond
    q = (both - root(choose(rest > 0.0, rest, 0.0))) / choose(square > _NONE, square, 1.0)
    q = choose(q < 1.0, q, 1.0)
    q = choose(beyond > 0.0, choose(q > 0.0, q, 0.0), 0.0)
    slow = _SLOW * g * facet.face + _NONE
    gone, slides = q * root(square), root(dot(across, across) + slow)
    rubs = 2.0 * gone / (gone + slides)
    least = square * (1.0 / (_FASTEST * _FASTEST))
    per = 1.0 / root(choose(speed * speed > least, speed * speed, least) + slow)
    per_slide = 1.0 / slides
    return (
        (per_slide * q) * h,
        per_slide * across,
        choose(rubs < 1.0, rubs, 1.0),
        choose(square > _NONE, slides / root(speed * speed + slow), 0.0),
        per * turn_0,
        per * turn_1,
        per * turn_2,
    )


@partial(compiled, inline=True)
def followed(facet, m, u, leads):
    """Return the direction of motion that sand follows, that motion per unit speed, its columns.

    The motion is u - (e.u) d along the skin, linear in u, and `leads` along its normal m; returned
    are e and d (S7).
    """
    e = facet.along - dot(facet.along, m) * m
    d = facet.skips - dot(facet.skips, m) * m
    followed = u - dot(e, u) * d + (leads - dot(m, u)) * m
    size = norm(followed)
    return (1.0 / size) * followed, size, e, d


@partial(compiled, inline=True)
def opposed(force, facet, m, u):
    """Return a force with a share of its traction turned against the motion u (S8).

    Also what `turned_slope` needs: the share, at least such that no energy is added, the slip, the
    direction of the traction, and what the slip is relative to.
    """
    traction = force - dot(force, m) * m
    along = u - dot(u, m) * m
    size, speed = norm(traction), norm(along)
    per = 1.0 / max(speed, facet.slides)
    slip = per * along
    gain, enough = dot(force, u), 0.0
    if gain > 0.0:
        enough = min(gain / (dot(traction, u) + size * speed * speed * per), 1.0)
    share = max(facet.rubs, enough)
    force = force - share * (traction + size * slip)
    force = force - max(dot(force, u), 0.0) * u  # of skin that begins to lead
    return force, share, slip, (1.0 / (size + _NONE)) * traction, size * per, speed > facet.slides


@partial(compiled, inline=True)
def turned_slope(by_p, force, m, u, followed, opposing):
    """Return the derivative of |p| S(p / |p|) by p for the force after `opposed`.

    `by_p` is that of the force before it, by the motion that sand follows. That all this turns with
    the part that leads is omitted: a tenth more searches, of which each is cheaper.
    """
    after, share, slip, traction, per, is_full = opposing
    w, size, e, d = followed
    by_u = (1.0 / size) * (by_p - outer(force, w))
    by_u = by_u - outer(by_u @ d, e)
    by_u = by_u - outer(by_u @ u, u)
    across = by_u - outer(m, transposed(by_u) @ m)
    by_u = by_u - share * (across + outer(slip, transposed(by_u) @ traction))
    side = cross(m, u)
    side = (1.0 / (norm(side) + _NONE)) * side
    by_u = by_u - (share * per) * outer(side, side)
    if not is_full:  # slip is in proportion to its speed
        ahead = cross(side, m)
        by_u = by_u - (share * per) * outer(ahead, ahead - dot(ahead, u) * u)
    return outer(after, u) + by_u
