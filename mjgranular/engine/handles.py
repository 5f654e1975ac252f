"""Handles: one table of all blocks of the process.

`mjData.plugin_data` holds a *handle* for each instance: the index of a row here. It is a handle and
not an address, because it cannot be trusted: an `MjData` that is unpickled gets the words of the
one that was pickled, perhaps in another process. A row is used only if it belongs to this `mjData`;
else the right one is searched. Rows are written under a lock when simulations are made, and read
without one: a row that names an `mjData` changes only together with it.
"""

import ctypes
from functools import cache
from typing import Any

import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import library, offset_of
from mjgranular.kernel.intrinsics import address_of, publish
from mjgranular.kernel.memory import field, longs, records

ROW_DTYPE = np.dtype(
    [
        ("data", np.int64),  # mjData*, 0 in a free row
        ("instance", np.int64),
        ("block", np.int64),  # address
        ("used", np.int64),  # in row 0, which has no block: number of rows ever used
    ]
)
ROW_COUNT = 1 << 18

_SYMBOL = "mjgranular_rows"

row_records = records(ROW_DTYPE)
rows_address = address_of(_SYMBOL)
_handles = field("mjData", "plugin_data")


@cache
def _table() -> np.ndarray:
    """Return the table, made once: loaded machine code holds its address."""
    size = ROW_COUNT * ROW_DTYPE.itemsize
    address = library().mju_malloc(size)
    ctypes.memset(address, 0, size)
    publish(_SYMBOL, address)
    rows = np.ctypeslib.as_array((ctypes.c_ubyte * size).from_address(address)).view(ROW_DTYPE)
    rows["used"][0] = 1
    return rows


class HandleTable:
    """The table, as Python writes it, and the blocks of its rows.

    An `mjData` may be freed on any thread, with or without Python's lock, so its rows are only
    flagged then; their blocks are freed when the next one is made, never at Python's end.
    """

    def __init__(self) -> None:
        self._plugin_data = offset_of("mjData", "plugin_data")
        self._rows = _table()
        self._held: dict[int, tuple[Any, ...]] = {}
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._held))

    def clear(self, data: int, instance: int) -> None:
        """Remove the block of an instance, if there is one.

        It remains if MuJoCo frees an `mjData` without a callback, and makes another in its place.
        """
        self._set_handle(data, instance, 0)
        self.release(data, instance)

    def release(self, data: int, instance: int | None = None) -> None:
        """Remove the block of an instance in an `mjData`, or all its blocks."""
        rows = self._rows[: int(self._rows["used"][0])]
        found = rows["data"] == data
        if instance is not None:
            found &= rows["instance"] == instance
        rows["block"][found] = 0
        rows["data"][found] = 0

    def put(self, data: int, instance: int, block: np.ndarray, *shared: Any) -> None:
        """Assign a block to an instance in an `mjData` that has none."""
        number = self._find_free()
        self._held[number] = (block, *shared)
        row = self._rows[number : number + 1]
        row["block"], row["instance"] = block.ctypes.data, instance
        row["data"] = data
        self._set_handle(data, instance, number)

    def __len__(self) -> int:
        self._purge()
        return len(self._held)

    def _purge(self) -> None:
        numbers = np.fromiter(self._held, np.int64, len(self._held))
        for number in numbers[self._rows["data"][numbers] == 0].tolist():
            del self._held[number]

    def _set_handle(self, data: int, instance: int, number: int) -> None:
        handles = ctypes.c_int64.from_address(data + self._plugin_data).value
        ctypes.c_int64.from_address(handles + 8 * instance).value = number

    def _find_free(self) -> int:
        self._purge()
        used = int(self._rows["used"][0])
        free = np.flatnonzero(self._rows["data"][1:used] == 0)
        if len(free):
            return 1 + int(free[0])
        if used == ROW_COUNT:
            raise InputError(f"no more than {ROW_COUNT - 1} simulations can have sand at a time")
        self._rows["used"][0] = used + 1
        return used


@compiled
def find_row(data, instance):
    """Return the index of the row of an instance in an `mjData`; 0 if there is none."""
    rows = row_records(rows_address(), ROW_COUNT)
    handles = longs(_handles(data), instance + 1)
    handle = handles[instance]
    if handle == 0:
        return 0
    if 0 < handle < ROW_COUNT:
        row = rows[handle]
        if row.data == data and row.instance == instance:
            return handle
    for i in range(1, rows[0].used):
        row = rows[i]
        if row.data == data and row.instance == instance:
            handles[instance] = i
            return i
    return 0


@compiled
def find_block(data, instance):
    """Return the address of the block of an instance in an `mjData`; 0 if there is none."""
    return row_records(rows_address(), ROW_COUNT)[find_row(data, instance)].block
