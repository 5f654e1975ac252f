"""The link law of Lee and Marghitu: static resistance by depth, drag by velocity squared.

There are two forms: lumped, the paper's own, with one force on the whole rod; and distributed, with
the same totals in pure translation but spread along the axis, which also resists rotation. How the
paper's law for a vertical plane is written in three dimensions: docs/laws/link.md.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, ClassVar, NamedTuple, Self

import mujoco
import numpy as np

from mjgranular._util.checks import check_count
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import Vector, cross, diagonal, dot, norm, outer
from mjgranular.law.kernel import LawKernel
from mjgranular.law.law import Law, constants_of, record_of, register_law
from mjgranular.law.multiplier import TWO_LIMITS
from mjgranular.law.validity import Limit
from mjgranular.medium import Medium
from mjgranular.shape import cut_rods, rods_from_model
from mjgranular.surface import Surface

LINK_KEYS = ("eta_d", "eta_h", "eta_v", "exponent")

_LINK_PAPER = (
    "S. Lee, D. B. Marghitu, Stopping Time for a Planar Link in Contact with a Granular Material, "
    "eqs. (2), (5)-(11)"
)


class Rod(NamedTuple):
    """A rod or a piece of one, body frame (`shape.single`)."""

    center: Vector
    axis: Vector
    half_length: float
    width: float


class RodSample(NamedTuple):
    """A rod in the sand."""

    depth: float
    length: float
    point: Vector
    axis: Vector
    normal: Vector  # of the sand
    limit_n: float  # of static resistance along the normal [N]
    limit_t: float  # the same along the surface
    drag: float  # drag coefficient of motion across the axis [N s^2/m^2]


@compiled
def lumped_limits(depth, cos_q, length, diameter, law, g):
    """Return the limits of the paper's static resistance for one rod, along normal and surface [N].

    `depth` is that of the end T, y_T > 0 [m], `cos_q` the cosine of the angle between axis and
    normal, `length` the immersed length l [m].
    """
    # Eqs. (9), (11): -sign(v) eta_v (y_T/d)^lambda g rho_g V, with V the immersed volume.
    weight = g * law.density * diameter
    column = weight * (0.25 * math.pi * diameter * length)
    # The power comes last, so that the rest runs while it is computed.
    normal = (law.eta_v * column) * (depth / diameter) ** law.exponent
    # Eq. (10): -sign(v) eta_h g rho_g y_T^2 d.
    return normal, law.eta_h * weight * depth * depth


@compiled
def distributed_limits(depth, cos_q, length, diameter, law, g):
    """Return the same limits for one short piece of a rod; arguments as for `lumped_limits`.

    They are the derivatives of the lumped ones along the axis (dy = cos q ds), at the middle of the
    piece's immersed part.
    """
    middle = max(depth - 0.5 * length * cos_q, 0.0)
    weight = g * law.density * diameter * length
    slope = (1.0 + law.exponent) * law.eta_v * weight * (0.25 * math.pi * diameter)
    normal = slope * (middle / diameter) ** law.exponent
    return normal, 2.0 * law.eta_h * weight * middle * cos_q


@partial(compiled, inline=True)
def link_respond(rod, law, g, v, p, eps):
    """Return resistance and its derivatives (see `LawKernel.respond`)."""
    n, u = rod.normal, rod.axis
    more = rod.limit_n - rod.limit_t
    # Eqs. (2), (7): F_d = -eta_d rho_g A_r |v_E| v_E with A_r = d l |sin|, so that the speed
    # cancels and no division by it is needed.
    speed = norm(cross(u, v))
    drag = rod.drag * speed
    static = -rod.limit_t * p - (more * dot(p, n)) * n
    # d(c |u x v| v)/dv = c |u x v| + v (c d|u x v|/dv)
    share = rod.drag / speed if speed > 0.0 else 0.0
    by_v = diagonal(-drag) - outer(v, share * (v - dot(v, u) * u))
    return static, diagonal(-rod.limit_t) - outer(more * n, n), -drag * v, by_v


@compiled
def rod_cull(rod, level):
    """Return the depth of a rod's deeper end [m] (see `LawKernel.cull`)."""
    middle = level.depth - dot(level.normal, rod.center)
    return middle + rod.half_length * abs(dot(level.normal, rod.axis))


@cache
def link_kernel(limits: Any, probe: Any, ceiling: Any = None, lanes: int = 1) -> LawKernel:
    """Make the kernels of one form of the law, whose `limits` are a kernel like `lumped_limits`.

    `probe` and `ceiling` are the surface's; there is one lane if a body is one rod.
    """

    @partial(compiled, inline=True)
    def link_sample(rod, pose, law, surface, g):
        center = pose.position + pose.rotation @ rod.center
        axis = pose.rotation @ rod.axis
        # T is the deeper end; let the axis point from the midpoint to it.
        half = rod.half_length
        depth, normal = probe(surface, center + half * axis)
        other, other_normal = probe(surface, center - half * axis)
        if other > depth:
            depth, normal, axis = other, other_normal, -axis
        length, limit_n, limit_t = 0.0, 0.0, 0.0
        if depth > 0.0:
            length = 2.0 * half
            cos_q = -dot(axis, normal)
            if depth < length * cos_q:
                length = depth / cos_q
            center += (half - 0.5 * length) * axis  # eq. (5): L_CE
            limit_n, limit_t = limits(depth, cos_q, length, rod.width, law, g)
        drag = law.eta_d * law.density * rod.width * length
        return RodSample(depth, length, center, axis, normal, limit_n, limit_t, drag)

    return LawKernel(
        Rod,
        RodSample,
        link_sample,
        link_respond,
        TWO_LIMITS,
        lanes=lanes,
        probe=ceiling,
        cull=None if ceiling is None else rod_cull,
    )


