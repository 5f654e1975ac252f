"""The plugins, `mjgranular.sand` and `mjgranular.sensor`: registered on import, compiled when used.

MuJoCo copies the struct of function pointers when it is registered, and looks into its copy at each
call. What is registered are a few functions of Python's; the first model with sand in it has them
replaced by compiled ones. A program that imports mjgranular and uses no plugin pays next to
nothing.
"""

from __future__ import annotations

import ctypes
import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import mujoco

from mjgranular.engine.aside import aside, is_aside
from mjgranular.engine.config import KEYS
from mjgranular.engine.instances import NAME
from mjgranular.engine.layout import LayoutError, find_layout
from mjgranular.engine.library import instance_name, library
from mjgranular.engine.tuning import STATE_SIZE
from mjgranular.errors import GranularError

SENSOR = "mjgranular.sensor"
SENSOR_KEYS = ("measure", "sand")

_logger = logging.getLogger(__name__)

_SENSOR, _PASSIVE = 1 << 1, 1 << 2  # mjPLUGIN_SENSOR, mjPLUGIN_PASSIVE
_VELOCITY = int(mujoco.mjtStage.mjSTAGE_VEL)
_LONGEST = 440  # bytes of a message: MuJoCo cuts at 500, its own words included

_int, _address = ctypes.c_int32, ctypes.c_int64
_CALLBACKS: dict[str, tuple[Any, ...]] = {
    "nstate": (_int, _address, _int),
    "nsensordata": (_int, _address, _int, _int),
    "init": (_int, _address, _address, _int),
    "destroy": (None, _address, _int),
    "copy": (None, _address, _address, _address, _int),
    "reset": (None, _address, _address, _address, _int),
    "compute": (None, _address, _address, _int, _int),
    "advance": (None, _address, _address, _int),
    "visualize": (None, _address, _address, _address, _address, _int),
}

_PREPARE = (_address, _address, _address, _int)


class PluginStruct(ctypes.Structure):
    """`mjpPlugin` of mjplugin.h."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("nattribute", ctypes.c_int),
        ("attributes", ctypes.POINTER(ctypes.c_char_p)),
        ("capabilityflags", ctypes.c_int),
        ("needstage", ctypes.c_int),
        *((name, ctypes.c_void_p) for name in _CALLBACKS),
        ("actuator_act_dot", ctypes.c_void_p),
        ("sdf", 5 * ctypes.c_void_p),
    )


@dataclass(frozen=True)
class Plugin:
    """What MuJoCo is told of a plugin beside its functions."""

    name: str
    keys: tuple[str, ...]
    capability: int
    stage: int = 0


class Engine:
    """What the plugins have in common: asleep until the first model needs one of them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._awake: set[str] = set()
        self._failure: Exception | None = None
        self._layout: Any = None
        self._loader: Any = None
        self._start: Any = None
        self._draws = False
        self._told = threading.local()

    def register(self, plugin: Plugin) -> None:
        """Makes a plugin known to MuJoCo.

        Raises:
            LayoutError: plugins of this version of MuJoCo are of another make.
        """
        lib = library()
        _check_struct(lib)
        struct = PluginStruct()
        lib.mjp_defaultPlugin(ctypes.addressof(struct))
        texts = [key.encode() for key in plugin.keys]
        struct.name = plugin.name.encode()
        struct.nattribute = len(texts)
        struct.attributes = (ctypes.c_char_p * len(texts))(*texts)
        struct.capabilityflags = plugin.capability
        struct.needstage = plugin.stage

        def nstate(model: int, instance: int) -> int:
            self._wake(plugin)
            return _size_of_state(model, instance) if plugin.name == NAME else 0

        def first_init(model: int, data: int, instance: int) -> int:
            self._wake(plugin)
            return self._init(model, data, instance)

        for callback, function in {
            "nstate": nstate,
            "nsensordata": _size_of_sensor,
            "init": first_init,
            "reset": _nothing,
            "compute": _nothing,
        }.items():
            setattr(struct, callback, _lasting(_CALLBACKS[callback], function))
        lib.mjp_registerPlugin(ctypes.addressof(struct))

    def _init(self, model: int, data: int, instance: int) -> int:
        """What the compiled `init` does, for a model that comes first and was compiled elsewhere.

        It cannot raise an error of MuJoCo's: the jump out of it would skip what Python has to do.
        """
        message = self._prepare(model, data, instance)
        if message:
            _logger.error("%s", ctypes.string_at(message).decode())
            return -1
        if self._start is not None:
            self._start(model, data, instance)
        return 0

    def _wake(self, plugin: Plugin) -> None:
        """Compiles what MuJoCo is to call, and has it called from now on."""
        if is_aside():
            return
        with self._lock:
            if plugin.name not in self._awake:
                try:
                    self._compile(plugin)
                except Exception as error:
                    _logger.debug("the plugin cannot be used", exc_info=True)
                    known = isinstance(error, GranularError)
                    self._failure = error if known else LayoutError(f"something ({error!r})")
                self._awake.add(plugin.name)

    def _compile(self, plugin: Plugin) -> None:
        from mjgranular.engine import links, native
        from mjgranular.engine.loader import Loader

        if not self._awake:
            links.publish(native.PREPARE, _lasting(_PREPARE, self._prepare))
            links.publish_functions(library(), native.FUNCTIONS)
        self._put(plugin.name, {"init": (native.prepare, native.INIT_TYPES)})
        if self._loader is None:
            self._layout = aside(lambda: find_layout(NAME))
            self._loader = Loader(self._layout)
        made = {NAME: native.sand_callbacks, SENSOR: native.sensor_callbacks}[plugin.name]
        self._put(plugin.name, made(self._layout))

    def _put(self, plugin: str, callbacks: Mapping[str, tuple[Any, tuple[Any, ...]]]) -> None:
        """Compiles functions and has MuJoCo call them."""
        from mjgranular.kernel.compiled import program_of

        registered = PluginStruct.from_address(library().mjp_getPlugin(plugin.encode(), None))
        for name, (function, types) in callbacks.items():
            address = program_of(function, *types).address
            if name == "start":
                self._start = ctypes.CFUNCTYPE(None, _address, _address, _int)(address)
            else:
                setattr(registered, name, address)

    def _load(self, model: int, data: int, instance: int) -> None:
        from mjgranular.engine import native

        self._loader.load(model, data, instance)
        if self._loader.draws and not self._draws:
            self._put(NAME, native.drawing_callbacks(self._layout))
            self._draws = True

    def _prepare(self, model: int, data: int, instance: int) -> int:
        """Loads a block; gives the address of a text that says why not, or 0."""
        try:
            if self._failure is not None:
                raise self._failure
            if self._loader is not None:
                self._load(model, data, instance)
        except BaseException as error:
            if not isinstance(error, GranularError):
                _logger.error("preparing sand failed", exc_info=error)
            reason = str(error) if isinstance(error, GranularError) else repr(error)
            text = f"mjgranular {instance_name(model, instance)!r}: {reason}".encode()
            if len(text) > _LONGEST:
                text = text[: _LONGEST - 3] + b"..."
            text = text.replace(b"%", b"%%")  # MuJoCo takes it as a format
            if self._loader is not None and not _errors_are_caught():
                self._loader.refuse(data, instance, text)
                return 0
            self._told.buffer = ctypes.create_string_buffer(text)  # must outlive this call
            return ctypes.addressof(self._told.buffer)
        return 0


