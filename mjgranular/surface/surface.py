"""The interface of surfaces."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import mujoco
import numpy as np

from mjgranular.errors import InputError


class Surface(ABC):
    """Surface of the sand. A final surface is a frozen dataclass.

    Attributes:
        probe: kernel `probe(record, point) -> (depth, normal)`, of vectors (`kernel.vector`): depth
            of a point below the surface along its normal [m], negative above the sand, and the unit
            normal out of the sand; world frame.
        is_plane: whether it is an infinite plane, and its `probe` only arithmetic (`kernel.lanes`):
            then laws with many elements skip dry ones at a fraction of the cost.
    """

    probe: ClassVar[Any]
    is_plane: ClassVar[bool] = False

    def probe_kernel(self) -> Any:
        """Return the kernel that computes elements' depths; `probe` unless overridden."""
        return type(self).probe

    def toward_kernel(self) -> Any:
        """Return a kernel `toward(record, point, outward)`: `probe` for a face with that normal.

        None if depth does not depend on the normal.
        """
        return None

    def ceiling_kernel(self) -> Any:
        """Return a kernel like `probe`, of a plane that is above all of the sand; None for none."""
        return type(self).probe if type(self).is_plane else None

    @abstractmethod
    def record(self, model: mujoco.MjModel) -> np.ndarray:
        """Return the surface in a model as its `probe` reads it: structured, shape (1,).

        Raises:
            UnknownNameError: the model has no geom of that name; lists those it has.
            InputError: the geom cannot be that kind of surface.
        """

    def geoms(self, model: mujoco.MjModel) -> tuple[int, ...]:
        """Return ids of the geoms that are the sand and so do not meet it."""
        return ()

    def shape(self, model: mujoco.MjModel) -> tuple[np.ndarray, ...]:
        """Return integers of the model, int32, that set array lengths in `record`.

        An `MjData` may be run on another model: they must be the same there.

        Returns:
            Views of arrays of the model, shape (1,) each.
        """
        return ()

    def lift(self, model: mujoco.MjModel) -> Mapping[str, np.ndarray]:
        """Return the changes of the record per meter that the surface rises along its normal.

        Returns:
            For each field that changes its change [1/m], in the shape of the field.
        """
        raise InputError(f"a surface of the kind {type(self).__name__} cannot be moved")

    @property
    def state_size(self) -> int:
        """Length of the surface's own state in a simulation."""
        return 0

    @abstractmethod
    def tilt(self, model: mujoco.MjModel) -> float:
        """Return the steepest angle of the surface from the horizontal, across gravity [rad]."""
