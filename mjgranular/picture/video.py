"""Films of a run in slow motion, with the force of the sand as an arrow; films in notebooks."""

import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mjgranular._util.checks import check_name, kind_of, require
from mjgranular._util.files import atomic_write
from mjgranular.errors import (
    GranularError,
    GranularWarning,
    InputError,
    OutputError,
    RenderError,
    UnknownNameError,
)
from mjgranular.experiment.drop import Drop, DropResult, load, start_from
from mjgranular.experiment.impact import Impact, ImpactResult
from mjgranular.experiment.trajectory import Trajectory
from mjgranular.picture.scene import Ground, View, add_arrow, make_renderer
from mjgranular.relief import Memory
from mjgranular.relief.memory import as_memory
from mjgranular.render import Tracks
from mjgranular.render.material import moving_geoms
from mjgranular.render.scenery import add_cut_scenery, place_sun
from mjgranular.sand.prepare import fitted
from mjgranular.surface import Surface

_PURPOSE = "Writing a video"
_SHORT = 0.5  # run that ends before this has a clock in milliseconds [s]
_STILL = 5e-4  # in parts of the view: a motion too small to see
_ARROWS = 1.0  # longest arrow, in parts of the view; MuJoCo 4.0 draws half of it
_SEEN = 0.02  # length below which an arrow is omitted, in parts of the view
_WIDTH = 0.016  # width of arrows, in parts of the view

Frames = tuple[int, Iterator[np.ndarray]]
"""Number of pictures, and the pictures, shape (height, width, 3), uint8."""


@dataclass(frozen=True)
class Film:
    """Options of a film.

    Attributes:
        camera: name of a camera of the model.
        width: width of the picture [pixels]; even.
        height: height of the picture [pixels]; even.
        fps: frames per second.
        seconds: duration of the film of the impact, from release to the stop [s]; the rest of the
            run, if any, takes as long again; of a policy at most this much.
        hold: duration of the last frame [s].
    """

    camera: str = "side"
    width: int = 640
    height: int = 480
    fps: float = 30
    seconds: float = 5.0
    hold: float = 1.0

    def __post_init__(self) -> None:
        for name, limit in (("width", 1920), ("height", 1080)):
            value = getattr(self, name)
            if not (16 <= value <= limit and value % 2 == 0):
                raise InputError(
                    f"the video's {name} must be an even number of pixels from 16 to {limit}, "
                    f"got {value}"
                )
        if not 1 <= self.fps <= 240:
            raise InputError(f"a video has 1 to 240 frames a second, got {self.fps}")
        if not 0.1 <= self.seconds <= 600:
            raise InputError(f"the film must last 0.1 to 600 seconds, got {self.seconds}")
        if not 0 <= self.hold <= 60:
            raise InputError(f"the last frame can stand for 0 to 60 seconds, got {self.hold}")


@dataclass(frozen=True)
class Motion:
    """Data of a run of any model for a film."""

    t: np.ndarray  # times [s], shape (n,)
    qpos: np.ndarray  # shape (n, nq)
    point: np.ndarray  # points where forces act [m], shape (n, bodies, 3)
    force: np.ndarray  # [N], shape (n, bodies, 3)


def check_camera(model: mujoco.MjModel, camera: str) -> None:
    """Check that a model has a camera."""
    check_name("camera", camera, ["free", *(model.camera(c).name for c in range(model.ncam))])


def frames_of_impact(
    film: Film,
    impact: Impact,
    trajectory: Trajectory,
    stop: float | None,
    prints: Tracks | None = None,
) -> Frames:
    """Return the pictures of an impact, slowed down up to the stop, and after it.

    `stop` is the time from release to the stop [s].
    """
    link, sand, spec = impact.link, impact.described, impact.link.spec()
    memory = None if prints is None else as_memory(fitted(spec.compile(), sand).memory)
    add_cut_scenery(spec, link.reach, memory)
    model = spec.compile()
    check_camera(model, film.camera)
    place_sun(model)
    covered = None if prints is None or memory is None else (prints, memory)
    run, zero = trajectory, np.zeros(len(trajectory))
    # In front of the link, so that the link does not hide the arrow.
    point = np.stack([run.x_E, zero - 0.8 * link.diameter, -run.y_E], axis=1)
    force = np.stack([run.F_x, zero, -run.F_y], axis=1)
    qpos = np.stack([run.x, run.z, run.q], axis=1)
    motion = Motion(run.t, qpos, point[:, None], force[:, None])
    end = float(run.t[-1])
    ends = [0.0, end] if stop is None or end <= 1.05 * stop else [0.0, stop, end]
    times = [time for phase in pairwise(ends) for time in _times(film, *phase, film.seconds)]
    times += times[-1:] * round(film.hold * film.fps)
    view = View(np.zeros(3), link.reach)
    return len(times), _render(film, mujoco.MjData(model), motion, times, view, None, covered)


