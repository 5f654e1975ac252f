"""Whether a window can be opened."""

import importlib
import warnings
from typing import Any


def has_display() -> bool:
    """Return True if there is a display; without one MuJoCo's viewers wait, or end the process."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            glfw: Any = importlib.import_module("glfw")
        except ImportError:
            return False
        return bool(glfw.init()) and glfw.get_primary_monitor() is not None
