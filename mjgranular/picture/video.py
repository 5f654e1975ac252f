"""Films of a run in slow motion, with the sand's force as an arrow."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mjgranular._util.extras import require
from mjgranular._util.files import atomic_write
from mjgranular.errors import InputError, RenderError, UnknownNameError
from mjgranular.experiment.scenery import add_cut_prints
from mjgranular.experiment.trajectory import Trajectory
from mjgranular.models import Link
from mjgranular.prints import Cover, Prints, Replay
from mjgranular.prints.cover import Region
from mjgranular.prints.look import NOT_SHOWN, TILE, PlaneLook, boxes_of, moving_geoms
from mjgranular.relief import Memory
from mjgranular.relief.memory import as_memory
from mjgranular.sand import SandSpec
from mjgranular.sand.prepare import fitted
from mjgranular.surface import Plane, Surface

_ARROW = np.array([0.80, 0.16, 0.10, 1.0], dtype=np.float32)
_PURPOSE = "Writing a video"
_LONGEST = 3600.0  # film [s]
# Chosen by appearance and speed: the time of software rendering is proportional to the samples.
_SAMPLES = 2  # per pixel
_STILL = 5e-4  # in parts of the view: a motion too small to see
_INSTANTS = 16  # number of instants at which the extent of the model is sampled
_MARGIN = 1.1  # around the view
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
    fps: int = 30
    seconds: float = 5.0
    hold: float = 1.0

    def __post_init__(self) -> None:
        for name, limit in (("width", 1920), ("height", 1080)):
            value = getattr(self, name)
            if not (16 <= value <= limit and value % 2 == 0):
                raise InputError(
                    f"the video's {name} must be an even number of pixels from 16 to {limit}, "
                    f"not {value}"
                )
        if not 1 <= self.fps <= 240:
            raise InputError(f"a video has 1 to 240 frames a second, not {self.fps}")
        if not 0.1 <= self.seconds <= 600:
            raise InputError(f"the film must last 0.1 to 600 seconds, not {self.seconds}")
        if not 0 <= self.hold <= 60:
            raise InputError(f"the last frame can stand for 0 to 60 seconds, not {self.hold}")

    def check(self, link: Link) -> None:
        """Check that the model has the camera and that the packages are installed.

        Raises:
            UnknownNameError: it does not; lists the model's cameras.
            MissingExtraError: gives the install line.
        """
        known = [camera.name for camera in link.spec().cameras]
        if self.camera not in known:
            raise UnknownNameError("camera", self.camera, known)


@dataclass(frozen=True)
class _Frame:
    time: float
    slower: float  # slow-motion factor; 1 for real time


def _frames(film: Film, end: float, stop: float | None) -> list[_Frame]:
    """Return the instants of the frames."""
    goes_on = stop is not None and end > 1.05 * stop
    phases = [(0.0, stop), (stop, end)] if stop is not None and goes_on else [(0.0, end)]
    frames: list[_Frame] = []
    count = max(2, round(film.seconds * film.fps))
    for start, finish in phases:
        slower = film.seconds / (finish - start)
        times = np.linspace(start, finish, count)
        frames += [_Frame(float(time), slower) for time in times]
    return frames + [frames[-1]] * round(film.hold * film.fps)


def frames_of_run(
    film: Film,
    link: Link,
    trajectory: Trajectory,
    *,
    stop: float | None,
    prints: Prints | None = None,
    sand: SandSpec | None = None,
) -> tuple[int, Iterator[np.ndarray]]:
    """Return the pictures of a run, one by one.

    Args:
        film: options of the film.
        link: the link.
        trajectory: the run.
        stop: time from release to the stop [s], None if there was none.
        prints: history of the sand's memory; None for sand without memory.
        sand: the sand with memory.

    Returns:
        Number of pictures, and the pictures, shape (height, width, 3), uint8.

    Raises:
        RenderError: MuJoCo cannot render on this machine; says what to install.
        UnknownNameError: no such camera.
    """
    film.check(link)
    frames = _frames(film, float(trajectory.t[-1]), stop)
    spec = link.spec()
    if prints is not None and sand is not None:
        add_cut_prints(spec, as_memory(sand.memory))
    model = spec.compile()
    memory = None if sand is None else as_memory(fitted(model, sand).memory)
    covered = None if prints is None or memory is None else (prints, memory)
    return len(frames), _draw(film, link, model, trajectory, frames, covered)


def _draw(
    film: Film,
    link: Link,
    model: mujoco.MjModel,
    trajectory: Trajectory,
    frames: list[_Frame],
    covered: tuple[Prints, Memory] | None,
) -> Iterator[np.ndarray]:
    ground = _Ground(model, None, View(np.zeros(3), link.reach), covered)
    data = mujoco.MjData(model)
    force = np.hypot(trajectory.F_x, trajectory.F_y)
    # The largest force is an arrow of seven tenths of a link's length.
    scale = 0.7 * link.length / max(float(force.max()), 1e-300)
    caption = _Captions(film)
    renderer = _renderer(model, film)
    try:
        shown: tuple[_Frame, np.ndarray] | None = None
        for frame in frames:
            if shown is None or shown[0] != frame:
                at = {
                    name: float(np.interp(frame.time, trajectory.t, getattr(trajectory, name)))
                    for name in ("x", "z", "q", "x_E", "y_E", "F_x", "F_y", "y_T", "v_Ty")
                }
                data.qpos[:] = at["x"], at["z"], at["q"]
                mujoco.mj_kinematics(model, data)
                mujoco.mj_camlight(model, data)
                ground.lay(frame.time, data.body("link").xpos)
                renderer.update_scene(data, camera=film.camera)
                ground.show(renderer.scene)
                # In front of the link, so that the link does not hide it.
                tail = np.array([at["x_E"], -0.8 * link.diameter, -at["y_E"]])
                tip = tail + scale * np.array([at["F_x"], 0.0, -at["F_y"]])
                if at["y_T"] > 0 and np.linalg.norm(tip - tail) > 1e-3 * link.length:
                    _add_arrow(renderer.scene, tail, tip, link.length * 0.014)
                shown = frame, caption.write(renderer.render(), frame, at)
            yield shown[1]
    finally:
        renderer.close()


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


def check_camera(model: mujoco.MjModel, camera: str) -> None:
    """Check that a model has a camera.

    Raises:
        UnknownNameError: it does not; lists its cameras.
    """
    known = [model.camera(c).name for c in range(model.ncam)]
    if camera not in ("free", *known):
        raise UnknownNameError("camera", camera, ["free", *known])


def frames_of_model(
    film: Film,
    model: mujoco.MjModel,
    motion: Motion,
    surface: Surface | None = None,
    prints: Prints | None = None,
    memory: Memory | None = None,
) -> tuple[int, Iterator[np.ndarray]]:
    """Return the pictures of a run of any model, in real time or slower to fill the film.

    Args:
        film: options of the film; `camera` may be "free", which shows the whole run.
        model: the model.
        motion: the run.
        surface: surface of the sand; a plane is drawn, others are geoms. None to draw none.
        prints: history of the sand's memory; None for sand without memory.
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
    covered = None if prints is None or memory is None else (prints, memory)
    return count, _draw_model(film, model, motion, surface, covered, count, slower)


