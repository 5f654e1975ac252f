"""Films that notebooks show."""

from __future__ import annotations

from typing import Any

import numpy as np

from mjgranular.errors import InputError
from mjgranular.experiment.drop import DropResult, load, surface_drawn
from mjgranular.experiment.impact import ImpactResult
from mjgranular.extras import need
from mjgranular.given import kind_of
from mjgranular.picture.video import Film, Motion, frames_of_model, frames_of_run
from mjgranular.relief.memory import as_memory

_PURPOSE = "Showing a film"


def play(film: Any, *, fps: int, seconds: float, camera: str | None) -> None:
    """Plays a film; see `mjgranular.show`."""
    mediapy = need("mediapy", extra="video", purpose=_PURPOSE)
    ffmpeg = need("imageio_ffmpeg", extra="video", purpose=_PURPOSE)
    mediapy.set_ffmpeg(ffmpeg.get_ffmpeg_exe())
    mediapy.show_video(_pictures(film, fps, seconds, camera), fps=fps)


def _pictures(film: Any, fps: int, seconds: float, camera: str | None) -> list[np.ndarray]:
    """The pictures of a film, or of a result."""
    if isinstance(film, DropResult):
        options = Film(camera=camera or "free", fps=fps, seconds=seconds)
        model, _ = load(film.drop)
        motion = Motion(film.t, film.qpos, film.point, film.force)
        surface, memory = surface_drawn(film.drop), as_memory(film.drop.memory)
        return list(frames_of_model(options, model, motion, surface, film.prints, memory)[1])
    if isinstance(film, ImpactResult):
        options = Film(camera=camera or "side", fps=fps, seconds=seconds)
        stop = None if film.stop is None else (film.touchdown or 0.0) + film.stop.time
        return list(frames_of_run(options, film.impact.link, film.trajectory, stop=stop)[1])
    try:
        pictures = [np.asarray(picture) for picture in film]
    except TypeError:
        pictures = []
    if not pictures or any(p.ndim != 3 or p.shape != pictures[0].shape for p in pictures):
        raise InputError(
            "show takes pictures of one size, shape (height, width, 3), such as those of "
            f"env.render(), or the result of run_drop or run_impact, not {kind_of(film)}"
        )
    return pictures
