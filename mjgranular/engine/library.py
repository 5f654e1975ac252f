"""Functions of MuJoCo's library that the plugin calls from Python, past the Python bindings."""

from __future__ import annotations

import ctypes
from functools import cache

import mujoco
import numpy as np

from mjgranular.kernel.engine import library as loaded_library

_ADDRESS, _INT, _TEXT = ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p
_FUNCTIONS = {
    "mjp_defaultPlugin": (None, _ADDRESS),
    "mjp_registerPlugin": (_INT, _ADDRESS),
    "mjp_getPlugin": (_ADDRESS, _TEXT, _ADDRESS),
    "mj_getPluginConfig": (_TEXT, _ADDRESS, _INT, _TEXT),
    "mj_id2name": (_TEXT, _ADDRESS, _INT, _INT),
    "mj_copyModel": (_ADDRESS, _ADDRESS, _ADDRESS),
    "mju_malloc": (_ADDRESS, ctypes.c_size_t),
    "mju_free": (None, _ADDRESS),
}


@cache
def library() -> ctypes.CDLL:
    """MuJoCo's library, with the types of the functions above.

    Raises:
        ImportError: it does not lie beside the Python package `mujoco`.
    """
    handle = ctypes.CDLL(loaded_library()._name)
    for name, (result, *arguments) in _FUNCTIONS.items():
        function = getattr(handle, name)
        function.restype, function.argtypes = result, arguments
    return handle


def plugin_slot(name: str) -> int:
    """The number by which models refer to a plugin; -1 if MuJoCo knows none of that name."""
    slot = ctypes.c_int(-1)
    library().mjp_getPlugin(name.encode(), ctypes.addressof(slot))
    return slot.value


def instance_name(model: int, instance: int) -> str:
    """The name of an instance, or its number."""
    name = library().mj_id2name(model, int(mujoco.mjtObj.mjOBJ_PLUGIN), instance)
    return text_of(name) or str(instance)


def config_texts(model: int, instance: int, keys: tuple[str, ...]) -> dict[str, str]:
    """Texts of the configuration of an instance by key, "" for none."""
    read = library().mj_getPluginConfig
    texts = {key: read(model, instance, key.encode()) for key in keys}
    return {key: text_of(text) for key, text in texts.items()}


def text_of(raw: bytes | None) -> str:
    """A text of MuJoCo's, "" for none. A model file may hold any bytes: what is no UTF-8 is shown.

    Where MuJoCo's Python bindings read it they raise `UnicodeDecodeError`.
    """
    return (raw or b"").decode(errors="backslashreplace")


def memory_at(address: int, size: int) -> np.ndarray:
    """Bytes of memory that is not Python's, not copied."""
    return np.ctypeslib.as_array((ctypes.c_ubyte * size).from_address(address))