def _draw_model(
    film: Film,
    model: mujoco.MjModel,
    motion: Motion,
    surface: Surface | None,
    covered: tuple[Prints, Memory] | None,
    count: int,
    slower: float,
) -> Iterator[np.ndarray]:
    data = mujoco.MjData(model)
    view = View.of(model, data, motion.qpos)
    camera = view.camera(model, film) if film.camera == "free" else film.camera
    ground = _Ground(model, surface, view, covered)
    greatest = float(np.linalg.norm(motion.force, axis=2).max())
    scale = _ARROWS * view.radius / max(greatest, 1e-300)
    caption = _Captions(film)
    renderer = _renderer(model, film)
    moving = moving_geoms(model)
    shown, picture = np.zeros(0), np.zeros(0)
    try:
        for time in np.linspace(motion.t[0], motion.t[-1], count):
            k = int(np.searchsorted(motion.t, time, side="right")) - 1
            data.qpos[:] = _between(model, motion, k, float(time))
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_camlight(model, data)
            arrows = scale * motion.force[k]
            seen = np.linalg.norm(arrows, axis=1) > 0.02 * view.radius
            tips = motion.point[k] + arrows * seen[:, None]
            now = np.concatenate([data.geom_xpos, data.geom_xmat.reshape(-1, 3), tips])
            # A scene at rest is rendered once.
            moved = not shown.size or np.abs(now - shown).max() > _STILL * view.radius
            if moved or ground.moves(float(time)):
                ground.lay(float(time), data.geom_xpos[moving].mean(axis=0))
                renderer.update_scene(data, camera=camera)
                ground.show(renderer.scene)
                for point, tip in zip(motion.point[k][seen], tips[seen], strict=True):
                    _add_arrow(renderer.scene, point, tip, 0.016 * view.radius)
                shown, picture = now, renderer.render()
            total = motion.force[k].sum(axis=0)
            lines = (
                f"t = {time:.3f} s",
                f"force of the sand = {np.linalg.norm(total):.0f} N",
                "real time" if slower < 1.05 else f"slowed down {_two_digits(slower)}x",
            )
            yield caption.put(picture, lines)
    finally:
        renderer.close()


