"""Rendering of a simulation, to images or a window."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from mjgranular._util.checks import check_count
from mjgranular._util.display import opens_window
from mjgranular.envs.ground import DUNES
from mjgranular.envs.task import Task
from mjgranular.errors import InputError, RenderError, UnknownNameError, drawing

RENDER_MODES = ["human", "rgb_array"]


def check_camera(model: mujoco.MjModel, name: str | None) -> None:
    """Check that a model has a camera of that name, or that no name is given."""
    known = [model.camera(number).name for number in range(model.ncam)]
    if name is not None and name not in known:
        hint = "without a name the one that follows the robot is taken"
        raise UnknownNameError("camera", name, known, hint)


def check_mode(mode: str | None, modes: Sequence[str]) -> None:
    """Check the name of a way to render, or that there is none."""
    if mode not in (None, *modes):
        raise InputError(f"render_mode must be None or one of {', '.join(modes)}, not {mode!r}")


def check_screen(mode: str | None) -> None:
    """Check that a window can be opened if one is needed: GLFW would end the process."""
    if mode == "human" and not opens_window(monitor=True):
        raise RenderError("render_mode='human' needs a screen; without one use 'rgb_array'")


class Cameras:
    """A camera that follows the robot, or one of the model's cameras.

    Sizes are in pixels; the mode is None, "human" or "rgb_array".
    """

    def __init__(
        self, task: Task, mode: str | None, width: int, height: int, camera_name: str | None
    ) -> None:
        check_mode(mode, RENDER_MODES)
        check_count("width", width)
        check_count("height", height)
        check_camera(task.model, camera_name)
        self.mode, self.width, self.height, self.camera_name = mode, width, height, camera_name
        self.settings = {
            "render_mode": mode, "width": width, "height": height, "camera_name": camera_name,
        }  # fmt: skip
        self._task, self._renderer, self._viewer = task, None, None
        self._surfaces = [choice.surface for choice in task.choices]

    def look(self, model: mujoco.MjModel, data: mujoco.MjData, sand: int) -> np.ndarray | None:
        """Render an image, shape (height, width, 3), or to the window."""
        if self.mode is None:
            return None
        self._show_ground(model, sand)
        if self.mode == "human":
            return self._show(model, data)
        if self._renderer is None:
            screen = model.vis.global_
            screen.offwidth = max(screen.offwidth, self.width)
            screen.offheight = max(screen.offheight, self.height)
            with drawing():
                self._renderer = mujoco.Renderer(model, self.height, self.width)
        self._renderer.model.geom_rgba[:] = model.geom_rgba
        self._renderer.update_scene(data, self.camera_name or _free(self._task.camera))
        return self._renderer.render()

    def close(self) -> None:
        for thing in (self._renderer, self._viewer):
            if thing is not None:
                thing.close()
        self._renderer = self._viewer = None

    def _show_ground(self, model: mujoco.MjModel, sand: int) -> None:
        """Show the active ground and hide the other."""
        if len(set(self._surfaces)) < 2:
            return
        dunes = self._surfaces[sand] == "dunes"
        for geom in (model.geom_bodyid == 0).nonzero()[0].tolist():
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
                model.geom_rgba[geom, 3] = float(not dunes)
            elif model.geom(geom).name == DUNES:
                model.geom_rgba[geom, 3] = float(dunes)

    def _show(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        if self._viewer is None:
            check_screen(self.mode)
            from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer

            look = self._task.camera, self.width, self.height
            self._viewer = MujocoRenderer(model, data, *look, camera_name=self.camera_name)
        with drawing():
            self._viewer.render("human")


def _free(settings: dict[str, Any]) -> mujoco.MjvCamera:
    """Return a camera as Gymnasium sets it: `lookat`, and numbers by name."""
    camera = mujoco.MjvCamera()
    if "trackbodyid" in settings:
        camera.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    for name, value in settings.items():
        setattr(camera, name, value)
    return camera
