"""How well a Go1 or a Go2 follows commanded velocities, on sands and on a rigid floor.

    python benchmarks/velocity.py runs/Go1Velocity-v0-ppo-0
    python benchmarks/velocity.py Go1Velocity-v0/ppo-0 --episodes 8 --seconds 10

Errors are means over all steps before a fall, also those right after a command has changed, and
include the sway of a gait. Prints the rows of the table in docs/policies.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, cast

import numpy as np
import tyro

from mjgranular.envs import tasks
from mjgranular.envs.ids import name_of
from mjgranular.envs.vector import SandVectorEnv
from mjgranular.envs.velocity import Go1Velocity
from mjgranular.learn.policies import Policy, load_policy


def drawn(name: str, value: float) -> dict[str, Any]:
    """Return the options for one quantity of the sand, other than the default."""
    return {"randomise": {name: (value, value)}}


HALVED = "half the time step"
GROUNDS: dict[str, dict[str, Any]] = {
    "Quikrete medium sand": {},
    "close poppy seeds": {"medium": "poppy_seed_close"},
    "close glass beads of 3 mm": {"medium": "glass_beads_3mm_close"},
    "sand of Yuma": {"medium": "yuma_sand"},
    "sand of 29 Palms": {"medium": "twentynine_palms_sand"},
    "half the strength": drawn("strength", 0.5),
    "twice the strength": drawn("strength", 2.0),
    "slope of 10 degrees": drawn("slope", math.radians(10)),
    "dunes of up to 9 degrees": {"randomise": {"surfaces": ("dunes",)}},
    "from a rigid floor to sand": {"rigid": 0.3},
    "a rigid floor": {"rigid": math.inf},
    HALVED: {"frame_skip": 2 * Go1Velocity.frame_skip},
    "with memory": {"memory": True},
    "commanded at once": {"settling_time": (0.0, 0.0)},  # while it still sinks
}


@dataclass(frozen=True)
class Options:
    """Errors and falls on each ground."""

    policy: Annotated[str, tyro.conf.Positional]
    """Folder of a run, or name of a policy that comes with the package."""
    episodes: int = 32
    """On each ground, with different commands."""
    seconds: float = 20.0
    """Of an episode."""
    push_scale: float = 0.0
    """Of pushes, as in the environment."""
    law: str | None = None
    """Default: that of the environment."""
    only: str = ""
    """A part of the names of the grounds; default: all."""


def follow(policy: Policy, task: Go1Velocity, episodes: int, seconds: float) -> tuple[float, ...]:
    """Return errors of velocity [m/s] and yaw rate [rad/s], and the share of falls."""
    steps = round(seconds / task.dt)
    env = SandVectorEnv(task, episodes, max_episode_steps=steps)
    observations, _ = env.reset(seed=20_000)
    stands, errors, count = np.ones(episodes, bool), np.zeros(2), 0
    for step in range(steps):
        actions = policy.act(observations, np.full(episodes, step))
        observations, _, terminated, _, info = env.step(actions)
        stands &= ~terminated
        errors += [info[name][stands].sum() for name in ("velocity_error", "yaw_rate_error")]
        count += stands.sum()
    env.close()
    return *(errors / max(count, 1)), 1.0 - stands.mean()


def main(options: Options) -> None:
    """Print the table."""
    policy = load_policy(options.policy)
    robot = cast(type[Go1Velocity], tasks[name_of(policy.run.environment)])
    halved = type("Halved", (robot,), {"timestep": robot.timestep / 2})
    history = policy.run.settings.environment.get("history", 0)
    print("| ground | error [m/s] | of yaw [rad/s] | falls |\n|---|---|---|---|")
    for name in (name for name in GROUNDS if options.only in name):
        ground = GROUNDS[name]
        task = (halved if name == HALVED else robot)(
            push_scale=options.push_scale, law=options.law, history=history, **ground
        )
        speed, yaw, falls = follow(policy, task, options.episodes, options.seconds)
        print(f"| {name} | {speed:.3f} | {yaw:.3f} | {100 * falls:.0f} % |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
