"""What every surface offers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np


class Surface(ABC):
    """Where the sand is. A final surface is a frozen dataclass.

    Attributes:
        probe: kernel `probe(record, x, y, z) -> (depth, nx, ny, nz)`: depth of a point below the
            surface along its normal [m], negative above the sand, and the unit normal out of the
            sand; world frame.
    """

    probe: ClassVar[Any]

    @abstractmethod
    def record(self) -> np.ndarray:
        """The surface as its `probe` reads it: structured, shape (1,)."""
