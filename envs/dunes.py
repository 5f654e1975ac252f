"""Dunes: a height field of waves across the robot's path."""

import math
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

DUNES = "dunes"  # name of the geom and of its height field

_WAVES = ((1.0, 0.0, 0.0), (0.45, 0.8, 1.1), (0.3, -1.3, 2.3))
"""Share of the height, waves along y per wave along x, phase; chosen: ridges that meander."""


@dataclass(frozen=True)
class Dunes:
    """Three sine waves, the longest of them across the x axis; always the same.

    They are as high as their steepest slope allows; laws are valid to ten degrees (`docs/laws`).
    """

    wavelength: float = 4.0  # wavelength of the longest [m]
    extent: float = 40.0  # half size of the dunes along x and y [m]
    steepest: float = math.radians(9)  # steepest slope [rad]; chosen

    def height(self, x: float, y: float) -> float:
        """Return the height over the level ground at a point [m]."""
        return self._wave(math.sin, x, y)

    def _wave(self, sin: Any, x: Any, y: Any) -> Any:
        k = 2 * math.pi / self.wavelength
        slopes = sum(share * k * math.hypot(1.0, across) for share, across, _ in _WAVES)
        waves = (share * sin(k * (x + across * y) + phase) for share, across, phase in _WAVES)
        return math.tan(self.steepest) / slopes * sum(waves)  # no slope exceeds `steepest`

    def heights(self) -> np.ndarray:
        """Return heights on the height field's grid [m], shape (rows over y, columns over x)."""
        count = 2 * round(20 * self.extent / self.wavelength) + 1
        line = np.linspace(-self.extent, self.extent, count)
        return self._wave(np.sin, line[None, :], line[:, None])


def add_dunes(spec: mujoco.MjSpec, dunes: Dunes) -> None:
    """Add dunes around the height of the model's floor."""
    heights = dunes.heights()
    low, high = float(heights.min()), float(heights.max())
    field = spec.add_hfield(name=DUNES)
    field.nrow, field.ncol = heights.shape
    field.size = [dunes.extent, dunes.extent, high - low, 0.1]
    field.userdata = ((heights - low) / (high - low)).ravel().tolist()
    floor = max(
        (float(g.pos[2]) for g in spec.worldbody.geoms if g.type == mujoco.mjtGeom.mjGEOM_PLANE),
        default=0.0,
    )
    spec.worldbody.add_geom(
        name=DUNES,
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname=DUNES,
        pos=[0, 0, floor + low],
        contype=0,
        conaffinity=0,
    )
