"""Films and pictures of prints: the trail of the hexapod, the crater of a ball, a worm's furrow.

python docs/figures/prints_films.py [trail crater trench ...]
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import mjgranular.envs  # isort: skip  # noqa: F401 (before mujoco: it chooses how to draw)
import imageio_ffmpeg
import mediapy
import numpy as np
from PIL import Image

from mjgranular.experiment import Drop, run_drop
from mjgranular.experiment.drop import load
from mjgranular.learn import environments
from mjgranular.learn.policies import load_policy
from mjgranular.picture.video import Film, Motion, frames_of_model
from mjgranular.relief.memory import as_memory

FOLDER = Path(__file__).resolve().parent
WIDTH, HEIGHT = 640, 400  # [px]
RATE = 25.0  # pictures a second
SEED = 10_000  # the first of an evaluation


def of_policy(name: str, seconds: float, **view: float) -> Iterator[np.ndarray]:
    """Pictures of an episode of a policy on sand that remembers, in real time."""
    policy = load_policy(name)
    arguments = {**policy.run.settings.environment, "memory": 0.01}
    arguments.pop("randomise", None)  # sand that is drawn has no memory
    env = environments.for_filming(
        policy.run.environment, arguments, width=WIDTH, height=HEIGHT, camera=None
    )
    env.unwrapped.task.camera.update(view)
    step = float(env.unwrapped.dt)
    every = max(1, round(1 / (RATE * step)))
    observation, _ = env.reset(seed=SEED)
    for number in range(round(seconds / step)):
        if number % every == 0:
            yield np.asarray(env.render())
        action = policy.act(observation[None], np.array([number]))[0]
        observation, *_ = env.step(action)
    env.close()


def trail() -> Iterator[np.ndarray]:
    """The hexapod walks away, seen from behind."""
    return of_policy("Hexapod-v0/ppo-0", 6.0, distance=1.6, elevation=-24.0, azimuth=140.0)


def trench() -> Iterator[np.ndarray]:
    """A worm crawls."""
    return of_policy("ChainCrawl-v0/ppo-0", 6.0, distance=1.6, elevation=-28.0, azimuth=150.0)


BALL = """<mujoco><worldbody><body name="ball" pos="0 0 0.1">
  <freejoint/><geom type="sphere" size="0.03" density="7800" rgba=".55 .58 .62 1"/>
</body></worldbody></mujoco>"""


def crater() -> Iterator[np.ndarray]:
    """A steel ball of 6 cm at 2.5 m/s, and its crater."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "ball.xml"
        file.write_text(BALL)
        drop = Drop(
            file, velocity=2.5, law="rft3d inertia=1.1 added=2.5",
            duration=0.8, timestep=5e-4, memory="cell=0.005 extent=1",
        )  # fmt: skip
        result = run_drop(drop)
        model, _ = load(drop)
    film = Film(camera="free", width=WIDTH, height=HEIGHT, fps=round(RATE), seconds=4.0)
    motion = Motion(result.t, result.qpos, result.point, result.force)
    surface, memory = drop.surface, as_memory(drop.memory)
    return frames_of_model(film, model, motion, surface, result.prints, memory)[1]


SHOWN = {"trail": trail, "crater": crater, "trench": trench}


def main(names: list[str]) -> None:
    """Writes `prints_NAME.mp4` and its last picture, `prints_NAME.jpg`."""
    mediapy.set_ffmpeg(imageio_ffmpeg.get_ffmpeg_exe())
    for name in names or SHOWN:
        frames = list(SHOWN[name]())
        film = FOLDER / f"prints_{name}.mp4"
        mediapy.write_video(film, frames, fps=RATE, codec="h264", crf=28)
        still = film.with_suffix(".jpg")
        Image.fromarray(frames[-1]).save(still, quality=85)
        for path in (film, still):
            print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
