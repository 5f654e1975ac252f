"""Gymnasium's robots as tasks: Hopper, Walker2d, HalfCheetah, Swimmer, Ant, Humanoid."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import gymnasium.envs.mujoco
import mujoco
import numpy as np
from gymnasium.spaces import Box

from mjgranular import Medium
from mjgranular.envs.ground import quiet
from mjgranular.envs.task import Start, State, Task, coordinates

ASSETS = Path(gymnasium.envs.mujoco.__file__).parent / "assets"


@dataclass(frozen=True, kw_only=True)
class Robot(Task):
    """A Gymnasium robot: model, observation, reward and options.

    A test checks that each is bit-identical to `on_sand` of the same robot.
    """

    sections: ClassVar[dict[str, str]] = Task.sections | {
        "Description": (
            "Gymnasium's `{}-v5` on Quikrete medium sand. What is not said here is as there;\n"
            "`mjgranular.envs.on_sand` says what sand changes."
        ),
        "Rewards": "`reward_forward` + `reward_survive` + `reward_ctrl`, as in `{}-v5`.",
        "Starting State": "As in `{}-v5`.",
        "Episode End": "Terminated when unhealthy, as in `{}-v5`. Truncated after 1000 steps.",
        "Arguments": "Those of `{}-v5` but `xml_file` and those of cameras, and those of `Task`.",
    }
    xml: ClassVar[str]
    hidden: ClassVar[int] = 1
    """Number of positions that are omitted from the observation."""
    gaussian: ClassVar[bool] = False
    """Whether velocities start with normal noise."""

    forward_reward_weight: float = 1.0
    ctrl_cost_weight: float = 1e-3
    reset_noise_scale: float = 5e-3
    exclude_current_positions_from_observation: bool = True

    def robot(self) -> mujoco.MjSpec:
        with quiet():
            return mujoco.MjSpec.from_file(str(ASSETS / self.xml))

    @cached_property
    def action_space(self) -> Box:
        low, high = self.model.actuator_ctrlrange.copy().astype(np.float32).T
        return Box(low, high, dtype=np.float32)

    def start(self, random: np.random.Generator, height: Callable[[float, float], float]) -> Start:
        model, noise = self.model, self.reset_noise_scale
        qpos = model.qpos0 + random.uniform(low=-noise, high=noise, size=model.nq)
        if self.gaussian:
            qvel = noise * random.standard_normal(model.nv)
        else:
            qvel = random.uniform(low=-noise, high=noise, size=model.nv)
        self.raise_by(qpos, height)
        return Start(qpos, qvel)

    def raise_by(self, qpos: np.ndarray, height: Callable[[float, float], float]) -> None:
        """Raise a start onto dunes; do nothing on the plane."""
        reach = (-0.5, 0.0, 0.5)  # [m]; chosen: the robots are about a meter long
        qpos[1] += max(height(float(qpos[0]) + x, 0.0) for x in reach)

    def seen(self, qpos: np.ndarray) -> np.ndarray:
        """Return the positions that are observed."""
        return qpos[:, self.hidden if self.exclude_current_positions_from_observation else 0 :]

    def speed(self, before: np.ndarray, state: State) -> np.ndarray:
        """Return the speed along x [m/s]."""
        return (state.qpos[:, 0] - before[:, 0]) / self.dt

    def rewards(self, before: Any, action: np.ndarray, state: State) -> dict[str, np.ndarray]:
        return {
            "reward_forward": self.forward_reward_weight * self.speed(before, state),
            "reward_ctrl": -(self.ctrl_cost_weight * np.square(action).sum(axis=1)),
        }

    def place(self, state: State) -> dict[str, np.ndarray]:
        x, y = state.qpos[:, 0], state.qpos[:, 1]
        distance = {"distance_from_origin": np.sqrt(x * x + y * y)}
        return coordinates("position", state.qpos, "xy") | distance

    def progress(self, before: Any, state: State) -> dict[str, np.ndarray]:
        return {"x_velocity": self.speed(before, state)}


@dataclass(frozen=True, kw_only=True)
class Standing(Robot):
    """A robot that is rewarded while it is healthy; its episode may end when it is not."""

    healthy_reward: float = 1.0
    terminate_when_unhealthy: bool = True

    def healthy(self, state: State) -> np.ndarray:
        """Return True if the robot stands, or is at its height, shape (n,)."""
        raise NotImplementedError

    def rewards(self, before: Any, action: np.ndarray, state: State) -> dict[str, np.ndarray]:
        terms = super().rewards(before, action, state)
        ctrl = terms.pop("reward_ctrl")  # the last to be added
        return terms | {
            "reward_survive": self.once(state, "healthy", self.healthy) * self.healthy_reward,
            "reward_ctrl": ctrl,
        }

    def terminated(self, state: State) -> np.ndarray:
        if not self.terminate_when_unhealthy:
            return np.zeros(len(state.qpos), bool)
        return ~self.once(state, "healthy", self.healthy)


@dataclass(frozen=True, kw_only=True)
class _Legged(Standing):
    """Hopper and Walker2d."""

    healthy_z_range: tuple[float, float] = (0.7, math.inf)
    healthy_angle_range: tuple[float, float] = (-0.2, 0.2)
    frame_skip: int = 4

    def observe(self, state: State) -> np.ndarray:
        velocity = np.minimum(np.maximum(state.qvel, -10), 10)
        return np.concatenate((self.seen(state.qpos), velocity), axis=1)

    def healthy(self, state: State) -> np.ndarray:
        z, angle = state.qpos[:, 1], state.qpos[:, 2]
        low, high = self.healthy_z_range
        left, right = self.healthy_angle_range
        return (low < z) & (z < high) & (left < angle) & (angle < right)

    def place(self, state: State) -> dict[str, np.ndarray]:
        return {
            "x_position": state.qpos[:, 0].copy(),
            "z_distance_from_origin": state.qpos[:, 1] - self.model.qpos0[1],
        }


@dataclass(frozen=True, kw_only=True)
class Hopper(_Legged):
    """Hop on sand.

    ## Description
    Gymnasium's `Hopper-v5`, a planar robot of one leg, on Quikrete medium sand. What is not said
    here is as there; `mjgranular.envs.on_sand` says what sand changes.

    ## Action Space
    `Box(-1, 1, (3,), float32)`: torques at thigh, leg and foot.

    ## Observation Space
    `Box(-inf, inf, (11,), float64)`: positions but x, and velocities.

    ## Starting State
    As in `Hopper-v5`, its foot 4 cm over the sand.

    ## Episode End
    Terminated when unhealthy, as in `Hopper-v5`: the foot sinks in by a few centimetres, while the
    healthy range ends 0.5 m below the start. Truncated after 1000 steps.
    """

    title: ClassVar[str] = "Gymnasium's Hopper on sand"
    xml: ClassVar[str] = "hopper.xml"
    camera: ClassVar[dict[str, Any]] = {
        "trackbodyid": 2, "distance": 3.0, "lookat": (0.0, 0.0, 1.15), "elevation": -20.0,
    }  # fmt: skip

    healthy_state_range: tuple[float, float] = (-100.0, 100.0)

    def healthy(self, state: State) -> np.ndarray:
        low, high = self.healthy_state_range
        rest = np.concatenate([state.qpos[:, 2:], state.qvel], axis=1)
        return super().healthy(state) & (low < rest.min(axis=1)) & (rest.max(axis=1) < high)


@dataclass(frozen=True, kw_only=True)
class Walker2d(_Legged):
    """Walk on sand on two legs in a plane.

    ## Action Space
    `Box(-1, 1, (6,), float32)`: torques at thigh, leg and foot of both legs.

    ## Observation Space
    `Box(-inf, inf, (17,), float64)`: positions but x, and velocities.

    ## Starting State
    As in `Walker2d-v5`, its feet 4 cm over the sand.
    """

    title: ClassVar[str] = "Gymnasium's Walker2d on sand"
    xml: ClassVar[str] = "walker2d_v5.xml"
    camera: ClassVar[dict[str, Any]] = {
        "trackbodyid": 2, "distance": 4.0, "lookat": (0.0, 0.0, 1.15), "elevation": -20.0,
    }  # fmt: skip

    healthy_z_range: tuple[float, float] = (0.8, 2.0)
    healthy_angle_range: tuple[float, float] = (-1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class HalfCheetah(Robot):
    """Run on sand in a plane.

    ## Action Space
    `Box(-1, 1, (6,), float32)`: torques at thigh, shin and foot of both legs.

    ## Observation Space
    `Box(-inf, inf, (17,), float64)`: positions but x, and velocities.

    ## Rewards
    `reward_forward` + `reward_ctrl`, as in `HalfCheetah-v5`.

    ## Episode End
    Never terminated. Truncated after 1000 steps.
    """

    title: ClassVar[str] = "Gymnasium's HalfCheetah on sand"
    xml: ClassVar[str] = "half_cheetah.xml"
    gaussian: ClassVar[bool] = True
    camera: ClassVar[dict[str, Any]] = {"trackbodyid": 1, "distance": 4.0, "elevation": -15.0}

    ctrl_cost_weight: float = 0.1
    reset_noise_scale: float = 0.1

    def observe(self, state: State) -> np.ndarray:
        return np.concatenate((self.seen(state.qpos), state.qvel), axis=1)

    def place(self, state: State) -> dict[str, np.ndarray]:
        return coordinates("position", state.qpos, "x")


@dataclass(frozen=True, kw_only=True)
class Swimmer(HalfCheetah):
    """Swim buried in sand with three links.

    ## Description
    The robot of Gymnasium's `Swimmer-v5`, three rods of 1 m and 0.2 m across, buried 0.3 m deep in
    loosely packed poppy seed, which takes the place of its fluid. It is free in the level plane at
    that depth. Motors are ten times as strong as Gymnasium's (1500 N m for an action of one):
    weaker ones cannot move it. Sand does not let it coast.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: torques at the two joints.

    ## Observation Space
    `Box(-inf, inf, (8,), float64)`: angles and velocities, as in `Swimmer-v5`.

    ## Rewards
    `reward_forward` + `reward_ctrl`, as in `Swimmer-v5`.

    ## Episode End
    Never terminated. Truncated after 1000 steps.
    """

    title: ClassVar[str] = "Gymnasium's Swimmer, buried in sand"
    xml: ClassVar[str] = "swimmer.xml"
    hidden: ClassVar[int] = 2
    gaussian: ClassVar[bool] = False
    cut: ClassVar[float] = 0.4  # it lies on the cut
    camera: ClassVar[dict[str, Any]] = {"trackbodyid": 2, "distance": 7.0, "elevation": -50.0}

    medium: str | Path | Medium = "poppy_seed_loose"
    ctrl_cost_weight: float = 1e-4
    frame_skip: int = 4

    def robot(self) -> mujoco.MjSpec:
        spec = super().robot()
        spec.geom("floor").pos = [0, 0, 0.3]
        for actuator in spec.actuators:
            actuator.gear[0] = 10 * actuator.gear[0]
        return spec

    def raise_by(self, qpos: np.ndarray, height: Callable[[float, float], float]) -> None:
        pass

    place = Robot.place

    def progress(self, before: Any, state: State) -> dict[str, np.ndarray]:
        return coordinates("velocity", (state.qpos[:, :2] - before) / self.dt, "xy")


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

    def mark(self, state: State) -> np.ndarray:
        return np.array(self.where(state))

    def speed(self, before: np.ndarray, state: State) -> np.ndarray:
        return (self.once(state, "where", self.where)[:, 0] - before[:, 0]) / self.dt

    def progress(self, before: Any, state: State) -> dict[str, np.ndarray]:
        velocity = (self.once(state, "where", self.where) - before) / self.dt
        return coordinates("velocity", velocity, "xy")


@dataclass(frozen=True, kw_only=True)
class Ant(_Spatial):
    """Run on sand on four legs.

    ## Action Space
    `Box(-1, 1, (8,), float32)`: torques at hips and ankles.

    ## Observation Space
    `Box(-inf, inf, (105,), float64)`: positions but x and y, velocities, and `cfrc_ext` of each
    body, clipped as there, with the sand's forces in it.

    ## Rewards
    `reward_forward` + `reward_survive` + `reward_ctrl` + `reward_contact`, as in `Ant-v5`; the
    contact cost is that of the sand's forces.

    ## Arguments
    Those of `Ant-v5` but `xml_file`, `main_body` and those of cameras, and those of `Task`.
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
        limits, size = self.contact_force_range, len(state.qpos)
        return self.once(
            state, "felt", lambda state: np.clip(state.cfrc_ext, *limits).reshape(size, -1)
        )

    def observe(self, state: State) -> np.ndarray:
        parts = [self.seen(state.qpos), state.qvel]
        if self.include_cfrc_ext_in_observation:
            parts.append(self.felt(state)[:, 6:])
        return np.concatenate(parts, axis=1)

    def rewards(self, before: Any, action: np.ndarray, state: State) -> dict[str, np.ndarray]:
        contact = self.contact_cost_weight * np.square(self.felt(state)).sum(axis=1)
        return super().rewards(before, action, state) | {"reward_contact": -contact}


