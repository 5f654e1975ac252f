"""Readings of a sand inside `mj_step`, for Python: sensor values in a model without sensors."""

import mujoco
import numpy as np

from mjgranular.engine.block import header_at
from mjgranular.engine.handles import find_block
from mjgranular.engine.instances import instance_of
from mjgranular.engine.measures import MEASURES
from mjgranular.engine.sensor import DEPTH, FORCE, POWER, SPEED, measure_sand
from mjgranular.kernel.compiled import compiled, entry
from mjgranular.kernel.memory import floats

COUNT = 6
"""Numbers per sand: force [N], depth [m], power [W], speed [m/s]."""

assert tuple(MEASURES) == ("force", "moment", "depth", "power", "speed", "touch")


class SandReadings:
    """Read the last step's results of each sand for all bodies together, into one array.

    `values` has `COUNT` numbers for each sand, in the order of `mjgranular.sensor`, shape (1, n);
    `together` has the index of the first number of each.
    """

    def __init__(self, model: mujoco.MjModel, sands: tuple[str, ...]) -> None:
        self._instances = [instance_of(model, name) for name in sands]
        self.together = [COUNT * number for number in range(len(sands))]
        self.values = np.zeros((1, COUNT * len(sands)))
        self._read = entry(_read, "int64(int64, int64, int64)")

    def read(self, data: mujoco.MjData) -> np.ndarray:
        """Read a simulation; zeros before its first step, and after a reset."""
        begin = self.values.ctypes.data
        address = data._address
        for instance, together in zip(self._instances, self.together, strict=True):
            self._read(address, instance, begin + 8 * together)
        return self.values


@compiled
def _read(data, instance, together):
    block = find_block(data, instance)
    if block == 0 or header_at(block).table == 0:
        return 0
    measure_sand(block, FORCE, -1, floats(together, 3))
    measure_sand(block, DEPTH, -1, floats(together + 24, 1))
    measure_sand(block, POWER, -1, floats(together + 32, 1))
    measure_sand(block, SPEED, -1, floats(together + 40, 1))
    return 1
