"""`Memory`: resolution, extent and material parameters of a surface's memory; its `Heights`."""

import math
from dataclasses import KW_ONLY, dataclass, replace
from numbers import Real
from typing import Any, Self

import numpy as np

from mjgranular._util.parse import read_options, read_value, split_words
from mjgranular.errors import InputError, shown
from mjgranular.relief.grid import HEADER, node_keys, state_size

REPOSE = math.radians(32)
"""Angle of repose of dry sand [rad]; chosen from a range of 29 to 35 degrees (docs/memory.md)."""

MOST_CELLS = 2000  # maximum along a side; chosen: 100 MB for each simulation
EXTENT = 2.0  # default side of the stored square [m]; chosen

_MULTIPLE = 20  # of cells along a side, so that blocks of several sizes fill it
WINDOW = 5  # maximum number of blocks along a side that a mean reads


@dataclass(frozen=True)
class Memory:
    """Memory of a surface: heights on a grid of square cells, part of the simulation's state.

    Attributes:
        cell: side of a cell [m]; several to the width of a foot.
        extent: side of the stored square [m], rounded up to a multiple of 20 cells. The grid is
            wrapped around: a body that moves farther overwrites what is this far behind. None for 2
            m, or more if the bodies of a model need it.
        surroundings: distance up to which sand counts for the level around a point [m]: the mean is
            that of a square of four times this, rounded up to a divisor of the extent. None for
            four cells and the widest geom's width.
        repose: angle of repose [rad]; steeper slopes flow down.

    Raises:
        InputError: an invalid value, or too many cells.
    """

    cell: float = 0.01
    _: KW_ONLY
    extent: float | None = None
    surroundings: float | None = None
    repose: float = REPOSE

    def __post_init__(self) -> None:
        for name in ("cell", "extent", "surroundings", "repose"):
            value, high = getattr(self, name), math.pi / 2 if name == "repose" else math.inf
            if name in ("extent", "surroundings") and value is None:
                continue
            is_number = isinstance(value, Real) and not isinstance(value, bool)
            if not is_number or not 0.0 < float(value) < high:
                end = "" if math.isinf(high) else f" and below {high:.4g} rad"
                raise InputError(
                    f"the memory's {name} must be a number above 0{end}, not {shown(value)}"
                )
        if not self.side / self.cell <= MOST_CELLS:
            count = self.side / self.cell
            raise InputError(
                f"a memory of {self.side:g} m in cells of {self.cell:g} m has {count:.3g} cells "
                f"along a side, and {8.0 * 3 * count * count:.3g} bytes for each simulation; at "
                f"most {MOST_CELLS} are kept: cells of {self.side / MOST_CELLS:.2g} m would fit"
            )

    @property
    def side(self) -> float:
        """Side of the stored square [m], before it is rounded up."""
        return EXTENT if self.extent is None else self.extent

    def reaching(self, length: float) -> Self:
        """Return this memory; if its extent was not set, with one of at least that length [m]."""
        if self.extent is not None or length <= EXTENT:
            return self
        upward = math.ceil(10 * length - 1e-9) / 10  # to a readable number
        return replace(self, extent=min(upward, MOST_CELLS * self.cell))

    @property
    def size(self) -> int:
        """Number of cells along a side."""
        return _MULTIPLE * max(math.ceil(self.side / (_MULTIPLE * self.cell) - 1e-9), 1)

    @property
    def state_size(self) -> int:
        """Length of the state."""
        return state_size(self.size)

    def blocks(self, surroundings: float) -> int:
        """Return the number of blocks along a side, of at least that width [m].

        Raises:
            InputError: the extent is too small for blocks of that width.
        """
        size = self.size
        # At most a quarter of the cells: the state has memory for these.
        for count in range(size // 4, WINDOW - 1, -1):
            if size % count == 0 and size // count * self.cell >= surroundings * (1 - 1e-9):
                return count
        needed = math.ceil(10 * WINDOW * surroundings - 1e-9) / 10
        raise InputError(
            f"a memory of {size * self.cell:g} m is too small for surroundings of "
            f"{surroundings:.3g} m (the widest geom and four cells): say memory="
            f"'cell={self.cell:g} extent={needed:g}'"
        )


def as_memory(memory: Any) -> Memory | None:
    """Convert an argument to a memory.

    It may be a `Memory`; the side of a cell [m]; True for the defaults; words such as "cell=0.01
    extent=4", "0.01" and "true", as in MJCF and on the command line; None or False for none.
    """
    if memory is None or memory is False:
        return None
    if memory is True or memory == "true":
        return Memory()
    if isinstance(memory, Memory):
        return memory
    if isinstance(memory, Real):
        return Memory(cell=float(memory))
    if isinstance(memory, str):
        words = split_words(memory)
        if words and "=" not in words[0]:
            return Memory(cell=read_value(memory.strip(), float, "memory, the side of a cell,"))
        if not words:
            raise InputError("memory is the side of a cell [m], or 'cell=0.01 extent=4', not ''")
        return Memory(**read_options(words, Memory, "memory"))
    raise InputError(f"memory is a Memory, the side of a cell [m] or True, not {shown(memory)}")


@dataclass(frozen=True)
class Heights:
    """Heights of the sand over its surface, on a square of nodes.

    Attributes:
        x: coordinates of the nodes along the first axis of the surface's plane [m], shape (n,).
        y: coordinates along the second [m], shape (n,). On a level plane both are the world's.
        height: over the surface, along its normal [m], shape (n, n): `height[i, j]` at (x[i],
            y[j]). Zero where nothing has moved the sand, and where that is forgotten.
    """

    x: np.ndarray
    y: np.ndarray
    height: np.ndarray


def checked_state(saved: Any, size: int) -> np.ndarray:
    """Check a stored state of a surface that a user passes back."""
    try:
        state = np.asarray(saved)
    except ValueError:  # rows of several lengths
        state = np.zeros(0)
    if state.shape != (size,) or state.dtype.kind not in "iuf" or not np.isfinite(state).all():
        raise InputError(
            f"what this sand remembers is {size} finite numbers, as `save_memory` gives them, not "
            f"{shown(saved)}: a memory of other cells or extent has others"
        )
    return state


def heights_of(state: np.ndarray, memory: Memory, middle: tuple[float, float]) -> Heights:
    """Return the heights in a relief's state around a point of its plane [m]."""
    size = memory.size
    i, j = square_about(memory, middle)
    places = (i % size)[:, None] * size + j % size
    heights, numbers = state[HEADER:][: 2 * size * size].reshape(2, size * size)
    own = numbers[places] // 4 == node_keys(i[:, None], j)
    return Heights(memory.cell * i, memory.cell * j, np.where(own, heights[places], 0.0))


def square_about(memory: Memory, middle: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of the nodes of the square around a point that may be stored."""
    numbers = np.asarray(middle)
    if numbers.shape != (2,) or numbers.dtype.kind not in "iuf" or not np.isfinite(numbers).all():
        raise InputError(f"the middle is two numbers [m], not {shown(middle)}")
    first = [round(place / memory.cell) - memory.size // 2 for place in middle]
    i, j = (begin + np.arange(memory.size) for begin in first)
    return i, j
