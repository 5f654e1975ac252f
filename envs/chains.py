"""Worms that swim in sand and crawl on it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular import Medium
from mjgranular._util.checks import check_count
from mjgranular.envs.ground import Dunes
from mjgranular.envs.task import Start, State, Task, coordinates
from mjgranular.models import Worm


@dataclass(frozen=True, kw_only=True)
class _Chain(Task):
    """Base of the worms: servos at the joints, reward for forward motion in body lengths."""

    reads: ClassVar[tuple[str, ...]] = ("subtree_com",)
    episode: ClassVar[int] = 500
    build: ClassVar[dict[str, Any]] = {}
    """Sizes and servos of the worm, where they are not the default."""

    links: int = 7
    forward_reward_weight: float = 1.0
    ctrl_cost_weight: float = 0.005
    reset_noise_scale: float = 0.1
    frame_skip: int = 8

    def __post_init__(self) -> None:
        super().__post_init__()
        check_count("links", self.links, least=2)

    @cached_property
    def worm(self) -> Worm:
        return Worm(self.links, **self.build)

    def robot(self) -> mujoco.MjSpec:
        return self.worm.spec(0.005)

    def act(self, action: np.ndarray, state: State) -> np.ndarray:
        return self.worm.bend * np.clip(action, -1.0, 1.0)

    def mark(self, state: State) -> np.ndarray:
        return np.array(state.subtree_com[:, 1])

    def rewards(self, before: Any, action: np.ndarray, state: State) -> dict[str, np.ndarray]:
        ahead = (state.subtree_com[:, 1, 0] - before[:, 0]) / self.dt / self.worm.length
        effort = np.square(np.clip(action, -1.0, 1.0)).sum(axis=1)
        return {
            "reward_forward": self.forward_reward_weight * ahead,
            "reward_ctrl": -self.ctrl_cost_weight * effort,
        }

    def progress(self, before: Any, state: State) -> dict[str, np.ndarray]:
        return {"x_velocity": (state.subtree_com[:, 1, 0] - before[:, 0]) / self.dt}

    def _seen(self, state: State, first: int) -> np.ndarray:
        """Return positions from index `first` on, then velocities; joints from head to tail."""
        order = [0, 1, 2, *self.worm.order]
        # `take` makes rows contiguous in memory; an index would not.
        return np.concatenate(
            [np.take(state.qpos, order[first:], axis=1), np.take(state.qvel, order, axis=1)],
            axis=1,
        )

    def _bent(self, random: np.random.Generator) -> Start:
        """Return the straight worm, with noise in its angles and joint velocities."""
        noise = self.reset_noise_scale
        qpos = self.worm.straight()
        qpos[2:] += random.uniform(-noise, noise, self.links)
        qvel = np.zeros(self.links + 2)
        qvel[3:] = random.uniform(-noise, noise, self.links - 1)
        return Start(qpos, qvel)


@dataclass(frozen=True, kw_only=True)
class ChainSwim(_Chain):
    """Swim buried in sand.

    ## Description
    A smooth worm of `links` links, 0.12 m long and 16 mm wide, about a sandfish's size, lies three
    widths deep in sand and bends in the level plane. It moves ahead if it passes waves from its
    head to its tail (Maladen, Ding, Umbanhowar, Kamor and Goldman, J. R. Soc. Interface 8, 1332
    (2011): one sine wave along the body, amplitude about a fifth of its length, is best). Sand
    holds what stops: it neither coasts nor sinks.

    ## Action Space
    `Box(-1, 1, (links - 1,), float32)`: angles that servos at the joints go to, in units of 1 rad,
    from the head to the tail, anticlockwise seen from above. A servo gives 5 N m for each rad
    that it is off, up to 1 N m at rest and nothing at 8 rad/s: chosen, as strong as sand asks for
    at this depth, which is more than a servo of this size has.

    ## Observation Space
    `Box(-inf, inf, (2 links + 2,), float64)`: the middle link's heading against the x axis and the
    joints' angles [rad], from the head to the tail; velocities of the middle link's centre along x
    and y [m/s], of its heading and of the joints [rad/s].

    ## Rewards
    - `reward_forward`: `forward_reward_weight` times the body lengths per second along x.
    - `reward_ctrl`: minus `ctrl_cost_weight` times the sum of squared actions.

    As in Gymnasium, it is of the mass centre at the last substep's start.

    ## Starting State
    Straight, heading to +x; the heading and each angle are off by up to `reset_noise_scale` rad,
    evenly, and joints turn at up to that in rad/s.

    ## Episode End
    Never terminated. Truncated after 500 steps of 0.04 s.

    ## Arguments
    `links=7`, `forward_reward_weight=1`, `ctrl_cost_weight=0.005`, `reset_noise_scale=0.1`,
    `frame_skip=8` substeps of 5 ms, and those of `Task`: the medium, here Quikrete medium sand
    under three-dimensional resistive force theory, randomised sand and so on. The default
    resolution is 3; at a fine one a wave gets 13 % less far (docs/environments.md).
    """

    title: ClassVar[str] = "a buried chain swims by waves from head to tail"
    cut: ClassVar[float] = 0.056  # the worm lies on the cut
    tile: ClassVar[float] = 0.1
    dunes: ClassVar[Dunes] = Dunes(wavelength=1.0, extent=5.0)
    camera: ClassVar[dict[str, Any]] = {
        "trackbodyid": 1, "distance": 0.35, "azimuth": 90.0, "elevation": -55.0,
    }  # fmt: skip

    resolution: int | None = 3

    def start(self, random: np.random.Generator, height: Callable[[float, float], float]) -> Start:
        return self._bent(random)

    def observe(self, state: State) -> np.ndarray:
        return self._seen(state, 2)

    def place(self, state: State) -> dict[str, np.ndarray]:
        return coordinates("position", state.subtree_com[:, 1], "xy")


@dataclass(frozen=True, kw_only=True)
class ChainCrawl(_Chain):
    """Crawl on sand and in its surface.

    ## Description
    A smooth worm of `links` links, 0.6 m long and 40 mm wide, of 0.83 kg, lies on loose poppy seed
    and bends in the vertical plane, as an inchworm does. It sinks in by some millimetres, and by
    centimetres where it stands on a few links. It can roll up, rear and fall on its back.

    ## Action Space
    `Box(-1, 1, (links - 1,), float32)`: angles that servos at the joints go to, in units of 1 rad,
    from the head to the tail; positive ones lift the middle of the body. A servo gives 20 N m for
    each rad that it is off, up to 4 N m at rest and nothing at 5 rad/s: chosen, about what robot
    servos of 80 g do, one of which fits into each link.

    ## Observation Space
    `Box(-inf, inf, (2 links + 3,), float64)`: height of the middle link's centre [m]; its angle
    from level, positive with the head up, and the joints' angles [rad], from the head to the tail;
    its velocities along x and z [m/s]; their angular velocities [rad/s].

    ## Rewards
    - `reward_forward`: `forward_reward_weight` times the body lengths per second along x.
    - `reward_ctrl`: minus `ctrl_cost_weight` times the sum of squared actions.
    - `reward_rate`: minus `rate_cost_weight` times the sum of squared changes of the actions since
      the step before. Without it PPO learns to rear the tail and to tremble with the head, twelve
      strokes a second, at which no law of the sand was measured.

    ## Starting State
    Straight on the surface, head to +x; the pitch and each angle are off by up to
    `reset_noise_scale` rad, evenly, and joints turn at up to that in rad/s.

    ## Episode End
    Never terminated. Truncated after 500 steps of 0.04 s.

    ## Arguments
    `links=7`, `forward_reward_weight=1`, `ctrl_cost_weight=0.005`, `rate_cost_weight=0.02`,
    `reset_noise_scale=0.05`, `frame_skip=8` substeps of 5 ms, and those of `Task`: the medium, here
    loosely packed poppy seed, and so on. At a finer resolution than 4 a wave gets 16 % less far.
    """

    reads: ClassVar[tuple[str, ...]] = ("subtree_com", "ctrl")
    title: ClassVar[str] = "a chain crawls on sand and in its surface"
    dunes: ClassVar[Dunes] = Dunes(wavelength=2.0, extent=20.0)
    build: ClassVar[dict[str, Any]] = {
        "length": 0.6, "width": 0.04, "posture": "upright",
        "stiffness": 20.0, "torque": 4.0, "speed": 5.0, "armature": 1e-3,
    }  # fmt: skip
    camera: ClassVar[dict[str, Any]] = {
        "trackbodyid": 1, "distance": 1.4, "azimuth": 90.0, "elevation": -12.0,
    }  # fmt: skip

    medium: str | Path | Medium = "poppy_seed_loose"
    rate_cost_weight: float = 0.02
    reset_noise_scale: float = 0.05

    def start(self, random: np.random.Generator, height: Callable[[float, float], float]) -> Start:
        start = self._bent(random)
        worm = self.worm
        front = (worm.root + 0.5) * worm.step  # its root is at x = 0
        start.qpos[1] += max(height(front - i * worm.step, 0.0) for i in range(self.links + 1))
        return start

    def observe(self, state: State) -> np.ndarray:
        seen = self._seen(state, 1)
        seen[:, 1] += np.pi / 2
        return seen

    def mark(self, state: State) -> np.ndarray:
        return np.concatenate([super().mark(state), state.ctrl], axis=1)

    def rewards(self, before: Any, action: np.ndarray, state: State) -> dict[str, np.ndarray]:
        change = (state.ctrl - before[:, 3:]) / self.worm.bend
        terms = super().rewards(before, action, state)
        return terms | {"reward_rate": -self.rate_cost_weight * np.square(change).sum(axis=1)}

    def place(self, state: State) -> dict[str, np.ndarray]:
        return coordinates("position", state.subtree_com[:, 1, ::2], "xz")
