"""Functions of MuJoCo's library that the plugin calls from Python without the Python bindings."""

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
    """Return MuJoCo's library, with the types of the functions above.

    Raises:
        ImportError: it is not in the directory of the Python package `mujoco`.
    """
    handle = ctypes.CDLL(loaded_library()._name)
    for name, (result, *arguments) in _FUNCTIONS.items():
        function = getattr(handle, name)
        function.restype, function.argtypes = result, arguments
    return handle


def plugin_slot(name: str) -> int:
    """Return the index by which models refer to a plugin; -1 if MuJoCo has none of that name."""
    slot = ctypes.c_int(-1)
    library().mjp_getPlugin(name.encode(), ctypes.addressof(slot))
    return slot.value


def instance_name(model: int, instance: int) -> str:
    """Return the name of an instance, or its index if it has no name."""
    name = library().mj_id2name(model, int(mujoco.mjtObj.mjOBJ_PLUGIN), instance)
    return text_of(name) or str(instance)


def config_texts(model: int, instance: int, keys: tuple[str, ...]) -> dict[str, str]:
    """Return the configuration strings of an instance by key, "" for missing ones."""
    read = library().mj_getPluginConfig
    texts = {key: read(model, instance, key.encode()) for key in keys}
    return {key: text_of(text) for key, text in texts.items()}


def text_of(raw: bytes | None) -> str:
    """Decode a string of MuJoCo, "" for none, with escapes for bytes that are not UTF-8.

    A model file may contain any bytes; MuJoCo's Python bindings raise `UnicodeDecodeError` for
    them.
    """
    return (raw or b"").decode(errors="backslashreplace")


def memory_at(address: int, size: int) -> np.ndarray:
    """Return a view of memory outside Python, without a copy."""
    return np.ctypeslib.as_array((ctypes.c_ubyte * size).from_address(address))