def frames_of_model(
    film: Film,
    model: mujoco.MjModel,
    motion: Motion,
    surface: Surface | None = None,
    prints: Tracks | None = None,
    memory: Memory | None = None,
    keyframe: str | None = None,
) -> Frames:
    """Return pictures of a run of any model, in real time or slower; a keyframe places mocaps."""
    check_camera(model, film.camera)
    begin, end = float(motion.t[0]), float(motion.t[-1])
    data = mujoco.MjData(model)
    start_from(model, data, keyframe)
    view = View.of(model, data, motion.qpos)
    times = _times(film, begin, end, max(film.seconds, end - begin))
    covered = None if prints is None or memory is None else (prints, memory)
    return len(times), _render(film, data, motion, times, view, surface, covered)


def frames_of_drop(
    film: Film, drop: Drop, samples: Mapping[str, Any], prints: Tracks | None
) -> Frames:
    """Return the pictures of a drop, with samples as those of a `DropResult`."""
    motion = Motion(*(samples[field.name] for field in fields(Motion)))
    with warnings.catch_warnings(action="ignore", category=GranularWarning):  # they were shown
        model, _ = load(drop)
    if motion.qpos.shape[1] != model.nq:
        raise OutputError(
            f"the samples have {motion.qpos.shape[1]} positions, {drop.title} has {model.nq}: it "
            "is not the model that ran"
        )
    memory = as_memory(fitted(model, drop.sand).memory)
    return frames_of_model(film, model, motion, drop.surface, prints, memory, drop.keyframe)


def _times(film: Film, begin: float, end: float, seconds: float) -> list[tuple[float, float]]:
    """Return for each frame the time [s], and how much slower than real time it is shown."""
    count = max(2, round(seconds * film.fps))
    slower = seconds / (end - begin) if end > begin else 1.0
    return [(float(time), slower) for time in np.linspace(begin, end, count)]


def _between(model: mujoco.MjModel, motion: Motion, k: int, time: float) -> np.ndarray:
    """Interpolate `qpos` between sample k and the next."""
    qpos = motion.qpos[k].copy()
    if k + 1 < len(motion.t):
        span, change = motion.t[k + 1] - motion.t[k], np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, change, span, qpos, motion.qpos[k + 1])
        mujoco.mj_integratePos(model, qpos, change, time - motion.t[k])
    return qpos


