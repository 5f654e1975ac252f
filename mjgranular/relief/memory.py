"""`Memory`: how finely, how far and as what kind of sand a surface remembers."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mjgranular.errors import InputError, shown

REPOSE = math.radians(32)
"""Angle of repose of dry sand [rad]. Chosen within the published range of 29 to 35 degrees."""


@dataclass(frozen=True, kw_only=True)
class Memory:
    """Memory of a surface: heights on a grid of square cells, part of the simulation's state.

    Attributes:
        cell: side of a cell [m]; several to the width of a foot.
        extent: side of the square that is remembered [m]. The grid is wrapped around: who walks
            farther writes over what lies this far behind.
        surroundings: side of the blocks over which the mean level is taken [m].
        repose: angle of repose [rad]; steeper slopes flow down.
        bulking: volume that sand takes when it is moved, in parts of what it took before.

    Raises:
        InputError: a value without meaning, or more cells than there is room for.
    """

    cell: float = 0.01
    extent: float = 2.0
    surroundings: float = 0.1
    repose: float = REPOSE
    bulking: float = 1.0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("cell", 0.0, math.inf),
            ("extent", 0.0, math.inf),
            ("repose", 0.0, math.pi / 2),
            ("bulking", 0.0, math.inf),
        ):
            value = getattr(self, name)
            if not isinstance(value, (int, float)) or not low < value < high:
                raise InputError(
                    f"Memory: {name} must be a number above {low:g}"
                    f"{'' if math.isinf(high) else f' and below {high:.3g}'}, not {shown(value)}"
                )
        if self.size > MOST_CELLS:
            raise InputError(
                f"Memory: {self.extent:g} m in cells of {self.cell:g} m are {self.size} x "
                f"{self.size} cells, {8e-6 * 6 * self.size**2:.0f} MB for each simulation; at most "
                f"{MOST_CELLS} x {MOST_CELLS}: cells of {self.extent / MOST_CELLS:.2g} m would fit"
            )

    @property
    def size(self) -> int:
        """Number of cells along a side."""
        return self.blocks * self._width

    @property
    def blocks(self) -> int:
        """Number of blocks along a side, over which means are taken; at least 4."""
        return max(math.ceil(self.extent / (self._width * self.cell)), 4)

    @property
    def _width(self) -> int:
        return max(round(self.surroundings / self.cell), 1)


MOST_CELLS = 2048
"""Chosen: 200 MB for each simulation."""
