"""Films in notebooks."""

from typing import Any

import numpy as np

from mjgranular._util.checks import kind_of
from mjgranular.errors import InputError, UnknownNameError
from mjgranular.experiment.drop import DropResult
from mjgranular.experiment.impact import ImpactResult
from mjgranular.picture.video import (
    Film,
    Motion,
    frames_of_drop,
    frames_of_run,
    need_mediapy,
)


def play(film: Any, *, fps: int, seconds: float, camera: str | None) -> None:
    """Play a film; see `mjgranular.show`."""
    if not isinstance(fps, int) or not 1 <= fps <= 240:
        raise InputError(f"frames per second must be an integer from 1 to 240, got {kind_of(fps)}")
    mediapy = need_mediapy("Showing a film")
    mediapy.show_video(_pictures(film, fps, seconds, camera), fps=fps)


def _pictures(film: Any, fps: int, seconds: float, camera: str | None) -> list[np.ndarray]:
    """Return the pictures of a film, or of a result."""
    if isinstance(film, DropResult):
        options = Film(camera=camera or "free", fps=fps, seconds=seconds)
        motion = Motion(film.t, film.qpos, film.point, film.force)
        return list(frames_of_drop(options, film.drop, motion, film.prints)[1])
    if isinstance(film, ImpactResult):
        options = Film(camera=camera or "side", fps=fps, seconds=seconds)
        stop = None if film.stop is None else (film.touchdown or 0.0) + film.stop.time
        impact, run, prints = film.impact, film.trajectory, film.prints
        drawn = frames_of_run(
            options, impact.link, run, stop=stop, prints=prints, sand=impact.described
        )
        return list(drawn[1])
    try:
        pictures = [np.asarray(picture) for picture in film]
    except (TypeError, ValueError, UnknownNameError):  # not a sequence, nor a known result
        pictures = []
    pictures = [picture[..., :3] if picture.ndim == 3 else picture for picture in pictures]
    if not pictures or any(p.ndim != 3 or p.shape != pictures[0].shape for p in pictures):
        raise InputError(
            "show takes pictures of one size, shape (height, width, 3), such as those of "
            f"env.render(), or the result of run_drop or run_impact, not {kind_of(film)}"
        )
    return pictures
