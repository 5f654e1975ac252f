"""A hexapod that walks on sand."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular import Medium, models
from mjgranular.envs.ground import Dunes
from mjgranular.envs.task import Start, State, Task, coordinates


@dataclass(frozen=True, kw_only=True)
class Hexapod(Task):
    """Walk ahead on six legs.

    ## Description
    A robot of 2.5 kg, 0.36 m long, with two servos in each leg, stands on loosely packed poppy seed
    (`mjgranular.models.Hexapod`). Its feet are balls of 50 mm that sink in by
    some centimetres; a leg that pushes hard digs itself in.

    ## Action Space
    `Box(-1, 1, (12,), float32)`: angles that the servos go to, in units of 0.6 rad; for each leg
    (front, middle, rear on the left, then on the right) its hip, positive with the foot going
    ahead, and its knee, positive with the foot going up. A servo gives 12 N m for each rad that it
    is off, up to 1.5 N m at rest and nothing at 6 rad/s: chosen, as robot servos of 50 g do.

    ## Observation Space
    `Box(-inf, inf, (35,), float64)`: height of the torso over the level ground [m], its orientation
    as a quaternion (w, x, y, z), angles of the servos [rad]; velocity of the torso [m/s] in the
    world's frame, its angular velocity in its own, velocities of the servos [rad/s].

    ## Rewards
    - `reward_forward`: velocity of the torso along x [m/s], times `forward_reward_weight`.
    - `reward_survive`: `healthy_reward` while the torso is upright.
    - `reward_ctrl`: minus `ctrl_cost_weight` times the sum of squared actions.

    ## Starting State
    Standing on the surface, heading to +x; servos off by up to `reset_noise_scale` rad and turning
    at up to that in rad/s, evenly.

    ## Episode End
    Terminated when the torso tilts by more than 60 degrees. Truncated after 500 steps of 0.04 s.

    ## Arguments
    `forward_reward_weight=5`, `ctrl_cost_weight=0.005`, `healthy_reward=0.1`,
    `reset_noise_scale=0.05`, `frame_skip=8` substeps of 5 ms, and those of `Task`: the medium,
    here loosely packed poppy seed, randomised sand and so on. The default resolution is 2: the way
    of a tripod gait is 7 % shorter than at a fine one.
    """

    title: ClassVar[str] = "a hexapod of 12 degrees of freedom walks"
    episode: ClassVar[int] = 500
    dunes: ClassVar[Dunes] = Dunes(wavelength=2.0, extent=20.0)
    camera: ClassVar[dict[str, Any]] = {
        "trackbodyid": 1, "distance": 1.3, "azimuth": 125.0, "elevation": -22.0,
    }  # fmt: skip

    medium: str | Path | Medium = "poppy_seed_loose"
    forward_reward_weight: float = 5.0
    ctrl_cost_weight: float = 0.005
    healthy_reward: float = 0.1
    reset_noise_scale: float = 0.05
    resolution: int | None = 2
    frame_skip: int = 8

    body: ClassVar[models.Hexapod] = models.Hexapod()

    def robot(self) -> mujoco.MjSpec:
        return self.body.spec(0.005)

    def start(self, random: np.random.Generator, height: Callable[[float, float], float]) -> Start:
        noise, body = self.reset_noise_scale, self.body
        qpos = body.start()
        x, y = body.length / 2, body.width / 2 + body.upper
        qpos[2] += max(height(*corner) for corner in product((-x, 0.0, x), (-y, y)))
        qpos[7:] += random.uniform(-noise, noise, 12)
        qvel = np.zeros(18)
        qvel[6:] = random.uniform(-noise, noise, 12)
        return Start(qpos, qvel)

    def act(self, action: np.ndarray, state: State) -> np.ndarray:
        return np.array([self.body.swing, self.body.lift] * 6) * np.clip(action, -1.0, 1.0)

    def observe(self, state: State) -> np.ndarray:
        return np.concatenate([state.qpos[:, 2:], state.qvel], axis=1)

    def rewards(self, before: Any, action: np.ndarray, state: State) -> dict[str, np.ndarray]:
        ahead = (state.qpos[:, 0] - before[:, 0]) / self.dt
        effort = np.square(np.clip(action, -1.0, 1.0)).sum(axis=1)
        return {
            "reward_forward": self.forward_reward_weight * ahead,
            "reward_survive": self.healthy_reward * self.once(state, "upright", _upright),
            "reward_ctrl": -self.ctrl_cost_weight * effort,
        }

    def terminated(self, state: State) -> np.ndarray:
        return ~self.once(state, "upright", _upright)

    def place(self, state: State) -> dict[str, np.ndarray]:
        return coordinates("position", state.qpos, "xyz")

    def progress(self, before: Any, state: State) -> dict[str, np.ndarray]:
        return coordinates("velocity", (state.qpos[:, :2] - before) / self.dt, "xy")


def _upright(state: State) -> np.ndarray:
    x, y = state.qpos[:, 4], state.qpos[:, 5]
    return 1.0 - 2.0 * (x * x + y * y) > 0.5  # cosine of the tilt
