"""Films and film strips of the policies that come with the package.

python docs/figures/policy_films.py [ChainSwim Hopper ...]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import matplotlib
import mediapy
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from mjgranular import HeightField, Memory
from mjgranular.envs.single import SandEnv
from mjgranular.envs.velocity import G1Velocity, Go1Velocity, Go2Velocity
from mjgranular.learn import environments
from mjgranular.learn.policies import Policy, load_policy

FOLDER = Path(__file__).resolve().parent
WIDTH, HEIGHT = 480, 320  # [px]; the grain of sand is hard to compress, hence small
RATE = 25.0  # pictures a second, at most
SEED = 10_000  # the first of an evaluation
FONT = Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSansMono.ttf")


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


class Walk(Go1Velocity):
    """The Go1 with the commands of a film: ahead, in a curve, ahead and to the left."""

    def _draw_commands(self, random: np.random.Generator) -> np.ndarray:
        table = super()._draw_commands(random)
        table[:, 0] = np.inf
        table[:3] = [[0, 0.6, 0, 0], [150, 0.6, 0, 0.8], [300, 0.5, 0.3, 0]]
        return table


class WalkGo2(Walk, Go2Velocity):
    """The Go2 with the same commands."""


class WalkG1(Walk, G1Velocity):
    """The G1 with the same commands."""


FOLLOWING = {
    "mjgranular/Go1Velocity-v0": Walk,
    "mjgranular/Go2Velocity-v0": WalkGo2,
    "mjgranular/G1Velocity-v0": WalkG1,
}
SHOWN = {
    "ChainSwim": Shown("ChainSwim-v0/ppo-0"),
    "ChainCrawl": Shown("ChainCrawl-v0/ppo-0"),
    "Hexapod": Shown("Hexapod-v0/ppo-0"),
    "Hopper": Shown("Hopper-v0/ppo-0"),
    "Ant": Shown("Ant-v0/ppo-0"),
    "Go1": Shown("Go1Velocity-v0/ppo-6", seconds=9.0, begin=2.0, apart=3.0, count=3),
    "Go2": Shown("Go2Velocity-v0/ppo-2", seconds=9.0, begin=2.0, apart=3.0, count=3),
    "G1": Shown("G1Velocity-v0/ppo-12", seconds=9.0, begin=2.0, apart=3.0, count=3),
}


def environment(policy: Policy) -> Any:
    """The environment of a film; robots that follow commands leave prints, the Go1 on dunes."""
    name = policy.run.environment
    if name in FOLLOWING:
        history = policy.run.settings.environment.get("history", 0)
        sand: dict[str, Any] = {"memory": Memory(0.015, extent=5.0)}
        if name == "mjgranular/Go1Velocity-v0":
            sand["surface"] = HeightField("dunes")
        task = FOLLOWING[name](push_scale=0.0, history=history, **sand)
        return SandEnv(task, render_mode="rgb_array", width=1280, height=720)
    size = {"width": WIDTH, "height": HEIGHT, "camera": None}
    arguments = dict(policy.run.settings.environment)
    arguments.pop("randomise", None)
    return environments.for_filming(name, arguments, **size)


def labeled(frame: np.ndarray, info: dict[str, Any]) -> np.ndarray:
    """Write commands and velocities on a picture, if the robot has them."""
    if "velocity" not in info:
        return frame
    (ahead, left, _), (x, y, turn) = info["velocity"], info["command"]
    lines = (
        f"command  {x:4.1f} m/s ahead  {y:4.1f} m/s left  {turn:4.1f} rad/s",
        f"speed    {ahead:4.1f} m/s ahead  {left:4.1f} m/s left",
    )
    image = Image.fromarray(frame)
    font = ImageFont.truetype(str(FONT), 26)
    ImageDraw.Draw(image).multiline_text((30, 24), "\n".join(lines), fill=(30, 30, 30), font=font)
    return np.asarray(image)


def pictures(shown: Shown) -> tuple[list[np.ndarray], float]:
    """Pictures of an episode, each of shape (height, width, 3), and the time between them [s]."""
    policy = load_policy(shown.policy)
    env = environment(policy)
    step = float(env.unwrapped.dt)
    every = max(1, round(1 / (RATE * step)))
    observation, info = env.reset(seed=SEED)
    frames = []
    for number in range(round(shown.seconds / step)):
        if number % every == 0:
            frames.append(labeled(np.asarray(env.render()), info))
        action = policy.act(observation[None], np.array([number]))[0]
        observation, _, terminated, truncated, info = env.step(action)
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
        image = Image.fromarray(strip)
        image.thumbnail((3 * WIDTH, 3 * WIDTH))
        image.save(still, quality=80)
        for path in (film, still):
            print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
