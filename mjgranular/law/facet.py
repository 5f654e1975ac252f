"""Kernels of laws of surface elements, for one facet."""

import math
from dataclasses import replace
from functools import cache, partial
from typing import Any, NamedTuple

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.lanes import all_of, choose
from mjgranular.kernel.vector import Vector, cross, dot, norm, outer, transposed, vector
from mjgranular.law.facet_slope import (
    EDGE,
    RAMP,
    led_by_differences,
    led_slope_kernel,
    simple_slope_kernel,
)
from mjgranular.law.kernel import AddedMass, LawKernel
from mjgranular.law.patch import immersed_part, immersed_share
from mjgranular.law.raised import not_raised
from mjgranular.law.slip import hidden_motion

LANES = 8
# A multiplier whose square is smaller has no direction. Chosen: far above the smallest number.
_STILL = 1e-300
_ROUNDED = 1.0 + 1e-12  # margin for rounding: a value beyond a bound by more exceeds it; chosen
_THIRD = 1.0 / 3.0
# Depth over which a facet's added mass builds up, in widths of its geom, in addition to the facet's
# own height. Chosen by a foot and a plate that enter simulated grains (`referee/data`): the foot's
# peak force is 14 % too low with it, and 49 % with twice as much.
_ENTRY = 0.125


class Facet(NamedTuple):
    """A facet, body frame (`shape.facets`)."""

    point: Vector
    normal: Vector
    edges: tuple[Vector, Vector]
    spread: tuple[Vector, Vector]
    area: float
    face: float  # width of the flat face, or the geom, that it is part of [m]
    flat: float  # fraction of the geom's projection in this direction that is one flat face
    layer: float  # width, of sand that moves along [m]
    hides: tuple[Vector, Vector]  # of motion along itself, in edges


class FacetSample(NamedTuple):
    """A facet in the sand."""

    depth: float
    length: float
    point: Vector  # center of pressure
    normal: Vector
    up: Vector  # normal of the sand
    spread_1: Vector  # change of the normal over both half edges
    spread_2: Vector
    middle: float  # depth of the facet's middle [m]
    rise_1: float  # of the depth, along both half edges [m]
    rise_2: float
    mean: float  # mean depth over the whole facet, negative depth counting as zero [m]
    area: float  # [m^2], times the factor on static resistance (`law.raised`)
    cone: float  # what stagnant sand adds to the resistance to vertical motion (`law.raised`)
    push: float  # lambda rho area: the inertial term's [N s^2/m^2]
    moved: float  # sand that moves with the facet once it is immersed [kg]
    entry: float  # depth over which that builds up, besides the facet's own height [m]
    # Of skin that slides along itself (`law.slip`), at the start of the step:
    skips: Vector  # motion that sand does not follow, over that along the skin
    along: Vector  # direction of the motion along the skin
    rubs: float  # share of the traction that opposes it
    slides: float  # that motion over the facet's speed; 0 if the facet does not slide along itself
    turn_0: float  # motion along the normal at the facet's middle, over the speed, beyond `point`'s
    turn_1: float  # what turning takes from its change along both half edges
    turn_2: float


