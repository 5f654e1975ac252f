"""Layout of MuJoCo's structs, found by inspection.

A plugin gets `mjModel*` and `mjData*`. Their layout is defined by headers that differ between
versions, and no compiler is available here to read them. But Python shows the same memory as
arrays: the word of the struct that holds an array's address is that array's field. A number that
Python does not expose as an array is found by writing distinctive values.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

import mujoco
import numpy as np
from mujoco.introspect.ast_nodes import PointerType
from mujoco.introspect.structs import STRUCTS

from mjgranular.errors import GranularError

TESTED = ("3.17.0", "4.0.0")
"""Versions of MuJoCo that the tests were run with."""

_WORD = 8  # bytes


class LayoutError(GranularError, RuntimeError):
    """The fields of this version of MuJoCo could not be located."""

    def __init__(self, what: str) -> None:
        super().__init__(
            f"the engine plugin cannot be used with MuJoCo {mujoco.__version__}: {what} was not "
            f"found in its memory; tested versions: {', '.join(TESTED)}. "
            "Sand(model).step(data) works without the plugin"
        )


@contextmanager
def laid_out(what: str) -> Iterator[None]:
    """Turn unexpected errors into a `LayoutError` about MuJoCo's memory.

    Args:
        what: what was searched.

    Raises:
        LayoutError: an error occurred that is not one of this package.
    """
    try:
        yield
    except (GranularError, MemoryError, OSError):
        raise
    except Exception as error:
        raise LayoutError(f"{what} ({error!r})") from error


def described_fields(struct: str) -> Sequence[Any]:
    """Return the fields of a struct from MuJoCo's description."""
    return STRUCTS[struct].fields


@dataclass(frozen=True)
class Struct:
    """The memory of one `mjModel` or `mjData`: the struct, and the buffer that holds its arrays."""

    address: int
    pointers: int  # offset of its first pointer to an array, in bytes
    words: np.ndarray  # the pointers
    buffer: range  # addresses

    @classmethod
    def of_model(cls, model: mujoco.MjModel) -> Struct:
        """Return the memory of a model; what precedes the pointers ends with `stat`."""
        return cls._behind(model, model.stat.center, model.qpos0)

    @classmethod
    def of_data(cls, data: mujoco.MjData) -> Struct:
        """Return the memory of a simulation; what precedes the pointers ends with `energy`."""
        return cls._behind(data, data.energy, data.qpos)

    @classmethod
    def _behind(cls, owner: Any, last: np.ndarray, first: np.ndarray) -> Struct:
        """Return the struct whose pointers follow an array in it, the first of them to `first`.

        Raises:
            LayoutError: the pointers do not start there.
        """
        begin = last.ctypes.data + last.nbytes
        fields = described_fields(type(owner).__name__.replace("Mj", "mj"))
        count = sum(isinstance(field.type, PointerType) for field in fields)
        words = np.frombuffer(ctypes.string_at(begin, _WORD * count), np.int64)
        if not count or (first.size and words[0] != first.ctypes.data):
            raise LayoutError("the first pointer to an array")
        start = int(words[0])  # NumPy has no address of an empty array
        return cls(
            owner._address, begin - owner._address, words, range(start, start + owner.nbuffer)
        )

    def encloses(self, address: int) -> bool:
        """Return True if an address is in the struct itself, before its pointers."""
        return self.address <= address < self.address + self.pointers

    def holds(self, address: int) -> bool:
        """Return True if an address is in the struct, before its pointers, or in the buffer."""
        return self.encloses(address) or address in self.buffer

    def pointer(self, address: int, what: str) -> tuple[int, int]:
        """Find the pointer to the array that contains an address.

        Args:
            address: in the buffer.
            what: name of the array, for the message.

        Returns:
            Offset of the pointer [bytes], and that of the address in the array [bytes].

        Raises:
            LayoutError: there is none.
        """
        before = (self.words <= address) & (self.words >= self.buffer.start)
        if address not in self.buffer or not before.any():
            raise LayoutError(what)
        begin = int(self.words[before].max())
        # Empty arrays have the address of the next nonempty one, which is the last of them.
        place = self.pointers + _WORD * int(np.flatnonzero(self.words == begin)[-1])
        return place, address - begin

    def field(self, array: np.ndarray, what: str) -> int:
        """Return the offset of the pointer to an array [bytes].

        Raises:
            LayoutError: there is none.
        """
        offset, inside = self.pointer(array.ctypes.data, what)
        if inside:
            raise LayoutError(what)
        return offset


