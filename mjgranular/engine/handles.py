"""Handles: one table of all blocks of the process.

`mjData.plugin_data` holds a *handle* for each instance: the number of a row here. A handle and not
an address, because it cannot be trusted: an `MjData` that is unpickled gets the words of the one
that was pickled, in another process perhaps. A row is taken only if it says that it belongs to this
`mjData`; else the right one is looked for. Rows are written under a lock when simulations are made,
and read without one: a row that names an `mjData` changes only together with it.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np

from mjgranular.engine.layout import Layout
from mjgranular.engine.library import library, memory_at
from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.machine import address_of, publish
from mjgranular.kernel.memory import longs, records

ROW_DTYPE = np.dtype(
    [
        ("data", np.int64),  # mjData*, 0 in a row that is free
        ("instance", np.int64),
        ("block", np.int64),  # address
        ("used", np.int64),  # in row 0, which has no block: rows that were ever used
    ]
)
ROW_COUNT = 1 << 18

_SYMBOL = "mjgranular_rows"

row_records = records(ROW_DTYPE)
rows_address = address_of(_SYMBOL)


@cache
def _table() -> np.ndarray:
    """The table, made once: compiled code that was loaded knows where it is."""
    size = ROW_COUNT * ROW_DTYPE.itemsize
    address = library().mju_malloc(size)
    ctypes.memset(address, 0, size)
    publish(_SYMBOL, address)
    rows = memory_at(address, size).view(ROW_DTYPE)
    rows["used"][0] = 1
    return rows


class HandleTable:
    """The table, as Python writes it, and the blocks that its rows are of.

    An `mjData` is freed on any thread, with or without Python's lock, so its rows are only marked
    then: what they held goes when the next one is made. Nothing is freed when Python ends, since
    simulations may outlive it.
    """

    def __init__(self, layout: Layout) -> None:
        self._plugin_data = layout.plugin_data
        self._rows = _table()
        self._held: dict[int, tuple[Any, ...]] = {}
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._held))

    def clear(self, data: int, instance: int) -> None:
        """Takes the block of an instance away, if there is one.

        It was left behind where MuJoCo has freed an `mjData` without a word, and made a new one
        there.
        """
        self._set_handle(data, instance, 0)
        self._mark(self._of(data, instance))

    def vacate(self, data: int) -> None:
        """Takes all blocks of an `mjData` away."""
        self._mark(self._of(data))

    def put(self, data: int, instance: int, block: np.ndarray, *shared: Any) -> None:
        """Gives an instance in an `mjData`, which has none, its block.

        Args:
            data: address of the `mjData`.
            instance: of the plugin.
            block: its words.
            shared: what is to live as long as the block.
        """
        number = self._free()
        self._held[number] = (block, *shared)
        row = self._rows[number : number + 1]
        row["block"], row["instance"] = block.ctypes.data, instance
        row["data"] = data
        self._set_handle(data, instance, number)

    def __len__(self) -> int:
        """The number of blocks."""
        self._purge()
        return len(self._held)

    def _purge(self) -> None:
        numbers = np.fromiter(self._held, np.int64, len(self._held))
        for number in numbers[self._rows["data"][numbers] == 0].tolist():
            del self._held[number]

    def _set_handle(self, data: int, instance: int, number: int) -> None:
        handles = ctypes.c_int64.from_address(data + self._plugin_data).value
        ctypes.c_int64.from_address(handles + 8 * instance).value = number

    def _of(self, data: int, instance: int | None = None) -> list[int]:
        """The rows of an `mjData`."""
        rows = self._rows[: int(self._rows["used"][0])]
        found = rows["data"] == data
        if instance is not None:
            found &= rows["instance"] == instance
        return np.flatnonzero(found).tolist()

    def _mark(self, numbers: list[int]) -> None:
        self._rows["block"][numbers] = 0
        self._rows["data"][numbers] = 0

    def _free(self) -> int:
        """Finds a row that is free."""
        self._purge()
        used = int(self._rows["used"][0])
        free = np.flatnonzero(self._rows["data"][1:used] == 0)
        if len(free):
            return 1 + int(free[0])
        if used == ROW_COUNT:
            raise InputError(f"no more than {ROW_COUNT - 1} simulations can have sand at a time")
        self._rows["used"][0] = used + 1
        return used


@cache
def row_finder(layout: Layout) -> Any:
    """A compiled function `find_row(data, instance)`: the number of a row, 0 for none."""
    plugin_data = layout.plugin_data

    @compiled
    def find_row(data, instance):
        rows = row_records(rows_address(), ROW_COUNT)
        handles = longs(longs(data + plugin_data, 1)[0], instance + 1)
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

    return find_row


@cache
def block_finder(layout: Layout) -> Any:
    """A compiled function `find_block(data, instance)`: the address of a block, 0 for none."""
    find_row = row_finder(layout)

    @compiled
    def find_block(data, instance):
        return row_records(rows_address(), ROW_COUNT)[find_row(data, instance)].block

    return find_block