@cache
def facet_kernel(
    probe: Any,
    *,
    stress: Any = None,
    slope: Any = None,
    is_plane: bool = False,
    toward: Any = None,
    ceiling: Any = None,
    added: bool = False,
    slips: bool = False,
    raised: Any = not_raised,
) -> LawKernel:
    """Make the kernels of a law of surface elements for surfaces with that `probe`.

    `slope`, or `stress` if there is none, is that of `RftLaw`; `toward` and `ceiling` are kernels
    of `Surface`. On a plane facets may be sampled side by side. `added` asks for added mass
    (`facet_added`), `slips` for skin that slides along itself (`law.slip`); `raised` is the factor
    on static resistance (`law.raised`).

    The law's record has `inertia`, lambda rho [kg/m^3], and `rise`, 1 if the surface behind a
    turning body is lowered; with added mass also `added`, kappa, and `density`, rho; and `slip`.
    """

    @partial(compiled, inline=True)
    def straight_up(surface, point, outward):
        return probe(surface, point)

    look = straight_up if toward is None else toward
    moved = _moved if added else _none_moved

    @partial(compiled, inline=True)
    def facet_sample(facet, pose, law, surface, g):
        point = pose.position + pose.rotation @ facet.point
        outward = pose.rotation @ facet.normal
        middle, up = look(surface, point, outward)
        edge_1, edge_2 = facet.edges[0], facet.edges[1]
        up_there = transposed(pose.rotation) @ up  # in the body frame
        rise_1, rise_2 = -dot(edge_1, up_there), -dot(edge_2, up_there)
        reach = abs(rise_1) + abs(rise_2)
        depth = middle + reach
        # Side by side `cull` has excluded the case that all are dry, and a second exit would take
        # longer.
        if not is_plane and all_of(depth <= 0.0):
            return FacetSample(
                depth, 0.0, point, point, up, point, point, middle, rise_1, rise_2,
                depth, depth, depth, depth, depth, depth, point, point,
                depth, depth, depth, depth, depth,
            )  # fmt: skip
        lowered = middle
        if law.rise != 0.0:
            lowered = lowered_behind(middle, pose, point, g)
        if all_of(lowered > reach):  # fully immersed, like most
            scale = _THIRD / lowered
            mean, s, t = lowered, rise_1 * scale, rise_2 * scale
            share = choose(lowered > reach, 1.0, 0.0)
        else:
            mean, s, t = immersed_part(lowered, rise_1, rise_2)
            share = immersed_share(lowered, rise_1, rise_2)
        # The force acts at the center of pressure of the immersed part.
        centre = point + pose.rotation @ (s * edge_1 + t * edge_2)
        if not is_plane and mean > 0.0 and middle <= 0.0:
            # If that point is dry, the facet's middle is not above the sand but beside it.
            below, _ = look(surface, centre, outward)
            depth = middle if below <= 0.0 else depth
        skips, along, rubs = 0.0 * outward, outward, 0.0 * middle
        slides, turn_0, turn_1, turn_2 = rubs, rubs, rubs, rubs
        if slips:
            skips, along, rubs, slides, turn_0, turn_1, turn_2 = hidden_motion(
                law, facet, pose, centre, s, t, outward, g, RAMP
            )
        factor, cone = raised(law, facet, pose, centre, outward, up, mean, g)
        return FacetSample(
            depth,
            0.0,
            centre,
            outward,
            up,
            pose.rotation @ facet.spread[0],
            pose.rotation @ facet.spread[1],
            lowered,
            rise_1,
            rise_2,
            mean,
            facet.area * factor,
            cone,
            choose(depth <= 0.0, 0.0, law.inertia * facet.area * share),
            moved(law, facet, dot(outward, up), mean),
            _ENTRY * facet.face,
            skips,
            along,
            rubs,
            slides,
            turn_0,
            turn_1,
            turn_2,
        )

    def respond_kernel(led: Any) -> Any:
        @partial(compiled, inline=True)
        def respond(facet, law, g, v, p, eps):
            # The law's own multiplier has size one.
            square = dot(p, p)
            size = math.sqrt(square) if eps > 0.0 else 1.0
            still = square <= _STILL
            # A zero multiplier is treated as one along z, since its direction has no effect.
            scale = 0.0 if still else 1.0 / size
            u = scale * p
            if still:
                u = vector(0.0, 0.0, 1.0)
            force, by_p = led(facet, law, g, u, eps)
            if still:
                force, by_p = 0.0 * u, outer(0.0 * u, u)
            inertial = facet.push * max(dot(v, facet.normal), 0.0)
            drag = (-inertial * dot(v, facet.normal)) * facet.normal
            by_v = outer((-2.0 * inertial) * facet.normal, facet.normal)
            return size * force, by_p, drag, by_v

        return respond

    @partial(compiled, inline=True)
    def complexity(facet, law, p, eps):
        """Return `LawKernel.complexity`: a facet is simple if all or nothing of it leads."""
        speed = norm(p)
        lead = dot(p, facet.normal) + speed * facet.turn_0
        rise_1 = dot(p, facet.spread_1) - speed * facet.turn_1
        rise_2 = dot(p, facet.spread_2) - speed * facet.turn_2
        reach = _ROUNDED * (abs(rise_1) + abs(rise_2))
        bound = max(reach, RAMP * speed)
        if eps == 0.0:
            size = abs(p.x) + abs(p.y) + abs(p.z)
            bound = reach + 2.0 * EDGE * size if reach > 0.0 else 0.0
        trails = lead <= -bound or facet.mean <= 0.0
        found = 1 if abs(lead) >= bound else 2
        return 0 if trails and facet.push == 0.0 else found

    kernel = LawKernel(
        Facet,
        FacetSample,
        facet_sample,
        respond_kernel(led_by_differences(stress) if slope is None else led_slope_kernel(slope)),
        lanes=LANES,
        probe=ceiling,
        cull=None if ceiling is None else facet_cull,
        side_by_side=is_plane,
        added=facet_added if added else None,
    )
    if slope is None:
        return kernel
    simple = respond_kernel(simple_slope_kernel(slope))
    return replace(kernel, complexity=complexity, respond_simple=simple)


