"""Films and film strips of the policies that come with the package.

python docs/figures/policy_films.py [ChainSwim Hopper ...]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import imageio_ffmpeg
import mediapy
import numpy as np
from PIL import Image

from mjgranular.learn import environments
from mjgranular.learn.policies import load_policy

FOLDER = Path(__file__).resolve().parent
WIDTH, HEIGHT = 480, 320  # [px]; the grain of sand is hard to compress, hence small
RATE = 25.0  # pictures a second, at most
SEED = 10_000  # the first of an evaluation


@dataclass(frozen=True)
class Shown:
    """What is shown of one robot.

    Attributes:
        policy: its name.
        seconds: length of the film.
        begin: first instant of the strip [s].
        apart: from one picture of the strip to the next [s].
        count: pictures in the strip.
    """

    policy: str
    seconds: float = 4.0
    begin: float = 2.0
    apart: float = 0.16
    count: int = 6


SHOWN = {
    "ChainSwim": Shown("ChainSwim-v0/ppo-0"),
    "ChainCrawl": Shown("ChainCrawl-v0/ppo-1"),
    "Hexapod": Shown("Hexapod-v0/ppo-0"),
    "Hopper": Shown("Hopper-v0/ppo-0"),
    "Ant": Shown("Ant-v0/ppo-0"),
}


def pictures(shown: Shown) -> tuple[list[np.ndarray], float]:
    """Pictures of an episode, each of shape (height, width, 3), and the time between them [s]."""
    policy = load_policy(shown.policy)
    env = environments.for_filming(
        policy.run.environment,
        policy.run.settings.environment,
        width=WIDTH,
        height=HEIGHT,
        camera=None,
    )
    step = float(env.unwrapped.dt)
    every = max(1, round(1 / (RATE * step)))
    observation, _ = env.reset(seed=SEED)
    frames = []
    for number in range(round(shown.seconds / step)):
        if number % every == 0:
            frames.append(np.asarray(env.render()))
        action = policy.act(observation[None], np.array([number]))[0]
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            break
    env.close()
    return frames, every * step


def main(names: list[str]) -> None:
    """Writes `policy_NAME.mp4` and `policy_NAME.jpg` of each robot."""
    mediapy.set_ffmpeg(imageio_ffmpeg.get_ffmpeg_exe())
    for name in names or SHOWN:
        shown = SHOWN[name]
        frames, apart = pictures(shown)
        film = FOLDER / f"policy_{name.lower()}.mp4"
        mediapy.write_video(film, frames, fps=1 / apart, codec="h264", crf=30)
        chosen = [
            frames[min(round((shown.begin + k * shown.apart) / apart), len(frames) - 1)]
            for k in range(shown.count)
        ]
        strip = np.vstack([np.hstack(chosen[i : i + 3]) for i in range(0, len(chosen), 3)])
        still = film.with_suffix(".jpg")
        Image.fromarray(strip).save(still, quality=80)
        for path in (film, still):
            print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
