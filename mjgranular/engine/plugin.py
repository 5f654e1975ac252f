"""The plugins, `mjgranular.sand` and `mjgranular.sensor`: registered on import, compiled when used.

MuJoCo copies the struct of function pointers at registration, and reads its copy at each call.
Registered are a few machine instructions (`trampolines`), including the entry into Python; the
first model with sand adds compiled functions. Without one, the import costs almost nothing.
"""

import ctypes
import logging
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import mujoco

from mjgranular.engine import config, trampolines
from mjgranular.engine.instances import config_texts, instance_name
from mjgranular.engine.tuning import STATE_SIZE
from mjgranular.errors import GranularError
from mjgranular.kernel.compiled import program_address
from mjgranular.kernel.engine import LayoutError, check_layout, library
from mjgranular.kernel.threads import ENGINE, is_main, is_preparing, prepare_in_worker
from mjgranular.relief.memory import as_memory

_logger = logging.getLogger(__name__)

_ACTUATOR, _SENSOR, _PASSIVE = 1 << 0, 1 << 1, 1 << 2  # of mjtPluginCapabilityBit
_ACCELERATION = int(mujoco.mjtStage.mjSTAGE_ACC)  # what controls change
_LONGEST = 440  # bytes of a message: MuJoCo cuts at 500, including its own words

_CALLBACKS = (
    "nstate", "nsensordata", "init", "destroy", "copy", "reset", "compute", "advance", "visualize",
)  # fmt: skip

_FAILED = ctypes.create_string_buffer(
    b"mjgranular: preparing sand failed, and so did reporting the reason"
)


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


def _count_nothing(model: int, data: int, instance: int, place: int) -> None:
    """Write no number: MuJoCo reads 0."""


@dataclass(frozen=True)
class Plugin:
    """Description of a plugin for MuJoCo, without its functions."""

    name: str
    keys: tuple[str, ...]
    capability: int
    stage: int = 0
    count_state: trampolines.Asked = _count_nothing
    count_values: trampolines.Asked = _count_nothing


class Engine:
    """State that the plugins share; nothing is compiled until the first model needs one of them."""

    def __init__(self) -> None:
        self._active: set[str] = set()
        self._failure: Exception | None = None
        self._loader: Any = None
        self._message = threading.local()

    def register(self, plugin: Plugin) -> None:
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
        counts = {"nstate": plugin.count_state, "nsensordata": plugin.count_values}
        made = trampolines.make_trampolines(plugin.name, partial(self._init, plugin), counts)
        for callback, address in made.items():
            setattr(struct, callback, address)
        lib.mjp_registerPlugin(ctypes.addressof(struct))

    def _init(self, plugin: Plugin, model: int, data: int, instance: int, place: int) -> None:
        """Prepare the sand of an instance in a new `mjData`; write the result.

        Only interrupts are raised from here, and then there is no result.
        """
        answer = trampolines.Answer.from_address(place)
        try:
            if is_preparing():
                self._loader.clear_slot(data, instance)
            else:
                if plugin.name not in self._active:
                    prepare_in_worker(lambda: self._activate(plugin))
                self._loader.load(model, data, instance)
            answer[0] = trampolines.FINE
        except Exception as error:
            self._refuse(error, model, data, instance, answer)
        except BaseException as error:
            if not is_main():
                self._refuse(error, model, data, instance, answer)
                return
            answer[0] = trampolines.INTERRUPT
            trampolines.raise_later(error)

    def _refuse(
        self, error: BaseException, model: int, data: int, instance: int, answer: ctypes.Array[Any]
    ) -> None:
        """Have MuJoCo raise an error: now, or at the first step if it would end the process now."""
        now = _errors_are_caught()
        answer[1] = ctypes.addressof(_FAILED)  # in case the steps below fail too
        answer[0] = trampolines.ERROR if now else trampolines.FINE
        try:
            if not isinstance(error, GranularError):
                _logger.error("preparing sand failed", exc_info=error)
            reason = str(error) if isinstance(error, GranularError) else repr(error)
            text = f"mjgranular {instance_name(model, instance)!r}: {reason}"
            if now:
                # It must outlive this call.
                self._message.text = ctypes.create_string_buffer(_cut(text))
                answer[1] = ctypes.addressof(self._message.text)
                if self._loader is not None:
                    self._loader.release(data)
            elif self._loader is not None:
                self._loader.refuse(model, data, instance, _cut(text))
            else:
                _logger.error("%s", text)
        except Exception:
            _logger.debug("reporting the error failed", exc_info=True)

    def _activate(self, plugin: Plugin) -> None:
        """Compile the functions that MuJoCo calls, and activate them."""
        with ENGINE:
            if self._failure is None and plugin.name not in self._active:
                try:
                    self._compile(plugin)
                except (MemoryError, OSError):  # may succeed another time
                    raise
                except Exception as error:
                    _logger.debug("the plugin cannot be used", exc_info=True)
                    self._failure = error
            if self._failure is not None:
                raise self._failure
            self._active.add(plugin.name)

    def _compile(self, plugin: Plugin) -> None:
        for struct in ("mjModel", "mjData", "mjOption"):
            check_layout(struct)
        from mjgranular.engine import callbacks
        from mjgranular.engine.loader import Loader

        if self._loader is None:
            self._loader = Loader(partial(self._put, config.NAME, callbacks.DRAWING))
        self._put(plugin.name, callbacks.SAND if plugin.name == config.NAME else callbacks.SENSOR)

    def _put(self, plugin: str, callbacks: Mapping[str, tuple[Any, str]]) -> None:
        """Compile functions and have MuJoCo call them."""
        registered = PluginStruct.from_address(library().mjp_getPlugin(plugin.encode(), None))
        addresses = {
            name: program_address(function, signature)
            for name, (function, signature) in callbacks.items()
        }
        for name, address in addresses.items():
            setattr(registered, name, address)


