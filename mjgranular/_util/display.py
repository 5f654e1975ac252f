"""Where MuJoCo draws: renderer, chosen on import; whether a window opens; films in notebooks."""

import ctypes
import importlib
import os
import sys
import warnings
from typing import Any


def choose_renderer() -> None:
    """Set `MUJOCO_GL=egl` where EGL is needed and the variable is not set.

    This applies on Linux without a display, with an EGL library, before mujoco is imported: MuJoCo
    reads the variable once. Its default (GLFW) needs a display and fails.
    """
    if "MUJOCO_GL" in os.environ or "mujoco" in sys.modules or not sys.platform.startswith("linux"):
        return
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError:
        return  # `import mujoco` would fail with the variable set; without it only rendering fails
    os.environ["MUJOCO_GL"] = "egl"


def opens_window(*, monitor: bool = False) -> bool:
    """Return True if a window opens; without one MuJoCo's viewers wait, or end the process.

    With `monitor` the display must have one, whose size Gymnasium's viewer asks for.
    """
    with warnings.catch_warnings(action="ignore"):
        try:
            glfw: Any = importlib.import_module("glfw")
        except ImportError:
            return False
        if not glfw.init() or (monitor and glfw.get_primary_monitor() is None):
            return False
        glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
        window = glfw.create_window(64, 64, "mjgranular", None, None)
        glfw.default_window_hints()  # else the next window is not visible either
        if window:
            glfw.destroy_window(window)  # others may be open: glfw is not terminated
        return bool(window)


def show(film: Any, *, fps: int = 30, seconds: float = 5.0, camera: str | None = None) -> None:
    """Play a film in the output of a notebook cell.

    Args:
        film: pictures, shape (height, width, 3), uint8, one by one or as an array; or the result of
            `mjgranular.experiment.run_drop` or `run_impact`, which is filmed.
        fps: frames per second.
        seconds: least duration of the film of a result [s]; longer runs are filmed in real time.
        camera: camera of the model, for the film of a result; None for one that shows everything.

    Raises:
        InputError: no pictures, or neither pictures nor a result.
        MissingExtraError: a package for video is not installed; gives the install line.
        RenderError: MuJoCo cannot render on this machine.
    """
    # Imported when used: it depends on packages that import this one.
    importlib.import_module("mjgranular.picture.video").play(film, fps, seconds, camera)


choose_renderer()