@dataclass(frozen=True)
class _LinkForm(Law):
    """Base of both forms of the law: coefficients, and a kernel over rods."""

    limits: ClassVar[Any]
    # Not `density`, which the whole law is proportional to: strength and density are separate.
    strength_keys: ClassVar[tuple[str, ...]] = ("eta_h", "eta_v")
    density_keys: ClassVar[tuple[str, ...]] = ("eta_d",)
    validity: ClassVar[tuple[Limit, ...]] = (
        Limit("slope", math.radians(10), "written for a level surface; 10 degrees is chosen"),
    )

    eta_d: float
    eta_h: float
    eta_v: float
    exponent: float

    def __post_init__(self) -> None:
        self.check_numbers(*LINK_KEYS)

    @classmethod
    def from_medium(cls, medium: Medium | str) -> Self:
        return cls(**constants_of(cls, medium, LinkLaw.name))

    def parameters(self, medium: Medium) -> np.ndarray:
        coefficients = {key: getattr(self, key) for key in LINK_KEYS}
        return record_of(**coefficients, density=medium.density.value)

    def kernel(self, surface: Surface) -> LawKernel:
        return link_kernel(type(self).limits, surface.probe_kernel())


@register_law
@dataclass(frozen=True)
class LinkLaw(_LinkForm):
    r"""The lumped link law: one force on each rod, at the centroid E of its immersed part.

    $$
    F = -\eta_d \rho_g A_r |v_E| v_E
        - \operatorname{sign}(v_n)\, \eta_v (y_T/d)^\lambda g \rho_g V\, n
        - \eta_h g \rho_g y_T^2 d\, v_t / |v_t|
    $$

    The force acts at E: rotation about E is not resisted.

    Attributes:
        eta_d: dynamic (drag) coefficient, eq. (2).
        eta_h: horizontal static coefficient, eq. (10).
        eta_v: vertical static coefficient, eq. (11).
        exponent: exponent lambda of the vertical static force, eq. (11).

    Raises:
        InputError: a coefficient that is negative or not finite.
    """

    name: ClassVar[str] = "link"
    title: ClassVar[str] = "slender link, lumped: static force by depth, drag by speed squared"
    citation: ClassVar[str] = _LINK_PAPER
    limits: ClassVar[Any] = lumped_limits

    def elements(
        self, model: mujoco.MjModel, geoms: Sequence[int], resolution: int | None = None
    ) -> np.ndarray:
        return rods_from_model(model, geoms)


@register_law
@dataclass(frozen=True)
class DistributedLinkLaw(_LinkForm):
    r"""The link law spread along the axis: resists rotation too, and a link can come to rest.

    $$
    dF = -\eta_d \rho_g d\, |u \times v| v\, ds
         - \operatorname{sign}(v_n) (1 + \lambda) \eta_v (y/d)^\lambda g \rho_g
           \tfrac{\pi d^2}{4}\, n\, ds
         - 2 \eta_h g \rho_g y\, d \cos q\, v_t / |v_t|\, ds
    $$

    In pure translation its sum is that of `LinkLaw`.

    Attributes:
        eta_d: dynamic (drag) coefficient.
        eta_h: horizontal static coefficient.
        eta_v: vertical static coefficient.
        exponent: exponent lambda of the vertical static force.
        pieces: number of pieces each rod is cut into; 20 is chosen, not measured.

    Raises:
        InputError: a coefficient that is negative or not finite, or no piece.
    """

    name: ClassVar[str] = "link_distributed"
    title: ClassVar[str] = "slender link, spread along its axis: resists rotation too"
    citation: ClassVar[str] = f"{_LINK_PAPER}; differentiated along the axis"
    limits: ClassVar[Any] = distributed_limits

    pieces: int = 20

    def __post_init__(self) -> None:
        super().__post_init__()
        check_count("DistributedLinkLaw: pieces", self.pieces)

    def elements(
        self, model: mujoco.MjModel, geoms: Sequence[int], resolution: int | None = None
    ) -> np.ndarray:
        pieces = self.pieces if resolution is None else resolution
        return cut_rods(rods_from_model(model, geoms), pieces)

    def kernel(self, surface: Surface) -> LawKernel:
        probe, ceiling = surface.probe_kernel(), surface.ceiling_kernel()
        return link_kernel(type(self).limits, probe, ceiling, lanes=4)
