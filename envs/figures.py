"""Metrics of the sand, read from sensors: the same for one simulation and for many."""

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
    """Reads the sensors that `put_on_sand` has added, or `readings` that stand in for them."""

    def __init__(
        self,
        model: mujoco.MjModel,
        sands: Sequence[SandSpec],
        readings: SandReadings | None = None,
    ) -> None:
        self.sands = names = sands_in(model)
        # The sensors of a sand are contiguous: force, depth, power, speed.
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
        """Return the sand's metrics of n simulations.

        They are those of the last substep. The Froude number is |v| / sqrt(g w) with the largest
        speed in the sand and the smallest width of a geom that meets it: an upper bound. The law is
        valid depending on it, on depth over that width and on the slope; the grains' inertia is not
        checked.

        Args:
            readings: `sensordata`, shape (n, nsensordata).
            active: index of the active sand, shape (n,); sensors of others read zero.
            slope: slope of the ground in addition to that of its surface [rad], shape (n,).

        Returns:
            `sand/force`: force of the sand on the robot [N], world axes, shape (n, 3);
            `sand/depth`: depth of its deepest point [m], negative above the sand; `sand/power`:
            power of the sand on it [W]; `sand/froude`; `sand/valid`: whether the law is valid;
            `sand/error`: relative error of the law in comparisons with measured motion as fast as
            this, at most 1; 1 where nothing as fast was compared, 0 above the sand.
        """
        first, *others = self._blocks
        block = readings[:, first : first + 6].copy()  # not a view of MuJoCo's array
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
        """Return the measured errors at Froude numbers, for the active sand; shape (n,)."""
        error = np.ones(froude.shape)
        for sand, (bounds, errors) in enumerate(self._found):
            mine = np.broadcast_to(np.asarray(active) == sand, froude.shape)
            error[mine] = errors[np.searchsorted(bounds, froude[mine])]
        return error


class _Limits:
    """Validity limits of a sand's law in a model."""

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
        """Return upper Froude numbers of errors, and the errors, with one more, 1, beyond."""
        bounds = sorted({finding.froude for finding in self._findings})
        found = [found_at(self._findings, bound, self._grains) for bound in bounds]
        errors = [1.0 if one is None else min(one.error, 1.0) for one in found]
        return np.array(bounds), np.array([*errors, 1.0])

    def most(self, measure: Measure) -> float:
        return min((v.most for v in self._limits if v.measure == measure), default=math.inf)


def _blocks_of_sensors(model: mujoco.MjModel, names: Sequence[str]) -> list[int]:
    """Return the index of each sand's first reading in `sensordata`."""
    blocks = [_address(model, f"{FORCE}/{name}") for name in names]
    for name, begin in zip(names, blocks, strict=True):
        for offset, measure in ((3, DEPTH), (4, POWER), (5, SPEED)):
            assert _address(model, f"{measure}/{name}") == begin + offset
    return blocks


def _address(model: mujoco.MjModel, name: str) -> int:
    return int(model.sensor(name).adr[0])
