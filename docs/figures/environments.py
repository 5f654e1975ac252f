"""The environments, each as it looks after a few steps.

python docs/figures/environments.py    # downloads Unitree's robots
"""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image

from mjgranular.envs import SandRanges, tasks
from mjgranular.envs.gaits import gait, gaits
from mjgranular.envs.ids import id_of

SIZE = 320, 240  # [px]
STEPS = 60
COLUMNS = 4
# The last three: the same on dunes.
ON_DUNES = ("ChainCrawl", "Hexapod", "Go1Velocity")
SHOWN = [*((name, "plane") for name in tasks), *((name, "dunes") for name in ON_DUNES)]


def picture(name: str, surface: str) -> np.ndarray:
    """One of them, shape (height, width, 3)."""
    env = gym.make(
        id_of(name),
        render_mode="rgb_array",
        width=SIZE[0],
        height=SIZE[1],
        randomise=SandRanges(surfaces=(surface,)),
    )
    env.reset(seed=0)
    task = env.unwrapped.task
    zero = np.zeros(env.action_space.shape, np.float32)
    script = gait(task) if name in gaits else lambda time: zero
    for step in range(STEPS // 3 if name.endswith("Velocity") else STEPS):  # these fall
        _, _, terminated, truncated, _ = env.step(script(step * task.dt))
        if terminated or truncated:
            break
    frame = env.render()
    env.close()
    return np.asarray(frame)


def main() -> None:
    """Writes the figure."""
    frames = [picture(name, surface) for name, surface in SHOWN]
    rows = [np.hstack(frames[i : i + COLUMNS]) for i in range(0, len(frames), COLUMNS)]
    place = Path(__file__).with_suffix(".jpg")
    Image.fromarray(np.vstack(rows)).save(place, quality=85)
    print(place.name, ", ".join(f"{name} ({surface})" for name, surface in SHOWN))


if __name__ == "__main__":
    main()
