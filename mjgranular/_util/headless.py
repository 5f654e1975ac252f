"""Selection of MuJoCo's renderer on a machine without a display."""

import ctypes
import os
import sys


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


choose_renderer()