@dataclass(frozen=True, kw_only=True)
class Humanoid(_Spatial):
    """Walk on sand on two legs.

    ## Action Space
    `Box(-0.4, 0.4, (17,), float32)`: torques at the joints.

    ## Observation Space
    `Box(-inf, inf, (348,), float64)`: as in `Humanoid-v5`; `cfrc_ext` has the sand's forces in it
    beside those of contacts between limbs.

    ## Rewards
    `reward_forward` + `reward_survive` + `reward_ctrl` + `reward_contact`, as in `Humanoid-v5`.
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

    def healthy(self, state: State) -> np.ndarray:
        low, high = self.healthy_z_range
        return (low < state.qpos[:, 2]) & (state.qpos[:, 2] < high)

    def where(self, state: State) -> np.ndarray:
        masses, whole = self.model.body_mass, self.model.body_mass.sum()
        # One by one: a product of all at once is rounded differently from Gymnasium's.
        centres = [np.einsum("b,bj->j", masses, places) / whole for places in state.xipos]
        return np.stack(centres)[:, :2]

    def observe(self, state: State) -> np.ndarray:
        parts = (
            (self.include_cinert_in_observation, state.cinert[:, 1:]),
            (self.include_cvel_in_observation, state.cvel[:, 1:]),
            (self.include_qfrc_actuator_in_observation, state.qfrc_actuator[:, 6:]),
            (self.include_cfrc_ext_in_observation, state.cfrc_ext[:, 1:]),
        )
        chosen = [part.reshape(len(part), -1) for included, part in parts if included]
        return np.concatenate([self.seen(state.qpos), state.qvel, *chosen], axis=1)

    def rewards(self, before: Any, action: np.ndarray, state: State) -> dict[str, np.ndarray]:
        forces = state.cfrc_ext.reshape(len(state.qpos), -1)
        contact = np.clip(
            self.contact_cost_weight * np.square(forces).sum(axis=1), *self.contact_cost_range
        )
        terms = super().rewards(before, action.astype(float), state)
        return terms | {"reward_contact": -contact}

    def place(self, state: State) -> dict[str, np.ndarray]:
        return super().place(state) | {
            "tendon_length": np.array(state.ten_length),
            "tendon_velocity": np.array(state.ten_velocity),
        }
