"""A bed of sand of finite size, from a box geom of the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import dot, read_vector
from mjgranular.shape.sizes import check_extents
from mjgranular.surface.place import find_geom, tilt_of, world_pose
from mjgranular.surface.surface import Surface

BED_DTYPE = np.dtype(
    [
        ("top", np.float64, (3,)),  # center of the upper face [m], world
        ("along", np.float64, (3,)),  # unit vectors of the face and its normal, world
        ("across", np.float64, (3,)),
        ("normal", np.float64, (3,)),
        ("half_along", np.float64),  # [m]
        ("half_across", np.float64),
        ("thickness", np.float64),
    ]
)

# A body on the floor of the bed penetrates it slightly, as contacts in MuJoCo do: the sand reaches
# down by this multiple of the thickness. Chosen, not measured.
_ROOM = 1.1


@compiled
def bed_probe(bed, point):
    """Return the depth below the upper face [m]; outside the bed, minus the distance to it."""
    from_top = point - read_vector(bed.top, 0)
    normal = read_vector(bed.normal, 0)
    along = abs(dot(from_top, read_vector(bed.along, 0))) - bed.half_along
    across = abs(dot(from_top, read_vector(bed.across, 0))) - bed.half_across
    beside = max(along, across)
    depth = -dot(normal, from_top)
    if beside > 0.0:
        depth = -beside
    elif depth > _ROOM * bed.thickness:
        depth = _ROOM * bed.thickness - depth
    return depth, normal


@dataclass(frozen=True)
class Bed(Surface):
    """The sand in a box geom: its upper face (+z of the geom) is the surface.

    Beside and under the box there is no sand. Its lower face is not a floor: put an ordinary geom
    there (a plane, or another box), which bodies meet through MuJoCo's own contacts. The box's own
    contacts are disabled in the model when the sand is bound; an explicit contact pair, which
    cannot be disabled, is an error.

    Attributes:
        geom: name of the box geom; it must be fixed to the world.
    """

    probe: ClassVar[Any] = bed_probe

    geom: str

    def record(self, model: mujoco.MjModel) -> np.ndarray:
        geom = find_geom(model, self.geom, mujoco.mjtGeom.mjGEOM_BOX, "bed")
        position, axes = world_pose(model, geom)
        half = model.geom_size[geom]
        check_extents(f"the bed {self.geom!r}", half)
        bed = np.zeros(1, BED_DTYPE)
        bed["top"] = position + half[2] * axes[:, 2]
        bed["along"], bed["across"], bed["normal"] = axes.T
        bed["thickness"] = 2 * half[2]
        bed["half_along"], bed["half_across"] = half[:2]
        return bed

    def geoms(self, model: mujoco.MjModel) -> tuple[int, ...]:
        return (find_geom(model, self.geom, mujoco.mjtGeom.mjGEOM_BOX, "bed"),)

    def lift(self, model: mujoco.MjModel) -> Mapping[str, np.ndarray]:
        return {"top": self.record(model)["normal"][0]}

    def tilt(self, model: mujoco.MjModel) -> float:
        return tilt_of(self.record(model)["normal"][0], model)
