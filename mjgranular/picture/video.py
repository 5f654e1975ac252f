"""Films of a run in slow motion, with the force of the sand as an arrow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from mjgranular._util.extras import require
from mjgranular._util.files import atomic_write
from mjgranular.errors import InputError, UnknownNameError
from mjgranular.experiment.trajectory import Trajectory
from mjgranular.models import Link
from mjgranular.picture.scene import Ground, View, add_arrow, make_renderer
from mjgranular.relief import Memory
from mjgranular.relief.memory import as_memory
from mjgranular.render import Tracks
from mjgranular.render.material import moving_geoms
from mjgranular.render.scenery import add_cut_scenery, place_sun
from mjgranular.sand import SandSpec
from mjgranular.sand.prepare import fitted
from mjgranular.surface import Surface

_PURPOSE = "Writing a video"
_LONGEST = 3600.0  # film [s]
_STILL = 5e-4  # in parts of the view: a motion too small to see
_ARROWS = 0.5  # length of the longest arrow, in parts of the view


@dataclass(frozen=True)
class Film:
    """Options of a film.

    Attributes:
        camera: name of a camera of the model.
        width: width of the picture [pixels]; even.
        height: height of the picture [pixels]; even.
        fps: frames per second.
        seconds: duration of the film of the impact, from release to the stop [s]; the rest of the
            run, if any, takes as long again.
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

    def check(self, link: Link) -> None:
        """Check that the model has the camera and that the packages are installed."""
        known = [camera.name for camera in link.spec().cameras]
        if self.camera not in known:
            raise UnknownNameError("camera", self.camera, known)


@dataclass(frozen=True)
class Motion:
    """Data of a run of any model for a film.

    Attributes:
        t: times [s], shape (n,).
        qpos: shape (n, nq).
        point: points where forces act [m], shape (n, bodies, 3).
        force: [N], shape (n, bodies, 3).
    """

    t: np.ndarray
    qpos: np.ndarray
    point: np.ndarray
    force: np.ndarray


class _Frame(NamedTuple):
    """Content of a frame: state, arrows from `tails` to `tips`, shape (n, 3), and caption."""

    time: float
    qpos: Any
    tails: np.ndarray
    tips: np.ndarray
    caption: tuple[str, ...]


def frames_of_run(
    film: Film,
    link: Link,
    trajectory: Trajectory,
    *,
    stop: float | None,
    prints: Tracks | None = None,
    sand: SandSpec | None = None,
) -> tuple[int, Iterator[np.ndarray]]:
    """Return the pictures of a run of a link, one by one.

    Args:
        film: options of the film.
        link: the link.
        trajectory: the run.
        stop: time from release to the stop [s], None if there was none.
        prints: tracks of the run; None for sand without memory.
        sand: the sand with memory.

    Returns:
        Number of pictures, and the pictures, shape (height, width, 3), uint8.

    Raises:
        RenderError: MuJoCo cannot render on this machine; says what to install.
        UnknownNameError: no such camera.
    """
    film.check(link)
    spec = link.spec()
    shown = None if prints is None or sand is None else as_memory(sand.memory)
    add_cut_scenery(spec, link.reach, shown)
    model = spec.compile()
    place_sun(model)
    memory = None if sand is None else as_memory(fitted(model, sand).memory)
    covered = None if prints is None or memory is None else (prints, memory)
    ground = Ground(model, None, View(np.zeros(3), link.reach), covered)
    frames = list(_frames_of_link(film, link, trajectory, stop))
    pictures = _render(film, model, film.camera, ground, frames, width=link.length * 0.014)
    return len(frames), pictures