@partial(compiled, inline=True)
def _moved(law, facet, up, mean):
    """Return the mass of the layer in front of a facet: kappa b thick, at most the sand's depth."""
    layer = law.added * facet.layer
    beyond = up * layer > mean
    return law.density * facet.area * choose(beyond, mean / choose(beyond, up, 1.0), layer)


@partial(compiled, inline=True)
def _none_moved(law, facet, up, mean):
    return 0.0 * facet.area


@partial(compiled, inline=True)
def facet_added(facet, v, h):
    """Return the sand that moves with a facet (`AddedMass`), eq. (A1) of docs/laws/rft.md.

    The velocity of its center of pressure at the start of the step of h [s], which is v [m/s],
    brought the facet here in the last step.
    """
    # The immersed part of the facet's height (twice its reach) plus the entry depth.
    height = 2.0 * (abs(facet.rise_1) + abs(facet.rise_2)) + facet.entry
    depth = max(facet.depth, 0.0)
    now = min(depth, height)
    before = min(max(depth + h * dot(v, facet.up), 0.0), now)
    mass = facet.moved / height
    return AddedMass(mass * now, mass * before, facet.normal)


@partial(compiled, inline=True)
def facet_cull(facet, level):
    """Return the depth of a facet's deepest point (see `LawKernel.cull`)."""
    rise_1, rise_2 = dot(level.normal, facet.edges[0]), dot(level.normal, facet.edges[1])
    return level.depth - dot(level.normal, facet.point) + (abs(rise_1) + abs(rise_2))


@partial(compiled, inline=True)
def lowered_behind(depth, pose, point, g):
    """Return the depth below the surface that a turning body has lowered behind itself [m].

    Agarwal et al. 2021: `r (r w^2 / g)` on the rear half of a wheel; here r is the element's own
    distance from the axis through the body's center of mass, and the rear half is where the body's
    velocity points away from the element, whose `depth` is below the undisturbed surface.
    """
    angular, linear = pose.motion.angular, pose.motion.linear
    arm = point - pose.com
    velocity = linear + cross(angular, pose.com - pose.tree)  # of the center of mass
    turning = cross(angular, arm)  # r w
    drop = dot(turning, turning) * (1.0 / g if g > 0.0 else 0.0)
    return choose(dot(velocity, arm) >= 0.0, depth, depth - drop)
