"""Gymnasium's spatial robots as tasks: Ant and Humanoid."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular.envs.gym_planar import Standing, place_in_plane
from mjgranular.envs.task import State


@dataclass(frozen=True, kw_only=True)
class _Spatial(Standing):
    """Base of Ant and Humanoid: free in space, with the same terms of reward and cost."""

    hidden: ClassVar[int] = 2

    ctrl_cost_weight: float = 0.5
    contact_cost_weight: float = 5e-4
    include_cfrc_ext_in_observation: bool = True
    frame_skip: int = 5

    def robot(self) -> mujoco.MjSpec:
        spec = super().robot()
        # MuJoCo computes `cfrc_ext` only if a sensor needs it.
        site = spec.body("torso").add_site(name="needs cfrc_ext")
        spec.add_sensor(
            name=site.name,
            type=mujoco.mjtSensor.mjSENS_FORCE,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=site.name,
        )
        return spec

    def raise_by(self, qpos: np.ndarray, height: Callable[[float, float], float]) -> None:
        reach = (-0.6, 0.0, 0.6)  # [m]; chosen: the robots are about a meter across
        qpos[2] += max(height(float(qpos[0]) + x, float(qpos[1]) + y) for x in reach for y in reach)

    def total(self, terms: dict[str, np.ndarray]) -> np.ndarray:
        costs = terms["reward_ctrl"] + terms["reward_contact"]
        return terms["reward_forward"] + terms["reward_survive"] + costs

    def where(self, state: State) -> np.ndarray:
        """Return the position whose speed is rewarded, shape (n, 2)."""
        raise NotImplementedError

    def here(self, state: State) -> np.ndarray:
        """Return `where`, computed once."""
        return self.once(state, "where", self.where)

    def mark(self, state: State) -> np.ndarray:
        return np.array(self.where(state))

    def speed(self, before: np.ndarray, state: State) -> np.ndarray:
        return (self.here(state)[:, 0] - before[:, 0]) / self.dt

    def place(self, state: State) -> dict[str, np.ndarray]:
        return place_in_plane(state)

    def progress(self, before: Any, state: State) -> dict[str, np.ndarray]:
        x, y = ((self.here(state) - before) / self.dt).T
        return {"x_velocity": x, "y_velocity": y}


@dataclass(frozen=True, kw_only=True)
class Ant(_Spatial):
    """Run on sand on four legs.

    ## Description
    Gymnasium's `Ant-v5` on Quikrete medium sand. What is not said here is as there;
    `mjgranular.envs.on_sand` says what sand changes.

    ## Action Space
    `Box(-1, 1, (8,), float32)`: torques at hips and ankles.

    ## Observation Space
    `Box(-inf, inf, (105,), float64)`: positions but x and y, velocities, and `cfrc_ext` of each
    body, clipped as there, with the sand's forces in it.

    ## Rewards
    `reward_forward` + `reward_survive` + `reward_ctrl` + `reward_contact`, as in `Ant-v5`; the
    contact cost is that of the sand's forces.

    ## Starting State
    As in `Ant-v5`.

    ## Episode End
    Terminated when unhealthy, as in `Ant-v5`. Truncated after 1000 steps.

    ## Arguments
    Those of `Ant-v5` but `xml_file`, `main_body` and those of cameras, and those of `Task`.

    ## Version History
    v0: first.
    """

    title: ClassVar[str] = "Gymnasium's Ant on sand"
    xml: ClassVar[str] = "ant.xml"
    gaussian: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("xpos", "cfrc_ext")
    camera: ClassVar[dict[str, Any]] = {"trackbodyid": 1, "distance": 4.0, "elevation": -20.0}

    reset_noise_scale: float = 0.1
    healthy_z_range: tuple[float, float] = (0.2, 1.0)
    contact_force_range: tuple[float, float] = (-1.0, 1.0)

    def healthy(self, state: State) -> np.ndarray:
        low, high = self.healthy_z_range
        finite = np.isfinite(state.qpos).all(axis=1) & np.isfinite(state.qvel).all(axis=1)
        return finite & (low <= state.qpos[:, 2]) & (state.qpos[:, 2] <= high)

    def where(self, state: State) -> np.ndarray:
        return state.xpos[:, 1, :2]

    def felt(self, state: State) -> np.ndarray:
        """Return clipped forces on the bodies, shape (n, 6 nbody)."""
        return self.once(state, "felt", self._felt)

    def _felt(self, state: State) -> np.ndarray:
        forces = np.clip(state.cfrc_ext, *self.contact_force_range)
        return forces.reshape(len(forces), -1)

    def observe(self, state: State) -> np.ndarray:
        parts = [self.seen(state.qpos), state.qvel]
        if self.include_cfrc_ext_in_observation:
            parts.append(self.felt(state)[:, 6:])
        return np.concatenate(parts, axis=1)

    def rewards(self, before: Any, action: np.ndarray, state: State) -> dict[str, np.ndarray]:
        contact = self.contact_cost_weight * np.square(self.felt(state)).sum(axis=1)
        return {
            "reward_forward": self.speed(before, state) * self.forward_reward_weight,
            "reward_survive": self.stands(state) * self.healthy_reward,
            "reward_ctrl": -(self.ctrl_cost_weight * np.square(action).sum(axis=1)),
            "reward_contact": -contact,
        }


@dataclass(frozen=True, kw_only=True)
class Humanoid(_Spatial):
    """Walk on sand on two legs.

    ## Description
    Gymnasium's `Humanoid-v5` on Quikrete medium sand. What is not said here is as there;
    `mjgranular.envs.on_sand` says what sand changes.

    ## Action Space
    `Box(-0.4, 0.4, (17,), float32)`: torques at the joints.

    ## Observation Space
    `Box(-inf, inf, (348,), float64)`: as in `Humanoid-v5`; `cfrc_ext` has the sand's forces in it
    beside those of contacts between limbs.

    ## Rewards
    `reward_forward` + `reward_survive` + `reward_ctrl` + `reward_contact`, as in `Humanoid-v5`.

    ## Starting State
    As in `Humanoid-v5`.

    ## Episode End
    Terminated when unhealthy, as in `Humanoid-v5`. Truncated after 1000 steps.

    ## Arguments
    Those of `Humanoid-v5` but `xml_file` and those of cameras, and those of `Task`.

    ## Version History
    v0: first.
    """

    title: ClassVar[str] = "Gymnasium's Humanoid on sand"
    xml: ClassVar[str] = "humanoid.xml"
    reads: ClassVar[tuple[str, ...]] = (
        "xipos", "cinert", "cvel", "qfrc_actuator", "cfrc_ext", "ten_length", "ten_velocity",
    )  # fmt: skip
    camera: ClassVar[dict[str, Any]] = {
        "trackbodyid": 1, "distance": 4.0, "lookat": (0.0, 0.0, 2.0), "elevation": -20.0,
    }  # fmt: skip

    forward_reward_weight: float = 1.25
    ctrl_cost_weight: float = 0.1
    contact_cost_weight: float = 5e-7
    healthy_reward: float = 5.0
    reset_noise_scale: float = 1e-2
    contact_cost_range: tuple[float, float] = (-math.inf, 10.0)
    healthy_z_range: tuple[float, float] = (1.0, 2.0)
    include_cinert_in_observation: bool = True
    include_cvel_in_observation: bool = True
    include_qfrc_actuator_in_observation: bool = True

    @cached_property
    def _mass(self) -> tuple[np.ndarray, float]:
        return self.model.body_mass, self.model.body_mass.sum()

    def healthy(self, state: State) -> np.ndarray:
        low, high = self.healthy_z_range
        return (low < state.qpos[:, 2]) & (state.qpos[:, 2] < high)

    def where(self, state: State) -> np.ndarray:
        masses, whole = self._mass
        # One by one: a product of all at once is rounded differently from Gymnasium's.
        centres = [np.einsum("b,bj->j", masses, places) / whole for places in state.xipos]
        return np.stack(centres)[:, :2]

    def observe(self, state: State) -> np.ndarray:
        parts = [self.seen(state.qpos), state.qvel]
        count = len(state.qpos)
        if self.include_cinert_in_observation:
            parts.append(state.cinert[:, 1:].reshape(count, -1))
        if self.include_cvel_in_observation:
            parts.append(state.cvel[:, 1:].reshape(count, -1))
        if self.include_qfrc_actuator_in_observation:
            parts.append(state.qfrc_actuator[:, 6:])
        if self.include_cfrc_ext_in_observation:
            parts.append(state.cfrc_ext[:, 1:].reshape(count, -1))
        return np.concatenate(parts, axis=1)

    def rewards(self, before: Any, action: np.ndarray, state: State) -> dict[str, np.ndarray]:
        forces = state.cfrc_ext.reshape(len(state.qpos), -1)
        contact = np.clip(
            self.contact_cost_weight * np.square(forces).sum(axis=1), *self.contact_cost_range
        )
        effort = np.square(action.astype(float)).sum(axis=1)
        return {
            "reward_forward": self.forward_reward_weight * self.speed(before, state),
            "reward_survive": self.stands(state) * self.healthy_reward,
            "reward_ctrl": -(self.ctrl_cost_weight * effort),
            "reward_contact": -contact,
        }

    def place(self, state: State) -> dict[str, np.ndarray]:
        return super().place(state) | {
            "tendon_length": np.array(state.ten_length),
            "tendon_velocity": np.array(state.ten_velocity),
        }
