"""Laws of one force on a body, by its depth and its velocity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, Self

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import (
    BODIES,
    BODY_COUNT,
    CONTACTS,
    ELEMENT_COUNT,
    ELEMENTS,
    NBODY,
    SCENE,
    SUBTREE_COM,
    XIPOS,
    XMAT,
    XPOS,
    floats,
    records,
)
from mjgranular.kernel.motion import add_force, body_velocity, velocity_at, velocity_change
from mjgranular.kernel.records import body_records, contact_records
from mjgranular.law.law import Law, constants_of, register_law
from mjgranular.law.validity import Limit
from mjgranular.medium import Medium
from mjgranular.shape.blobs import blob_records, blobs_from_model, support
from mjgranular.surface import Surface

_KEYS = ("constant", "stiffness", "exponent", "linear", "quadratic")
DEPTH_VELOCITY_DTYPE = np.dtype([(key, np.float64) for key in _KEYS])


@cache
def depth_velocity_kernel(probe: Any, scene_dtype: np.dtype) -> Any:
    """The law's kernel for surfaces with that `probe` (see `Law.kernel`)."""
    scene_records = records(scene_dtype)

    @compiled
    def depth_velocity_wrenches(table, lead):
        blobs = blob_records(table[ELEMENTS], table[ELEMENT_COUNT])
        contacts = contact_records(table[CONTACTS], table[ELEMENT_COUNT])
        bodies = body_records(table[BODIES], table[BODY_COUNT])
        scene = scene_records(table[SCENE], 1)
        law = scene[0].law
        surface = scene[0].surface
        nbody = table[NBODY]
        xpos = floats(table[XPOS], 3 * nbody)
        xmat = floats(table[XMAT], 9 * nbody)
        xipos = floats(table[XIPOS], 3 * nbody)
        subtree_com = floats(table[SUBTREE_COM], 3 * nbody)

        for slot in range(len(bodies)):
            bodies[slot].wrench[:] = 0.0

        for i in range(len(blobs)):
            blob = blobs[i]
            contact = contacts[i]
            body = bodies[blob.slot]
            b = body.body
            m = 9 * b
            lx, ly, lz = blob.center[0], blob.center[1], blob.center[2]
            px = xpos[3 * b] + xmat[m] * lx + xmat[m + 1] * ly + xmat[m + 2] * lz
            py = xpos[3 * b + 1] + xmat[m + 3] * lx + xmat[m + 4] * ly + xmat[m + 5] * lz
            pz = xpos[3 * b + 2] + xmat[m + 6] * lx + xmat[m + 7] * ly + xmat[m + 8] * lz
            # The normal above the centre says which point is deepest; its depth is what counts.
            _, zx, zy, zz = probe(surface, px, py, pz)
            reach = support(
                blob,
                xmat[m] * zx + xmat[m + 3] * zy + xmat[m + 6] * zz,
                xmat[m + 1] * zx + xmat[m + 4] * zy + xmat[m + 7] * zz,
                xmat[m + 2] * zx + xmat[m + 5] * zy + xmat[m + 8] * zz,
            )
            depth, zx, zy, zz = probe(surface, px - reach * zx, py - reach * zy, pz - reach * zz)
            contact.depth = depth
            if depth <= 0.0:
                continue
            contact.length = 0.0
            root = 3 * body.root
            tx, ty, tz = (
                px - subtree_com[root],
                py - subtree_com[root + 1],
                pz - subtree_com[root + 2],
            )
            vx, vy, vz = velocity_at(body_velocity(table, b), tx, ty, tz)
            contact.point[0], contact.point[1], contact.point[2] = px, py, pz
            contact.velocity[0], contact.velocity[1], contact.velocity[2] = vx, vy, vz

            dx, dy, dz = vx, vy, vz
            if lead != 0.0:
                change = velocity_at(velocity_change(table, body.last_dof, lead), tx, ty, tz)
                dx, dy, dz = vx + change[0], vy + change[1], vz + change[2]
            drag = law.linear + law.quadratic * math.sqrt(dx * dx + dy * dy + dz * dz)
            speed = math.sqrt(vx * vx + vy * vy + vz * vz)
            static = 0.0
            if speed > 0.0:
                static = (law.constant + law.stiffness * depth**law.exponent) / speed
            fx = -drag * dx - static * vx
            fy = -drag * dy - static * vy
            fz = -drag * dz - static * vz
            contact.force[0], contact.force[1], contact.force[2] = fx, fy, fz

            px, py, pz = px - xipos[3 * b], py - xipos[3 * b + 1], pz - xipos[3 * b + 2]
            add_force(body.wrench, fx, fy, fz, px, py, pz)

    return depth_velocity_wrenches


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
    def from_medium(cls, medium: Medium) -> Self:
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

    def kernel(self, surface: Surface, scene: np.dtype) -> Any:
        return depth_velocity_kernel(type(surface).probe, scene)
