"""Whether a window can be opened."""

import importlib
import warnings
from typing import Any


def opens_window(*, monitor: bool = False) -> bool:
    """Return True if a window opens; without one MuJoCo's viewers wait, or end the process.

    With `monitor` the display must have one, whose size Gymnasium's viewer asks for.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
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
