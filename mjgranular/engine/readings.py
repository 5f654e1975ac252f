"""Readings of a sand inside `mj_step`, for Python: what sensors measure, in a model without any."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import mujoco
import numpy as np

from mjgranular.engine.block import HEADER_DTYPE
from mjgranular.engine.handles import block_finder
from mjgranular.engine.instances import NAME, instance_of
from mjgranular.engine.layout import find_layout
from mjgranular.engine.measures import MEASURES
from mjgranular.engine.sensor import DEPTH, FORCE, MOMENT, POWER, SPEED, measure_sand
from mjgranular.kernel.compiled import compiled, entry
from mjgranular.kernel.memory import BODY_COUNT, floats, records, table_at

ALL = 6
"""Numbers of all bodies together: force [N], depth [m], power [W], speed [m/s]."""

_header = records(HEADER_DTYPE)
assert tuple(MEASURES) == ("force", "moment", "depth", "power", "speed", "touch")


class SandReadings:
    """Reads what the last step of each sand has left behind, into one array.

    The numbers lie as the sensors of `mjgranular.sensor` lay them: for each sand `ALL` of them, and
    behind those, sand by sand and body by body, force and moment.

    Args:
        model: with sand in it.
        sands: names of the instances, which act on the same bodies.
        bodies: of how many bodies the force and the moment are wanted.

    Attributes:
        values: the array, shape (1, n).
        together: where the numbers of all bodies begin, for each sand.
        each: where the forces and moments begin, for each sand.
    """

    def __init__(self, model: mujoco.MjModel, sands: tuple[str, ...], bodies: int = 0) -> None:
        count = len(sands)
        self._instances = [instance_of(model, name) for name in sands]
        self.together = [ALL * number for number in range(count)]
        self.each = [ALL * count + 6 * bodies * number for number in range(count)]
        self.values = np.zeros((1, (ALL + 6 * bodies) * count))
        self._bodies = bodies
        self._read = _reader()

    def read(self, data: mujoco.MjData) -> np.ndarray:
        """Reads a simulation; zeros before its first step."""
        begin = self.values.ctypes.data
        address = data._address
        for instance, together, each in zip(self._instances, self.together, self.each, strict=True):
            self._read(address, instance, begin + 8 * together, begin + 8 * each, self._bodies)
        return self.values


@cache
def _reader() -> Callable[..., int]:
    """The compiled function that reads one sand."""
    find_block = block_finder(find_layout(NAME))

    @compiled
    def read(data, instance, together, each, bodies):
        block = find_block(data, instance)
        if block == 0 or _header(block, 1)[0].table == 0:
            return 0
        measure_sand(block, FORCE, -1, floats(together, 3))
        measure_sand(block, DEPTH, -1, floats(together + 24, 1))
        measure_sand(block, POWER, -1, floats(together + 32, 1))
        measure_sand(block, SPEED, -1, floats(together + 40, 1))
        for slot in range(min(bodies, table_at(_header(block, 1)[0].table)[BODY_COUNT])):
            measure_sand(block, FORCE, slot, floats(each + 48 * slot, 3))
            measure_sand(block, MOMENT, slot, floats(each + 48 * slot + 24, 3))
        return 1

    return entry(read, "int64(int64, int64, int64, int64, int64)")
