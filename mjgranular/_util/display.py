"""What MuJoCo can draw on: the choice of its renderer, on import, and whether a window opens."""

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


choose_renderer()
