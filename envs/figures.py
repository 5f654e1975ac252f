"""The sand's figures, read from sensors: the same for one simulation and for many."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.engine.instances import sands_in
from mjgranular.engine.readings import SandReadings
from mjgranular.envs.ground import (
    BODY_FORCE,
    BODY_MOMENT,
    DEPTH,
    FORCE,
    POWER,
    SPEED,
)
from mjgranular.law.validity import Measure
from mjgranular.sand import SandSpec
from mjgranular.sand.material import material_of
from mjgranular.sand.prepare import geoms_in_sand
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

    def read(
        self, readings: np.ndarray, active: np.ndarray | int = 0, slope: np.ndarray | float = 0.0
    ) -> dict[str, np.ndarray]:
        """The sand's figures of n simulations.

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
            `sand/froude`; `sand/valid`: whether the law holds.
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
        }


class Wrenches:
    """The sand's forces on bodies as MuJoCo's `cfrc_ext` has those of contacts.

    Args:
        model: the model.
        bodies: ids of the bodies that meet the sand.
        blocks: where the forces and moments of these bodies begin in what is read, for each sand.
    """

    def __init__(self, model: mujoco.MjModel, bodies: Sequence[int], blocks: Sequence[int]) -> None:
        self._blocks, self._count = blocks, len(bodies)
        roots = model.body_rootid[list(bodies)]
        # Slices where they will do: they are quicker, and this is done at every step.
        self._bodies = _slice(bodies)
        self._roots = slice(roots[0], roots[0] + 1) if (roots == roots[0]).all() else roots

    @classmethod
    def of_sensors(cls, model: mujoco.MjModel) -> Wrenches:
        """Those that the sensors of a model measure, made by `put_on_sand` with `wrenches`."""
        sensors = {model.sensor(i).name: int(model.sensor_adr[i]) for i in range(model.nsensor)}
        sands = sands_in(model)
        bodies = [
            body
            for body in range(model.nbody)
            if f"{BODY_FORCE}{model.body(body).name}/{sands[0]}" in sensors
        ]
        # Of each sand the sensors stand side by side, body by body: force, moment.
        blocks = [sensors[f"{BODY_FORCE}{model.body(bodies[0]).name}/{sand}"] for sand in sands]
        for sand, begin in zip(sands, blocks, strict=True):
            for row, body in enumerate(bodies):
                name = model.body(body).name
                assert sensors[f"{BODY_FORCE}{name}/{sand}"] == begin + 6 * row
                assert sensors[f"{BODY_MOMENT}{name}/{sand}"] == begin + 6 * row + 3
        return cls(model, bodies, blocks)

    def of(
        self, readings: np.ndarray, centres: np.ndarray, origins: np.ndarray, nbody: int
    ) -> np.ndarray:
        """Moments and forces as in `cfrc_ext`: about the mass centre of the body's tree.

        Args:
            readings: `sensordata`, shape (n, nsensordata).
            centres: `xipos`, shape (n, nbody, 3).
            origins: `subtree_com`, shape (n, nbody, 3).
            nbody: number of bodies.

        Returns:
            Moment and force on each body, world axes, shape (n, nbody, 6).
        """
        count, first = 6 * self._count, self._blocks[0]
        block = readings[:, first : first + count]
        for other in self._blocks[1:]:
            block = block + readings[:, other : other + count]
        block = block.reshape(len(readings), self._count, 6)
        arm = centres[:, self._bodies] - origins[:, self._roots]
        ax, ay, az = arm[..., 0], arm[..., 1], arm[..., 2]
        fx, fy, fz = block[..., 0], block[..., 1], block[..., 2]
        wrench = np.zeros((len(readings), nbody, 6))
        wrench[:, self._bodies, 0] = ay * fz - az * fy + block[..., 3]
        wrench[:, self._bodies, 1] = az * fx - ax * fz + block[..., 4]
        wrench[:, self._bodies, 2] = ax * fy - ay * fx + block[..., 5]
        wrench[:, self._bodies, 3:] = block[..., :3]
        return wrench


class _Limits:
    """Up to where the law of a sand holds in a model."""

    def __init__(self, model: mujoco.MjModel, sand: SandSpec) -> None:
        geoms = geoms_in_sand(model, sand)
        _, law = material_of(model, geoms, sand)
        elements = law.elements(model, geoms, sand.resolution)
        self._limits = law.validity
        self.width = float(elements["width"].min())
        self.tilt = surface_of(sand.surface).tilt(model)

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


def _slice(numbers: Sequence[int]) -> slice | np.ndarray:
    """The numbers as a slice, if they follow one another."""
    if list(numbers) == list(range(numbers[0], numbers[0] + len(numbers))):
        return slice(numbers[0], numbers[0] + len(numbers))
    return np.array(numbers)
