"""`Relief`: a surface with memory, as laws and schemes see it."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.relief.memory import Memory
from mjgranular.relief.probe import around_kernel, ceiling_kernel, toward_kernel
from mjgranular.surface import Bed, HeightField, Plane, Surface

SLACK = 0.1
"""Depth of a body standing in its track below the sand that it has pressed down [cells]. Chosen."""


@cache
def relief_dtype(base: np.dtype) -> np.dtype:
    """Return the record of a relief over a surface with that record."""
    vectors = [(name, np.float64, (3,)) for name in ("origin", "along", "across", "normal")]
    numbers = ("cell", "slack", "repose", "half_along", "half_across")
    # Addresses: of the state (`grid`), of surface points and of bodies (`footprint`).
    integers = ("size", "blocks", "state", "points", "spheres", "feet", "foot_count")
    return np.dtype(
        [
            ("base", base),
            *vectors,
            *((name, np.float64) for name in numbers),
            *((name, np.int64) for name in integers),
        ]
    )


@dataclass(frozen=True)
class Relief(Surface):
    """A surface with memory; sand up to `surroundings` [m] around a point counts for its level."""

    base: Surface
    memory: Memory
    surroundings: float

    def __post_init__(self) -> None:
        if not isinstance(self.base, (Plane, Bed, HeightField)):
            raise InputError(
                f"a surface of the kind {type(self.base).__name__} cannot remember: memory is for "
                "Plane, Bed and HeightField"
            )
        self.memory.blocks(self.surroundings)

    def probe_kernel(self) -> Any:
        return around_kernel(type(self.base).probe, self.is_flat)

    def toward_kernel(self) -> Any:
        return toward_kernel(type(self.base).probe, self.is_flat)

    def ceiling_kernel(self) -> Any:
        return ceiling_kernel(type(self.base).probe) if type(self.base).is_plane else None

    @property
    def state_size(self) -> int:
        return self.memory.state_size

    @property
    def is_flat(self) -> bool:
        """Return True if the surface itself is locally plane."""
        return isinstance(self.base, (Plane, Bed))

    def record(self, model: mujoco.MjModel) -> np.ndarray:
        base, memory = self.base.record(model), self.memory
        relief = np.zeros(1, relief_dtype(base.dtype))
        relief["base"] = base
        for name, value in frame_of(self.base, base[0]).items():
            relief[name] = value
        relief["cell"], relief["slack"] = memory.cell, SLACK * memory.cell
        relief["repose"] = np.tan(memory.repose)
        relief["size"], relief["blocks"] = memory.size, memory.blocks(self.surroundings)
        return relief

    def geoms(self, model: mujoco.MjModel) -> tuple[int, ...]:
        return self.base.geoms(model)

    def shape(self, model: mujoco.MjModel) -> tuple[np.ndarray, ...]:
        return self.base.shape(model)

    def lift(self, model: mujoco.MjModel) -> Mapping[str, np.ndarray]:
        raise InputError("a surface that remembers cannot be moved: omit memory or tunable")

    def tilt(self, model: mujoco.MjModel) -> float:
        return self.base.tilt(model)


def frame_of(surface: Surface, record: Any) -> dict[str, Any]:
    """Return the plane under the heights: its origin and axes, world, and half its extents [m]."""
    if isinstance(surface, Plane):
        normal = record["normal"]
        along = np.array([1.0, 0.0, 0.0])
        along = along - normal[0] * normal
        along /= np.linalg.norm(along)
        return {
            "origin": record["offset"] * normal,
            "along": along,
            "across": np.cross(normal, along),
            "normal": normal,
            "half_along": np.inf,
            "half_across": np.inf,
        }
    if isinstance(surface, Bed):
        names = ("along", "across", "normal", "half_along", "half_across")
        return {"origin": record["top"], **{name: record[name] for name in names}}
    axes = record["axes"].reshape(3, 3)
    return {
        "origin": record["position"],
        "along": axes[:, 0],
        "across": axes[:, 1],
        "normal": axes[:, 2],
        "half_along": record["half_x"],
        "half_across": record["half_y"],
    }


def place_in_plane(
    surface: Surface, model: mujoco.MjModel, point: np.ndarray
) -> tuple[float, float]:
    """Return the position of a point [m], world, along the axes of the plane under the heights."""
    frame = frame_of(surface, surface.record(model)[0])
    away = point - frame["origin"]
    return float(away @ frame["along"]), float(away @ frame["across"])