def _between(model: mujoco.MjModel, motion: Motion, k: int, time: float) -> np.ndarray:
    """Interpolate `qpos` between sample k and the next."""
    qpos = motion.qpos[k].copy()
    if k + 1 < len(motion.t):
        span = motion.t[k + 1] - motion.t[k]
        change = np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, change, span, qpos, motion.qpos[k + 1])
        mujoco.mj_integratePos(model, qpos, change, time - motion.t[k])
    return qpos


@dataclass(frozen=True)
class View:
    """A sphere around all visible moving parts, over a whole run.

    Attributes:
        middle: center [m], shape (3,).
        radius: [m].
    """

    middle: np.ndarray
    radius: float

    @classmethod
    def of(cls, model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> View:
        """Return the view of a run through these positions, shape (n, nq); `data` is changed."""
        geoms = moving_geoms(model)
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for row in qpos[:: max(1, len(qpos) // _INSTANTS)]:
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            lowest, highest = boxes_of(model, data, geoms)
            low = np.minimum(low, lowest.min(axis=0))
            high = np.maximum(high, highest.max(axis=0))
        return cls((low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-6))

    def camera(self, model: mujoco.MjModel, film: Film) -> mujoco.MjvCamera:
        """Return a free camera that shows it, from slightly above."""
        angle = math.radians(model.vis.global_.fovy) / 2
        angle = min(angle, math.atan(math.tan(angle) * film.width / film.height))
        camera = mujoco.MjvCamera()
        camera.lookat[:] = self.middle
        camera.distance = _MARGIN * self.radius / math.sin(angle)
        camera.azimuth, camera.elevation = 120.0, -18.0
        return camera


class _Ground:
    """The sand in a scene."""

    def __init__(
        self,
        model: mujoco.MjModel,
        surface: Surface | None,
        view: View,
        covered: tuple[Prints, Memory] | None = None,
    ) -> None:
        self._middle, self._look, self._plane, self._geoms = view.middle, None, None, ()
        self._cover = None
        if covered is not None:
            unit = 2 * view.radius if isinstance(surface, Plane) else TILE
            region = None
            if surface is None:
                region, unit = _cut_open(model)
            self._cover = Cover(model, surface or Plane(), covered[1], unit=unit, region=region)
            self._replay, self._prints = Replay(*covered), covered[0]
            return
        if isinstance(surface, Plane):
            self._plane = surface
            self._look = PlaneLook.of(model, surface.normal, surface.offset, view.radius)
        elif surface is not None:
            self._geoms = surface.geoms(model)

    def moves(self, time: float) -> bool:
        """Return True if sand has flowed between the last picture and a time [s]."""
        return self._cover is not None and self._prints.change(self._replay.time, time)

    def lay(self, time: float, middle: np.ndarray) -> None:
        """Update the prints to a time [s], around a place [m]. Call this before a scene is made."""
        if self._cover is not None:
            self._cover.lay(self._replay.to(time), middle)

    def show(self, scene: mujoco.MjvScene) -> None:
        """Add a plane; stop geoms of sand from casting shadows, which would speckle them."""
        if self._cover is not None:
            self._cover.show(scene)
        if self._look is not None and self._plane is not None:
            self._look.add(scene, self._plane.normal, self._plane.offset, self._middle)
        if self._geoms:
            for geom in scene.geoms[: scene.ngeom]:
                if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in self._geoms:
                    geom.category = mujoco.mjtCatBit.mjCAT_DECOR


def _cut_open(model: mujoco.MjModel) -> tuple[Region, float]:
    """Return the box of sand behind a link or a chain, which is drawn with prints in its place.

    Returns:
        The box, and the edge length of its texture of grains [m].
    """
    bed = model.geom("bed")
    bed.group = NOT_SHOWN
    low, high = bed.pos - bed.size, bed.pos + bed.size
    grains = 2 / float(model.mat_texrepeat[bed.matid.item(), 0])  # of a box MuJoCo has half sizes
    return Region((low[0], low[1]), (high[0], high[1]), low[2]), grains


def _renderer(model: mujoco.MjModel, film: Film) -> Any:
    # Exactly the size of the picture: MuJoCo processes its whole buffer.
    model.vis.global_.offwidth, model.vis.global_.offheight = film.width, film.height
    model.vis.quality.offsamples = min(model.vis.quality.offsamples, _SAMPLES)
    try:
        return mujoco.Renderer(model, film.height, film.width)
    except Exception as error:  # each platform's GL fails differently
        raise RenderError(
            f"MuJoCo cannot draw on this machine ({type(error).__name__}: {error}); on Linux "
            "without a screen install libegl1 (apt-get install libegl1 libgl1-mesa-dri) and import "
            "mjgranular before mujoco, or set MUJOCO_GL=egl yourself; MUJOCO_GL=osmesa with "
            "libosmesa6 works too"
        ) from None


def _add_arrow(scene: Any, tail: np.ndarray, tip: np.ndarray, width: float) -> None:
    """Add an arrow to a scene."""
    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(
        geom, mujoco.mjtGeom.mjGEOM_ARROW, np.zeros(3), np.zeros(3), np.eye(3).ravel(), _ARROW
    )
    mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, width, tail, tip)
    scene.ngeom += 1


class _Captions:
    """Writes time, depth and slow motion into a corner of each picture."""

    def __init__(self, film: Film) -> None:
        self._image = require("PIL.Image", extra="video", purpose=_PURPOSE)
        self._draw = require("PIL.ImageDraw", extra="video", purpose=_PURPOSE)
        font = require("PIL.ImageFont", extra="video", purpose=_PURPOSE)
        self._size = max(10, film.height // 30)
        self._font = font.load_default(size=self._size)

    def write(self, picture: np.ndarray, frame: _Frame, at: dict[str, float]) -> np.ndarray:
        """Return a copy of the picture with the numbers of a link's impact."""
        lines = (
            f"t = {frame.time * 1e3:.2f} ms",
            f"depth of T = {max(at['y_T'], 0.0) * 1e3:.1f} mm",
            f"force = {np.hypot(at['F_x'], at['F_y']):.0f} N",
            f"slowed down {_two_digits(frame.slower)}x",
        )
        return self.put(picture, lines)

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


def write_video(
    path: Path,
    film: Film,
    count: int,
    pictures: Iterator[np.ndarray],
    *,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write pictures as an MP4 (H.264).

    Args:
        path: path of the file.
        film: options of the film.
        count: number of pictures.
        pictures: from `frames_of_run` or `frames_of_model`.
        progress: called with the number of frames written, and the total.

    Raises:
        MissingExtraError: a package for video is not installed; gives the install line.
        RenderError: MuJoCo cannot render on this machine.
    """
    mediapy = require("mediapy", extra="video", purpose=_PURPOSE)
    ffmpeg = require("imageio_ffmpeg", extra="video", purpose=_PURPOSE)
    mediapy.set_ffmpeg(ffmpeg.get_ffmpeg_exe())
    first = next(pictures)  # fails on a machine that cannot render, before a file is opened
    shape = (film.height, film.width)
    with (
        whole(path) as part,
        mediapy.VideoWriter(part, shape=shape, fps=film.fps, crf=20) as writer,
    ):
        writer.add_image(first)
        for done, picture in enumerate(pictures, start=2):
            writer.add_image(picture)
            if progress is not None:
                progress(done, count)