def _errors_are_caught() -> bool:
    """Whether an error of MuJoCo's would come back to Python now, and not end the process.

    One place of the bindings lets it through: where an `MjData` is unpickled.
    """
    lib = library()
    swap = getattr(lib, "_mjPRIVATE_setTlsLogHandler", None)
    if swap is None:
        return True
    swap.restype, swap.argtypes = ctypes.c_void_p, (ctypes.c_void_p,)
    handler = swap(None)
    swap(handler)
    return bool(handler or ctypes.c_void_p.in_dll(lib, "mju_user_error"))


def _nothing(*arguments: Any) -> None:
    pass


def _lasting(types: tuple[Any, ...], function: Callable[..., Any]) -> int:
    """The address of a C function that calls a Python one, as long as the process lives."""
    callback = ctypes.CFUNCTYPE(*types)(function)
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(callback))
    return ctypes.cast(callback, ctypes.c_void_p).value or 0


def _check_struct(lib: ctypes.CDLL) -> None:
    """Has MuJoCo clear a struct, to see how large it is.

    Raises:
        LayoutError: another size.
    """
    room = (ctypes.c_ubyte * 1024)(*([0xFF] * 1024))
    lib.mjp_defaultPlugin(ctypes.addressof(room))
    if bytes(room).find(0xFF) != ctypes.sizeof(PluginStruct):
        raise LayoutError("a struct mjpPlugin of the known size")


def _size_of_sensor(model: int, instance: int, sensor: int) -> int:
    from mjgranular.engine.sensor import size_of

    measure = library().mj_getPluginConfig(model, instance, b"measure")
    return size_of((measure or b"").decode())


def _size_of_state(model: int, instance: int) -> int:
    # What is neither true nor false is an error when the sand is prepared.
    tunable = library().mj_getPluginConfig(model, instance, b"tunable")
    return STATE_SIZE if tunable == b"true" else 0


_PLUGINS = (
    Plugin(NAME, KEYS, _PASSIVE),
    Plugin(SENSOR, SENSOR_KEYS, _SENSOR, _VELOCITY),
)


_refused: list[Exception] = []


def register() -> None:
    """Registers the plugins, once a process; where that cannot be, `check_registered` says why."""
    engine = Engine()
    try:
        for plugin in _PLUGINS:
            if library().mjp_getPlugin(plugin.name.encode(), None) is None:
                engine.register(plugin)
    except (GranularError, ImportError, AttributeError) as error:
        _logger.warning("the engine plugin is not registered: %s", error)
        _refused.append(error)


def check_registered() -> None:
    """Makes sure that MuJoCo knows the plugins.

    Raises:
        LayoutError: this version of MuJoCo cannot be used with them.
        ImportError: MuJoCo's library was not found.
    """
    if _refused:
        raise _refused[0]