def _frames_of_link(
    film: Film, link: Link, trajectory: Trajectory, stop: float | None
) -> Iterator[_Frame]:
    end = float(trajectory.t[-1])
    phases = [(0.0, end)]
    if stop is not None and end > 1.05 * stop:
        phases = [(0.0, stop), (stop, end)]
    count, frame = max(2, round(film.seconds * film.fps)), None
    # The largest force is an arrow of seven tenths of a link's length.
    greatest = float(np.hypot(trajectory.F_x, trajectory.F_y).max())
    scale = 0.7 * link.length / max(greatest, 1e-300)
    for start, finish in phases:
        slower = film.seconds / (finish - start)
        for time in np.linspace(start, finish, count):
            at = {
                name: float(np.interp(time, trajectory.t, getattr(trajectory, name)))
                for name in ("x", "z", "q", "x_E", "y_E", "F_x", "F_y", "y_T")
            }
            # In front of the link, so that the link does not hide it.
            tail = np.array([[at["x_E"], -0.8 * link.diameter, -at["y_E"]]])
            arrow = scale * np.array([[at["F_x"], 0.0, -at["F_y"]]])
            seen = at["y_T"] > 0 and np.linalg.norm(arrow) > 1e-3 * link.length
            frame = _Frame(
                float(time),
                (at["x"], at["z"], at["q"]),
                tail[: int(seen)],
                (tail + arrow)[: int(seen)],
                (
                    f"t = {time * 1e3:.2f} ms",
                    f"depth of T = {max(at['y_T'], 0.0) * 1e3:.1f} mm",
                    f"force = {np.hypot(at['F_x'], at['F_y']):.0f} N",
                    f"slowed down {_two_digits(slower)}x",
                ),
            )
            yield frame
    assert frame is not None
    yield from [frame] * round(film.hold * film.fps)


def check_camera(model: mujoco.MjModel, camera: str) -> None:
    """Check that a model has a camera."""
    known = ["free", *(model.camera(c).name for c in range(model.ncam))]
    if camera not in known:
        raise UnknownNameError("camera", camera, known)


def frames_of_model(
    film: Film,
    model: mujoco.MjModel,
    motion: Motion,
    surface: Surface | None = None,
    prints: Tracks | None = None,
    memory: Memory | None = None,
) -> tuple[int, Iterator[np.ndarray]]:
    """Return the pictures of a run of any model, in real time or slower to fill the film.

    Args:
        film: options of the film; `camera` may be "free", which shows the whole run.
        model: the model.
        motion: the run.
        surface: surface of the sand; a plane is drawn, others are geoms. None to draw none.
        prints: tracks of the run; None for sand without memory.
        memory: options of the memory.

    Returns:
        Number of pictures, and the pictures, shape (height, width, 3), uint8.

    Raises:
        InputError: the run is longer than an hour.
        UnknownNameError: no such camera.
        RenderError: MuJoCo cannot render on this machine; says what to install.
    """
    check_camera(model, film.camera)
    span = float(motion.t[-1] - motion.t[0])
    if span > _LONGEST:
        raise InputError(f"a film of the run's {span:g} s would be longer than {_LONGEST:g} s")
    seconds = max(film.seconds, span)
    count = max(2, round(seconds * film.fps))
    slower = seconds / span if span else 1.0
    view = View.of(model, mujoco.MjData(model), motion.qpos)
    camera = view.camera(model, film.width / film.height) if film.camera == "free" else film.camera
    covered = None if prints is None or memory is None else (prints, memory)
    ground = Ground(model, surface, view, covered)
    frames = _frames_of_motion(model, motion, view, count, slower)
    still, width = _STILL * view.radius, 0.016 * view.radius
    pictures = _render(film, model, camera, ground, frames, width=width, still=still, follow=True)
    return count, pictures


def _frames_of_motion(
    model: mujoco.MjModel, motion: Motion, view: View, count: int, slower: float
) -> Iterator[_Frame]:
    greatest = float(np.linalg.norm(motion.force, axis=2).max())
    scale = _ARROWS * view.radius / max(greatest, 1e-300)
    pace = "real time" if slower < 1.05 else f"slowed down {_two_digits(slower)}x"
    for time in np.linspace(motion.t[0], motion.t[-1], count):
        k = int(np.searchsorted(motion.t, time, side="right")) - 1
        arrows = scale * motion.force[k]
        seen = np.linalg.norm(arrows, axis=1) > 0.02 * view.radius
        total = float(np.linalg.norm(motion.force[k].sum(axis=0)))
        yield _Frame(
            float(time),
            _between(model, motion, k, float(time)),
            motion.point[k][seen],
            (motion.point[k] + arrows)[seen],
            (f"t = {time:.3f} s", f"force of the sand = {total:.0f} N", pace),
        )