@dataclass(frozen=True)
class Layout:
    """Offsets in the structs that compiled code needs [bytes].

    Attributes:
        timestep: of `opt.timestep` in mjModel; everything before it is a size.
        integrator: of `opt.integrator` in mjModel.
        plugin: of the pointer `plugin` in mjModel.
        plugin_data: of the pointer `plugin_data` in mjData.
        plugin_state: of the pointer `plugin_state` in mjData.
        plugin_stateadr: of the pointer `plugin_stateadr` in mjModel.
        plugin_statenum: of the pointer `plugin_statenum` in mjModel.
        sensordata: of the pointer `sensordata` in mjData.
        site_xpos: of the pointer `site_xpos` in mjData.
        site_xmat: of the pointer `site_xmat` in mjData.
    """

    timestep: int
    integrator: int
    plugin: int
    plugin_data: int
    plugin_state: int
    plugin_stateadr: int
    plugin_statenum: int
    sensordata: int
    site_xpos: int
    site_xmat: int


@cache
def find_layout(plugin: str) -> Layout:
    """Find the layout in a small model with that plugin.

    Raises:
        LayoutError: a field cannot be identified.
    """
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><extension><plugin plugin="{plugin}"><instance name="probe">'
        '<config key="tunable" value="true"/></instance></plugin></extension>'
        "<worldbody><body><freejoint/><geom size='1'/><site/></body></worldbody>"
        "<sensor><clock/></sensor></mujoco>"
    )
    data = mujoco.MjData(model)
    options = model.opt
    steps = (0.0123456789, 0.0987654321)
    timestep = _planted(model, np.float64, steps, lambda value: _set(options, "timestep", value))
    kinds = [int(kind) for kind in mujoco.mjtIntegrator.__members__.values()]
    integrator = _planted(
        model, np.int32, kinds, lambda value: _set(options, "integrator", value), timestep
    )
    in_model, in_data = Struct.of_model(model), Struct.of_data(data)
    return Layout(
        timestep,
        integrator,
        plugin=in_model.field(model.plugin, "plugin"),
        plugin_data=in_data.field(data.plugin_data, "plugin_data"),
        plugin_state=in_data.field(data.plugin_state, "plugin_state"),
        plugin_stateadr=in_model.field(model.plugin_stateadr, "plugin_stateadr"),
        plugin_statenum=in_model.field(model.plugin_statenum, "plugin_statenum"),
        sensordata=in_data.field(data.sensordata, "sensordata"),
        site_xpos=in_data.field(data.site_xpos, "site_xpos"),
        site_xmat=in_data.field(data.site_xmat, "site_xmat"),
    )


def _set(options: Any, name: str, value: Any) -> None:
    setattr(options, name, value)


def _planted(
    model: mujoco.MjModel,
    kind: Any,
    values: Iterable[Any],
    plant: Callable[[Any], None],
    begin: int = 0,
) -> int:
    """Return the offset in mjModel of the one number that takes the written values.

    Raises:
        LayoutError: there is none, or several.
    """
    size = Struct.of_model(model).pointers - begin
    size -= size % np.dtype(kind).itemsize
    follows = np.ones(size // np.dtype(kind).itemsize, bool)
    for value in values:
        plant(value)
        follows &= np.frombuffer(ctypes.string_at(model._address + begin, size), kind) == value
    (found,) = np.nonzero(follows)
    if len(found) != 1:
        raise LayoutError("an option of the model")
    return begin + int(found[0]) * np.dtype(kind).itemsize
