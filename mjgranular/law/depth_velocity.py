"""Laws of one force on a body, by its depth and its velocity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, ClassVar, Self

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled
from mjgranular.law.kernel import LawKernel, grip_of_all, in_world
from mjgranular.law.law import Law, constants_of, register_law
from mjgranular.law.validity import Limit
from mjgranular.medium import Medium
from mjgranular.shape.blobs import blob_records, blobs_from_model, support
from mjgranular.surface import Surface

_KEYS = ("constant", "stiffness", "exponent", "linear", "quadratic")
DEPTH_VELOCITY_DTYPE = np.dtype([(key, np.float64) for key in _KEYS])


@compiled
def depth_velocity_resist(blob, law, g, v, d):
    """Resistance of an immersed blob to a velocity (see `law.kernel`)."""
    limit = blob[5]
    vx, vy, vz = v
    dx, dy, dz = d
    drag = law.linear + law.quadratic * math.sqrt(dx * dx + dy * dy + dz * dz)
    speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    static = 0.0
    if speed > 0.0:
        static = limit / speed
    return -drag * dx - static * vx, -drag * dy - static * vy, -drag * dz - static * vz


@compiled
def depth_velocity_respond(blob, law, g, v, p, eps):
    """Resistance and its derivative, rest made soft (see `law.kernel`)."""
    vx, vy, vz = v
    square = vx * vx + vy * vy + vz * vz
    scale = 1.0 / math.sqrt(square + eps * eps)
    hold = scale * blob[5]
    # d(A |v| v)/dv = A (|v| + v v / |v|)
    speed = math.sqrt(square)
    turn = law.quadratic / speed if speed > 0.0 else 0.0
    gain = hold + law.linear + law.quadratic * speed
    bx, by, bz = scale * vx - p[0], scale * vy - p[1], scale * vz - p[2]
    hold *= scale
    ux, uy, uz = turn * vx - hold * p[0], turn * vy - hold * p[1], turn * vz - hold * p[2]
    return (
        -gain * vx, -gain * vy, -gain * vz,
        gain + ux * vx, ux * vy, ux * vz,
        uy * vx, gain + uy * vy, uy * vz,
        uz * vx, uz * vy, gain + uz * vz,
        bx * bx + by * by + bz * bz,
    )  # fmt: skip


@cache
def depth_velocity_kernel(probe: Any) -> LawKernel:
    """The law's kernels for surfaces with that `probe`."""

    @partial(compiled, inline=True)
    def depth_velocity_immerse(blob, pose, law, surface, g):
        x, y, z = in_world(pose, blob.center[0], blob.center[1], blob.center[2])
        px, py, pz = pose.position[0] + x, pose.position[1] + y, pose.position[2] + z
        # The normal above the centre says which point is deepest; its depth is what counts.
        _, zx, zy, zz = probe(surface, px, py, pz)
        r = pose.rotation
        reach = support(
            blob,
            r[0] * zx + r[3] * zy + r[6] * zz,
            r[1] * zx + r[4] * zy + r[7] * zz,
            r[2] * zx + r[5] * zy + r[8] * zz,
        )
        depth, zx, zy, zz = probe(surface, px - reach * zx, py - reach * zy, pz - reach * zz)
        limit = 0.0
        if depth > 0.0:
            limit = law.constant + law.stiffness * depth**law.exponent
        return depth, 0.0, px, py, pz, limit

    return LawKernel(
        blob_records,
        depth_velocity_immerse,
        depth_velocity_resist,
        depth_velocity_respond,
        grip_of_all,
        numbers=1,
    )


@register_law
@dataclass(frozen=True)
class DepthVelocityLaw(Law):
    r"""One force on each geom, at its centre, against the velocity of the centre.

    .. math::
        F_R(z, v) = C + k z^n + B v + A v^2

    with z the depth of the geom's deepest point below the surface. The force acts while z > 0.
    Every model that the link paper surveys is a case of it; the named constructors are those.

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
        for key in _KEYS:
            value = getattr(self, key)
            if not (math.isfinite(value) and value >= 0):
                raise InputError(
                    f"DepthVelocityLaw: {key} must be finite and not negative, not {value}"
                )

    @classmethod
    def bingham(cls, *, constant: float, linear: float) -> Self:
        """F = F0 + b v: a viscoplastic medium at low speed (de Bruyn and Walsh)."""
        return cls(constant=constant, linear=linear)

    @classmethod
    def poncelet(cls, *, constant: float, quadratic: float) -> Self:
        """F = F0 + c v^2: ballistics."""
        return cls(constant=constant, quadratic=quadratic)

    @classmethod
    def allen_mayfield_morrison(cls, *, quadratic: float, linear: float, constant: float) -> Self:
        """F = A v^2 + B v + C: penetration of sand."""
        return cls(quadratic=quadratic, linear=linear, constant=constant)

    @classmethod
    def lohse(cls, *, stiffness: float) -> Self:
        """F = k z: loose, very fine sand."""
        return cls(stiffness=stiffness)

    @classmethod
    def tsimring_volfson(cls, *, stiffness: float, quadratic: float) -> Self:
        """F = k z + c v^2: the generalised Poncelet model, for large projectiles."""
        return cls(stiffness=stiffness, quadratic=quadratic)

    @classmethod
    def katsuragi_durian(cls, *, mass: float, stiffness: float, drag_length: float) -> Self:
        """F = k z + m v^2 / d1: spheres.

        Args:
            mass: of the sphere, m [kg].
            stiffness: k [N/m].
            drag_length: d1 [m].
        """
        if not drag_length > 0:
            raise InputError(f"the drag length d1 must be positive, not {drag_length} m")
        return cls(stiffness=stiffness, quadratic=mass / drag_length)

    @classmethod
    def from_medium(cls, medium: Medium | str) -> Self:
        return cls(**constants_of(cls, medium))

    def elements(
        self, model: mujoco.MjModel, geoms: Sequence[int], resolution: int | None = None
    ) -> np.ndarray:
        return blobs_from_model(model, geoms)

    def parameters(self, medium: Medium) -> np.ndarray:
        parameters = np.zeros(1, DEPTH_VELOCITY_DTYPE)
        for key in _KEYS:
            parameters[key] = getattr(self, key)
        return parameters

    def kernel(self, surface: Surface) -> LawKernel:
        return depth_velocity_kernel(type(surface).probe)