def _cut(text: str) -> bytes:
    """Encode a message for MuJoCo, cut between characters so that it can be decoded."""
    encoded = text.replace("\0", "\\0").encode(errors="backslashreplace")
    if len(encoded) <= _LONGEST:
        return encoded
    return encoded[: _LONGEST - 3].decode(errors="ignore").encode() + b"..."


def _errors_are_caught() -> bool:
    """Return True if an error of MuJoCo would reach Python now, and not end the process.

    It would end the process at one place of the bindings: where an `MjData` is unpickled.
    """
    lib = library()
    swap = getattr(lib, "_mjPRIVATE_setTlsLogHandler", None)
    if swap is None:
        return True
    swap.restype, swap.argtypes = ctypes.c_void_p, (ctypes.c_void_p,)
    handler = swap(None)
    swap(handler)
    return bool(handler or ctypes.c_void_p.in_dll(lib, "mju_user_error"))


def _check_struct(lib: ctypes.CDLL) -> None:
    """Have MuJoCo clear a struct, to measure its size."""
    memory = (ctypes.c_ubyte * 1024)(*([0xFF] * 1024))
    lib.mjp_defaultPlugin(ctypes.addressof(memory))
    if bytes(memory).find(0xFF) != ctypes.sizeof(PluginStruct):
        raise LayoutError.of("mjpPlugin")


def _count_state(model: int, data: int, instance: int, place: int) -> None:
    """Write the number of values of an instance of sand in MuJoCo's state.

    It is 0 for a configuration that cannot be parsed; preparing the sand reports the error.
    """
    try:
        parsed = config.read_config(config_texts(model, instance, config.STATE_KEYS))
        memory = as_memory(parsed.sand.memory)
        size = (STATE_SIZE if parsed.tunable else 0) + (memory.state_size if memory else 0)
    except GranularError:
        size = 0
    ctypes.c_int64.from_address(place).value = size


def _count_values(model: int, data: int, instance: int, place: int) -> None:
    """Write the number of values of an instance of the sensor; preparing it reports errors."""
    measure = config_texts(model, instance, config.SENSOR_KEYS)["measure"]
    ctypes.c_int64.from_address(place).value = config.MEASURES.get(measure, 1)


_PLUGINS = (
    Plugin(
        config.NAME,
        config.KEYS,
        _PASSIVE | _ACTUATOR | _SENSOR,  # it measures nothing, but is called after MuJoCo's sensors
        _ACCELERATION,
        count_state=_count_state,
    ),
    Plugin(config.SENSOR, config.SENSOR_KEYS, _SENSOR, _ACCELERATION, count_values=_count_values),
)

_engine = Engine()
_refused: list[Exception] = []


def register() -> None:
    """Register the plugins, once per process; `check_registered` raises if that has failed."""
    try:
        for plugin in _PLUGINS:
            if library().mjp_getPlugin(plugin.name.encode(), None) is None:
                _engine.register(plugin)
    except (GranularError, ImportError, AttributeError) as error:
        _logger.warning("the engine plugin is not registered: %s", error)
        _refused.append(error)


def check_registered() -> None:
    """Check that the plugins are registered."""
    if _refused:
        raise _refused[0]