def _render(
    film: Film,
    data: mujoco.MjData,
    motion: Motion,
    times: list[tuple[float, float]],
    view: View,
    surface: Surface | None,
    covered: tuple[Tracks, Memory] | None,
) -> Iterator[np.ndarray]:
    """Yield the pictures at these times; invisible changes are not rendered."""
    model, moving = data.model, moving_geoms(data.model)
    ground = Ground(model, surface, view, covered)
    font = require("PIL.ImageFont", extra="video", purpose=_PURPOSE)
    font = font.load_default(size=max(10, film.height // 30))
    camera = view.camera(model, film.width / film.height) if film.camera == "free" else film.camera
    greatest = float(np.linalg.norm(motion.force, axis=2).max())
    digits = max(0, 2 - math.floor(math.log10(greatest or 1.0)))  # three of the greatest force
    scale = _ARROWS * view.radius / max(greatest, 1e-300)
    shown, picture = np.zeros((0, 3)), np.zeros(0)
    with make_renderer(model, film.width, film.height) as renderer:
        for time, slower in times:
            k = int(np.searchsorted(motion.t, time, side="right")) - 1
            data.qpos[:] = _between(model, motion, k, time)
            mujoco.mj_fwdPosition(model, data)  # cameras, lights, tendons and flexes too
            arrows = scale * motion.force[k]
            seen = np.linalg.norm(arrows, axis=1) > _SEEN * view.radius
            tails, tips = motion.point[k][seen], (motion.point[k] + arrows)[seen]
            points = data.geom_xpos, data.geom_xmat.reshape(-1, 3), data.flexvert_xpos, tips
            now = np.concatenate(points)
            moved = now.shape != shown.shape or np.abs(now - shown).max() > _STILL * view.radius
            if moved or ground.moves(time):
                ground.lay(time, data.geom_xpos[moving].mean(axis=0))
                renderer.update_scene(data, camera=camera)
                ground.show(renderer.scene)
                for tail, tip in zip(tails, tips, strict=True):
                    add_arrow(renderer.scene, tail, tip, _WIDTH * view.radius)
                shown, picture = now, renderer.render()
            total = float(np.linalg.norm(motion.force[k].sum(axis=0)))
            pace = "real time" if slower < 1.05 else f"slowed down {float(f'{slower:.2g}'):g}x"
            clock = f"{time * 1e3:.2f} ms" if times[-1][0] < _SHORT else f"{time:.3f} s"
            text = f"t = {clock}\nforce of the sand = {total:.{digits}f} N\n{pace}"
            yield _captioned(picture, text, font)


def _captioned(picture: np.ndarray, text: str, font: Any) -> np.ndarray:
    image = require("PIL.Image", extra="video", purpose=_PURPOSE).fromarray(picture)
    pen = require("PIL.ImageDraw", extra="video", purpose=_PURPOSE).Draw(image)
    pen.multiline_text(
        (image.width - font.size, font.size),
        text,
        fill=(30, 30, 30),
        stroke_width=max(1, int(font.size) // 10),
        stroke_fill=(240, 240, 240),
        font=font,
        anchor="ra",
        align="right",
    )
    return np.asarray(image)


def need_mediapy(purpose: str) -> Any:
    """Return the module mediapy, with the ffmpeg that imageio-ffmpeg finds."""
    mediapy = require("mediapy", extra="video", purpose=purpose)
    ffmpeg = require("imageio_ffmpeg", extra="video", purpose=purpose)
    with suppress(RuntimeError):  # it finds none
        mediapy.set_ffmpeg(ffmpeg.get_ffmpeg_exe())
    if not mediapy.video_is_available():
        raise RenderError("no ffmpeg is found: install it, or let IMAGEIO_FFMPEG_EXE be its path")
    return mediapy


def write_video(
    path: Path,
    film: Film,
    count: int,
    pictures: Iterator[np.ndarray],
    *,
    progress: Callable[[int, int], None] = lambda done, count: None,
) -> None:
    """Write pictures as an MP4 (H.264)."""
    mediapy = need_mediapy(_PURPOSE)
    first = next(pictures)  # fails on a machine that cannot render, before a file is opened
    try:
        with (
            atomic_write(path) as part,
            mediapy.VideoWriter(part, (film.height, film.width), fps=film.fps, crf=20) as writer,
        ):
            for done, picture in enumerate(chain([first], pictures), start=1):
                writer.add_image(picture)
                progress(done, count)
    except RuntimeError as error:
        if isinstance(error, GranularError) or "Error writing" not in str(error):
            raise
        reason = str(error).strip().rpartition("] ")[2]  # the last that ffmpeg wrote
        raise OutputError(f"the film cannot be written: {reason}") from error


def play(film: Any, fps: int, seconds: float, camera: str | None) -> None:
    """Play a film; see `mjgranular.show`."""
    if not isinstance(fps, int) or not 1 <= fps <= 240:
        raise InputError(f"frames per second must be an integer from 1 to 240, got {kind_of(fps)}")
    need_mediapy("Showing a film").show_video(_pictures(film, fps, seconds, camera), fps=fps)


def _pictures(film: Any, fps: int, seconds: float, camera: str | None) -> list[np.ndarray]:
    if isinstance(film, DropResult):
        options = Film(camera=camera or "free", fps=fps, seconds=seconds)
        return list(frames_of_drop(options, film.drop, vars(film), film.prints)[1])
    if isinstance(film, ImpactResult):
        options = Film(camera=camera or "side", fps=fps, seconds=seconds)
        stop = None if film.stop is None else (film.touchdown or 0.0) + film.stop.time
        return list(frames_of_impact(options, film.impact, film.trajectory, stop, film.prints)[1])
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
