"""Films of drops for the front page and the gallery: some robots, and the paper's link.

python docs/figures/drop_films.py [ant humanoid half_cheetah quad link ...]
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import mjgranular  # isort: skip  # noqa: F401 (before mujoco: it chooses how to draw)
import gymnasium
import imageio_ffmpeg
import mediapy
import mujoco
import numpy as np
from PIL import Image

from mjgranular.experiment import Drop, Impact, run_drop, run_impact
from mjgranular.experiment.drop import load
from mjgranular.picture.video import Film, Motion, frames_of_impact, frames_of_model

FOLDER = Path(__file__).resolve().parent
ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
FILM = Film(camera="free", width=480, height=360, fps=25, seconds=4.0, hold=0.5)

OWN = FOLDER.parent / "models"
ROBOTS = {  # how they fall
    "ant": {"height": 0.4, "duration": 1.2},
    "humanoid": {"height": 0.3, "duration": 1.6},
    "half_cheetah": {"height": 0.5, "duration": 1.2},
    "quad": {"height": 0.2, "duration": 1.0},
}


def frames_of_robot(name: str) -> Iterator[np.ndarray]:
    """Pictures of a robot, ours or Gymnasium's, that falls on sand in place of its floor."""
    own = OWN / f"{name}.xml"
    spec = mujoco.MjSpec.from_file(str(own if own.exists() else ASSETS / f"{name}.xml"))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.compile()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{name}.xml"
        spec.to_file(str(file))
        drop = Drop(file, instead_of=("floor",), **ROBOTS[name])
        result = run_drop(drop)
        model, _ = load(drop)
    motion = Motion(result.t, result.qpos, result.point, result.force)
    return frames_of_model(FILM, model, motion, drop.surface)[1]


def frames_of_link() -> Iterator[np.ndarray]:
    """Pictures of the paper's first case: a steel link at 10 m/s."""
    result = run_impact(Impact(law="link_distributed", until="rest"))
    assert result.stop is not None
    assert result.touchdown is not None
    film = Film(camera="side", width=480, height=360, fps=25, seconds=2.5, hold=0.5)
    stop = result.touchdown + result.stop.time
    return frames_of_impact(film, result.impact, result.trajectory, stop)[1]


def main(names: list[str]) -> None:
    """Writes `drop_NAME.mp4` and its last picture, `drop_NAME.jpg`."""
    mediapy.set_ffmpeg(imageio_ffmpeg.get_ffmpeg_exe())
    for name in names or (*ROBOTS, "link"):
        frames = list(frames_of_link() if name == "link" else frames_of_robot(name))
        film = FOLDER / f"drop_{name}.mp4"
        mediapy.write_video(film, frames, fps=FILM.fps, codec="h264", crf=24)
        still = film.with_suffix(".jpg")
        Image.fromarray(frames[-1]).save(still, quality=80)
        for path in (film, still):
            print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
