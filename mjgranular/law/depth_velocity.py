"""Laws with one force per body, from its depth and its velocity."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, ClassVar, NamedTuple

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import Matrix, Vector, diagonal, norm, outer, transposed
from mjgranular.law.kernel import LawKernel
from mjgranular.law.law import Law, register_law
from mjgranular.law.validity import Limit
from mjgranular.shape.single import blobs_from_model, support
from mjgranular.surface import Surface


class Blob(NamedTuple):
    """A whole body, body frame (`shape.single`)."""

    center: Vector
    axes: Matrix
    radii: Vector
    halves: Vector
    disc: float


class BlobSample(NamedTuple):
    """A blob in the sand."""

    depth: float
    length: float
    point: Vector
    limit: float  # of static resistance [N]


@partial(compiled, inline=True)
def depth_velocity_respond(blob, law, g, v, p, eps):
    """Return resistance and its derivatives (see `LawKernel.respond`)."""
    speed = norm(v)
    drag = law.linear + law.quadratic * speed
    # d(A |v| v)/dv = A (|v| + v v / |v|)
    share = law.quadratic / speed if speed > 0.0 else 0.0
    by_v = diagonal(-drag) - outer(share * v, v)
    return -blob.limit * p, diagonal(-blob.limit), -drag * v, by_v


@cache
def depth_velocity_kernel(probe: Any) -> LawKernel:
    """Make the law's kernels for surfaces with that `probe`."""

    @partial(compiled, inline=True)
    def depth_velocity_sample(blob, pose, law, surface, g):
        center = pose.position + pose.rotation @ blob.center
        # The normal above the center determines the deepest point; its depth is used.
        _depth, normal = probe(surface, center)
        reach = support(blob, transposed(pose.rotation) @ normal)
        depth, _normal = probe(surface, center - reach * normal)
        limit = 0.0
        if depth > 0.0:
            limit = law.constant + law.stiffness * depth**law.exponent
        return BlobSample(depth, 0.0, center, limit)

    return LawKernel(Blob, BlobSample, depth_velocity_sample, depth_velocity_respond)


@register_law
@dataclass(frozen=True)
class DepthVelocityLaw(Law):
    r"""One force on each geom, at its center, against the velocity of the center.

    $$
    F_R(z, v) = C + k z^n + B v + A v^2
    $$

    with z the depth of the geom's deepest point below the surface. The force acts while z > 0.
    Every model that the link paper surveys is a special case; that of Katsuragi and Durian has k
    and A = m / d1 with the mass m of the sphere and their drag length d1.

    Attributes:
        constant: C [N].
        stiffness: k [N/m^n].
        exponent: n.
        linear: B [N s/m].
        quadratic: A [N s^2/m^2].

    Raises:
        InputError: a value that is negative or not finite.
    """

    name: ClassVar[str] = "depth_velocity"
    title: ClassVar[str] = "one force a body: C + k z^n + B v + A v^2"
    citation: ClassVar[str] = (
        "cases of C + k z^n + B v + A v^2: Bingham (J. R. de Bruyn, A. M. Walsh, Can. J. Phys. 82 "
        "(2004)), Poncelet, Allen-Mayfield-Morrison (J. Appl. Phys. 28 (1957)), Lohse et al. "
        "(Nature 432 (2004)), Tsimring and Volfson (Powders and Grains 2005), H. Katsuragi, "
        "D. J. Durian (Nature Physics 3 (2007))"
    )

    strength_keys: ClassVar[tuple[str, ...]] = ("constant", "stiffness")
    density_keys: ClassVar[tuple[str, ...]] = ("linear", "quadratic")
    validity: ClassVar[tuple[Limit, ...]] = (
        Limit("slope", math.radians(10), "measured on level surfaces; 10 degrees is chosen"),
    )

    constant: float = 0.0
    stiffness: float = 0.0
    exponent: float = 1.0
    linear: float = 0.0
    quadratic: float = 0.0

    def __post_init__(self) -> None:
        self.check_numbers("constant", "stiffness", "exponent", "linear", "quadratic")

    def elements(
        self, model: mujoco.MjModel, geoms: Sequence[int], resolution: int | None = None
    ) -> np.ndarray:
        return blobs_from_model(model, geoms)

    def kernel(self, surface: Surface) -> LawKernel:
        return depth_velocity_kernel(surface.probe_kernel())