def _between(model: mujoco.MjModel, motion: Motion, k: int, time: float) -> np.ndarray:
    """Interpolate `qpos` between sample k and the next."""
    qpos = motion.qpos[k].copy()
    if k + 1 < len(motion.t):
        span = motion.t[k + 1] - motion.t[k]
        change = np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, change, span, qpos, motion.qpos[k + 1])
        mujoco.mj_integratePos(model, qpos, change, time - motion.t[k])
    return qpos


def _render(
    film: Film,
    model: mujoco.MjModel,
    camera: str | mujoco.MjvCamera,
    ground: Ground,
    frames: Iterable[_Frame],
    *,
    width: float,
    still: float = 0.0,
    follow: bool = False,
) -> Iterator[np.ndarray]:
    """Render frames.

    `width` is that of arrows [m]. Motions up to `still` [m] are not rendered. Cameras and lights
    that track a center of mass do so if `follow` is true.
    """
    data, moving = mujoco.MjData(model), moving_geoms(model)
    caption, renderer = _Captions(film), make_renderer(model, film.width, film.height)
    shown, picture = np.zeros((0, 3)), np.zeros(0)
    try:
        for frame in frames:
            data.qpos[:] = frame.qpos
            mujoco.mj_kinematics(model, data)
            if follow:
                mujoco.mj_comPos(model, data)
            mujoco.mj_camlight(model, data)
            now = np.concatenate([data.geom_xpos, data.geom_xmat.reshape(-1, 3), frame.tips])
            moved = now.shape != shown.shape or np.abs(now - shown).max() > still
            if moved or ground.moves(frame.time):
                ground.lay(frame.time, data.geom_xpos[moving].mean(axis=0))
                renderer.update_scene(data, camera=camera)
                ground.show(renderer.scene)
                for tail, tip in zip(frame.tails, frame.tips, strict=True):
                    add_arrow(renderer.scene, tail, tip, width)
                shown, picture = now, renderer.render()
            yield caption.put(picture, frame.caption)
    finally:
        renderer.close()


class _Captions:
    """Captions in a corner of pictures."""

    def __init__(self, film: Film) -> None:
        self._image = require("PIL.Image", extra="video", purpose=_PURPOSE)
        self._draw = require("PIL.ImageDraw", extra="video", purpose=_PURPOSE)
        font = require("PIL.ImageFont", extra="video", purpose=_PURPOSE)
        self._size = max(10, film.height // 30)
        self._font = font.load_default(size=self._size)

    def put(self, picture: np.ndarray, lines: tuple[str, ...]) -> np.ndarray:
        """Return a copy of the picture with these lines in a corner."""
        image = self._image.fromarray(picture)
        pen = self._draw.Draw(image)
        pen.multiline_text(
            (image.width - self._size, self._size),
            "\n".join(lines),
            fill=(30, 30, 30),
            stroke_width=max(1, self._size // 10),
            stroke_fill=(240, 240, 240),
            font=self._font,
            anchor="ra",
            align="right",
        )
        return np.asarray(image)


def _two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"


def need_mediapy(purpose: str) -> Any:
    """Return the module mediapy, with the ffmpeg of imageio-ffmpeg."""
    mediapy = require("mediapy", extra="video", purpose=purpose)
    ffmpeg = require("imageio_ffmpeg", extra="video", purpose=purpose)
    mediapy.set_ffmpeg(ffmpeg.get_ffmpeg_exe())
    return mediapy


def write_video(
    path: Path,
    film: Film,
    count: int,
    pictures: Iterator[np.ndarray],
    *,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write pictures as an MP4 (H.264)."""
    mediapy = need_mediapy(_PURPOSE)
    first = next(pictures)  # fails on a machine that cannot render, before a file is opened
    shape = (film.height, film.width)
    with (
        atomic_write(path) as part,
        mediapy.VideoWriter(part, shape=shape, fps=film.fps, crf=20) as writer,
    ):
        writer.add_image(first)
        for done, picture in enumerate(pictures, start=2):
            writer.add_image(picture)
            if progress is not None:
                progress(done, count)
