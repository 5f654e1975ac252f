"""The sand's figures, read from sensors: the same for one simulation and for many."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.engine.instances import sands_in
from mjgranular.engine.readings import SandReadings
from mjgranular.envs.ground import DEPTH, FORCE, POWER, SPEED
from mjgranular.law.validity import Measure, found_at
from mjgranular.sand import SandSpec
from mjgranular.sand.chosen import geoms_in_sand
from mjgranular.sand.material import material_of
from mjgranular.surface.choice import surface_of


class Figures:
    """Reads the sensors that `put_on_sand` has added.

    Args:
        model: the model.
        sands: in it, in the order in which they were added.
        readings: what is read where the model has no such sensors.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        sands: Sequence[SandSpec],
        readings: SandReadings | None = None,
    ) -> None:
        self.sands = names = sands_in(model)
        # The sensors of a sand stand side by side: force, depth, power, speed.
        self._blocks = readings.together if readings else _blocks_of_sensors(model, names)
        gravity = float(np.linalg.norm(model.opt.gravity))
        limits = [_Limits(model, sand) for sand in sands]
        width = np.array([limit.width for limit in limits])
        self._per_speed = 1 / np.sqrt(gravity * width)  # Froude number of 1 m/s
        self._froude = np.array([limit.most("froude") for limit in limits])
        self._depth = np.array([limit.most("depth_over_width") for limit in limits]) * width
        self._slope = np.array([limit.most("slope") - limit.tilt for limit in limits])
        self._found = [limit.found() for limit in limits]

    def read(
        self, readings: np.ndarray, active: np.ndarray | int = 0, slope: np.ndarray | float = 0.0
    ) -> dict[str, np.ndarray]:
        """Return the sand's figures of n simulations.

        They are those of the last substep. The Froude number is |v| / sqrt(g w) with the greatest
        speed in the sand and the smallest width of a geom that meets it: never too small. Whether
        the law holds is judged by that, by depth over that width and by the slope; the grains'
        inertia is not looked at.

        Args:
            readings: `sensordata`, shape (n, nsensordata).
            active: number of the sand that is switched on, shape (n,); others read nothing.
            slope: of the ground beside that of its surface [rad], shape (n,).

        Returns:
            `sand/force`: of the sand on the robot [N], world axes, shape (n, 3); `sand/depth`: of
            its deepest point [m], negative above the sand; `sand/power`: of the sand on it [W];
            `sand/froude`; `sand/valid`: whether the law holds; `sand/error`: found where the law
            was held against measured motion as fast as this, in parts and at most 1; 1 where
            nothing as fast was compared, 0 above the sand.
        """
        first, *others = self._blocks
        block = readings[:, first : first + 6].copy()  # nobody is to hold the simulation's memory
        for other in others:
            block += readings[:, other : other + 6]
        sand = active if others else 0
        depth, speed = block[:, 3], block[:, 5]
        froude = speed * self._per_speed[sand]
        valid = (
            (froude <= self._froude[sand])
            & (depth <= self._depth[sand])
            & (np.abs(slope) <= self._slope[sand])
        )
        return {
            "sand/force": block[:, :3],
            "sand/depth": depth,
            "sand/power": block[:, 4],
            "sand/froude": froude,
            "sand/valid": valid,
            "sand/error": np.where(depth > 0, self._errors(sand, froude), 0.0),
        }

    def _errors(self, active: np.ndarray | int, froude: np.ndarray) -> np.ndarray:
        """Errors found at Froude numbers, for the sand that is switched on; shape (n,)."""
        error = np.ones(froude.shape)
        for sand, (bounds, errors) in enumerate(self._found):
            mine = np.broadcast_to(np.asarray(active) == sand, froude.shape)
            error[mine] = errors[np.searchsorted(bounds, froude[mine])]
        return error


class _Limits:
    """Up to where the law of a sand holds in a model."""

    def __init__(self, model: mujoco.MjModel, sand: SandSpec) -> None:
        geoms = geoms_in_sand(model, sand)
        medium, law = material_of(model, sand)
        elements = law.elements(model, geoms, sand.resolution)
        self._limits = law.validity
        self.width = float(elements["width"].min())
        grain = medium.grain and medium.grain.value
        self._grains = None if grain is None else self.width / grain
        self._findings = law.findings
        self.tilt = surface_of(sand.surface).tilt(model)

    def found(self) -> tuple[np.ndarray, np.ndarray]:
        """Froude numbers up to which errors were found, and these; one more error, 1, beyond."""
        bounds = sorted({finding.froude for finding in self._findings})
        found = [found_at(self._findings, bound, self._grains) for bound in bounds]
        errors = [1.0 if one is None else min(one.error, 1.0) for one in found]
        return np.array(bounds), np.array([*errors, 1.0])

    def most(self, measure: Measure) -> float:
        return min((v.most for v in self._limits if v.measure == measure), default=math.inf)


def _blocks_of_sensors(model: mujoco.MjModel, names: Sequence[str]) -> list[int]:
    """First readings of each sand in `sensordata`."""
    blocks = [_address(model, f"{FORCE}/{name}") for name in names]
    for name, begin in zip(names, blocks, strict=True):
        for offset, measure in ((3, DEPTH), (4, POWER), (5, SPEED)):
            assert _address(model, f"{measure}/{name}") == begin + offset
    return blocks


def _address(model: mujoco.MjModel, name: str) -> int:
    return int(model.sensor(name).adr[0])
