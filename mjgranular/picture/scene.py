"""Views, sand and arrows in the scene of a film."""

import math
from dataclasses import dataclass
from typing import Any, Self

import mujoco
import numpy as np

from mjgranular.engine.looks import DrawnSand
from mjgranular.errors import drawing
from mjgranular.relief import Memory
from mjgranular.render import Replay, Tracks
from mjgranular.render.material import NOT_SHOWN, boxes_of, moving_geoms
from mjgranular.render.track_kernel import Region
from mjgranular.surface import Plane, Surface

_ARROW = np.array([0.80, 0.16, 0.10])
# Chosen by appearance and speed: the time of software rendering is proportional to the samples.
_SAMPLES = 2  # per pixel
_INSTANTS = 16  # number of instants at which the extent of the model is sampled
_MARGIN = 1.1  # around the view


@dataclass(frozen=True)
class View:
    """A sphere around all visible moving parts, over a whole run [m]."""

    middle: np.ndarray
    radius: float

    @classmethod
    def of(cls, model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> Self:
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

    def camera(self, model: mujoco.MjModel, aspect: float) -> mujoco.MjvCamera:
        """Return a free camera that shows it, from slightly above."""
        angle = math.radians(model.vis.global_.fovy) / 2
        angle = min(angle, math.atan(math.tan(angle) * aspect))
        camera = mujoco.MjvCamera()
        camera.lookat[:] = self.middle
        camera.distance = _MARGIN * self.radius / math.sin(angle)
        camera.azimuth, camera.elevation = 120.0, -18.0
        return camera


class Ground:
    """Sand in a scene; a `surface` of None is the bed of a link or a chain.

    `covered` has tracks of the run and memory of the sand; None for sand without memory.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        surface: Surface | None,
        view: View,
        covered: tuple[Tracks, Memory] | None = None,
    ) -> None:
        self._middle, self._sand, self._replay, self._geoms = view.middle, None, None, ()
        if covered is not None:
            region, unit = _cut_open(model) if surface is None else (None, 2 * view.radius)
            base, (self._prints, memory) = surface or Plane(), covered
            self._sand = DrawnSand(model, base, memory, unit=unit, region=region)
            self._replay = Replay(*covered)
        elif isinstance(surface, Plane):
            self._sand = DrawnSand(model, surface, radius=view.radius)
        elif surface is not None:
            self._geoms = surface.geoms(model)

    def moves(self, time: float) -> bool:
        """Return True if sand has flowed between the last picture and a time [s]."""
        return self._replay is not None and self._prints.change(self._replay.time, time)

    def lay(self, time: float, middle: np.ndarray) -> None:
        """Update the tracks to a time [s], around a place [m]; call this before a scene is made."""
        if self._sand is not None and self._replay is not None:
            self._sand.lay(self._replay.to(time), middle)

    def show(self, scene: mujoco.MjvScene) -> None:
        """Add a plane; stop geoms of sand from casting shadows, which would speckle them."""
        if self._sand is not None:
            self._sand.show(scene, self._middle)
        if self._geoms:
            for geom in scene.geoms[: scene.ngeom]:
                if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in self._geoms:
                    geom.category = mujoco.mjtCatBit.mjCAT_DECOR


def _cut_open(model: mujoco.MjModel) -> tuple[Region, float]:
    """Return the box of sand that a skin with tracks replaces, and the edge of its texture [m]."""
    bed = model.geom("bed")
    bed.group = NOT_SHOWN
    low, high = bed.pos - bed.size, bed.pos + bed.size
    grains = 2 / float(model.mat_texrepeat[bed.matid.item(), 0])  # of a box MuJoCo has half sizes
    return (low[:2], high[:2], low[2]), grains


def make_renderer(model: mujoco.MjModel, width: int, height: int) -> Any:
    """Make a renderer for pictures of a size in pixels."""
    # Exactly the size of the picture: MuJoCo processes its whole buffer.
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    model.vis.quality.offsamples = min(model.vis.quality.offsamples, _SAMPLES)
    with drawing():
        return mujoco.Renderer(model, height, width)


def add_arrow(
    scene: Any, tail: np.ndarray, tip: np.ndarray, width: float, color: np.ndarray = _ARROW
) -> None:
    """Add an arrow to a scene; `color` is red, green and blue, 0 to 1."""
    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    arrow, rgba = mujoco.mjtGeom.mjGEOM_ARROW, np.append(color, 1.0).astype(np.float32)
    mujoco.mjv_initGeom(geom, arrow, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
    mujoco.mjv_connector(geom, arrow, width, tail, tip)
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR  # mjv_initGeom leaves it as it was in memory
    scene.ngeom += 1
