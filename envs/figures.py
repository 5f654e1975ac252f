"""The sand's figures, read from sensors: the same for one simulation and for many."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.envs.ground import (
    BODY_FORCE,
    BODY_MOMENT,
    DEPTH,
    FORCE,
    POWER,
    SPEED,
    Ground,
    instances_of,
)
from mjgranular.law import get_law
from mjgranular.law.validity import Measure
from mjgranular.medium.medium import get_medium
from mjgranular.shape import select_geoms
from mjgranular.surface import Plane


class Figures:
    """Reads the sensors that `put_on_sand` has added.

    Args:
        model: the model.
        grounds: the sands in it, in the order in which they were added.
    """

    def __init__(self, model: mujoco.MjModel, grounds: Sequence[Ground]) -> None:
        names = instances_of(model)
        self._first = {
            measure: np.array([_address(model, f"{measure}/{name}") for name in names])
            for measure in (FORCE, DEPTH, POWER, SPEED)
        }
        self._gravity = float(np.linalg.norm(model.opt.gravity))
        limits = [_Limits(model, ground) for ground in grounds]
        self._width = np.array([limit.width for limit in limits])
        self._froude = np.array([limit.most("froude") for limit in limits])
        self._depth = np.array([limit.most("depth_over_width") for limit in limits])
        self._slope = np.array([limit.most("slope") for limit in limits])
        self._tilt = np.array([limit.tilt for limit in limits])

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
        force = readings[:, self._first[FORCE][0, None] + np.arange(3)]
        depth, power, speed = (
            readings[:, self._first[measure][0]] for measure in (DEPTH, POWER, SPEED)
        )
        for other in range(1, len(self._width)):
            force = force + readings[:, self._first[FORCE][other, None] + np.arange(3)]
            depth = depth + readings[:, self._first[DEPTH][other]]
            power = power + readings[:, self._first[POWER][other]]
            speed = speed + readings[:, self._first[SPEED][other]]
        width = self._width[active]
        froude = speed / np.sqrt(self._gravity * width)
        valid = (
            (froude <= self._froude[active])
            & (depth <= self._depth[active] * width)
            & (np.abs(slope) + self._tilt[active] <= self._slope[active])
        )
        # Copies, so that nobody holds a view of the simulation's own memory.
        return {
            "sand/force": np.array(force),
            "sand/depth": np.array(depth),
            "sand/power": np.array(power),
            "sand/froude": froude,
            "sand/valid": valid,
        }


class Wrenches:
    """The sand's forces on bodies as MuJoCo's `cfrc_ext` has those of contacts.

    Args:
        model: made by `put_on_sand` with `wrenches`.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._bodies: list[int] = []
        self._force: list[np.ndarray] = []
        self._moment: list[np.ndarray] = []
        for sand in instances_of(model):
            for body in range(1, model.nbody):
                name = model.body(body).name
                sensor = f"{BODY_FORCE}{name}/{sand}"
                if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, sensor) < 0:
                    continue
                self._bodies.append(body)
                self._force.append(_address(model, sensor) + np.arange(3))
                self._moment.append(
                    _address(model, f"{BODY_MOMENT}{name}/{sand}") + np.arange(3)
                )
        self._forces, self._moments = np.array(self._force), np.array(self._moment)
        self._body = np.array(self._bodies)
        self._root = model.body_rootid[self._body]

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
        force, moment = readings[:, self._forces], readings[:, self._moments]
        arm = centres[:, self._body] - origins[:, self._root]
        wrench = np.zeros((len(readings), nbody, 6))
        turned = np.stack(
            [
                arm[..., 1] * force[..., 2] - arm[..., 2] * force[..., 1],
                arm[..., 2] * force[..., 0] - arm[..., 0] * force[..., 2],
                arm[..., 0] * force[..., 1] - arm[..., 1] * force[..., 0],
            ],
            axis=-1,
        )
        for row, body in enumerate(self._bodies):
            wrench[:, body, :3] += moment[:, row] + turned[:, row]
            wrench[:, body, 3:] += force[:, row]
        return wrench


class _Limits:
    """Up to where the law of a ground holds in a model."""

    def __init__(self, model: mujoco.MjModel, ground: Ground) -> None:
        law = get_law(ground.law, get_medium(ground.medium))
        surface = ground.surface or Plane()
        geoms = select_geoms(model, geoms=ground.geoms, leave_out=surface.geoms(model))
        self._limits = law.validity
        self.width = float(law.elements(model, geoms, ground.resolution)["width"].min())
        self.tilt = surface.tilt(model)

    def most(self, measure: Measure) -> float:
        return min((v.most for v in self._limits if v.measure == measure), default=math.inf)


def _address(model: mujoco.MjModel, name: str) -> int:
    return int(model.sensor(name).adr[0])
