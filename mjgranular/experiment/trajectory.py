"""The trajectory of a link: samples of its state, and what follows from them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Self

import numpy as np

from mjgranular._util.files import atomic_write
from mjgranular._util.io import read_arrays
from mjgranular.errors import OutputError
from mjgranular.models import Link
from mjgranular.sand.report import BodyReport


@dataclass(frozen=True)
class Trajectory:
    """A run of the link as arrays of shape (n,), one value per sample; depth is positive down.

    Velocities are those of MuJoCo's `qvel`, half a time step before the positions.

    Attributes:
        t: time since release [s].
        x: position of the center of mass C along the surface [m].
        z: height of C above the surface [m].
        q: angle from the vertical [rad].
        vx: velocity of C along x [m/s].
        vz: velocity of C, up [m/s].
        omega: dq/dt [rad/s].
        x_T: position of the lower end T along the surface [m].
        y_T: depth of T [m].
        v_Tx: velocity of T along x [m/s].
        v_Ty: velocity of T, down [m/s].
        x_E: position along the surface of E, where the force on the deepest element acts [m].
        y_E: depth of E [m].
        F_x: force of the sand along x [N].
        F_y: force of the sand, down [N].
        M: moment of the sand about C, in the sense of q [N m].
        length: immersed length [m].
        power: power of the sand on the link [W].
        froude: Froude number |v_E| / sqrt(g d).
        energy: kinetic and potential energy; potential energy is 0 with C at the surface [J].
    """

    t: np.ndarray
    x: np.ndarray
    z: np.ndarray
    q: np.ndarray
    vx: np.ndarray
    vz: np.ndarray
    omega: np.ndarray
    x_T: np.ndarray
    y_T: np.ndarray
    v_Tx: np.ndarray
    v_Ty: np.ndarray
    x_E: np.ndarray
    y_E: np.ndarray
    F_x: np.ndarray
    F_y: np.ndarray
    M: np.ndarray
    length: np.ndarray
    power: np.ndarray
    froude: np.ndarray
    energy: np.ndarray

    def __len__(self) -> int:
        return len(self.t)

    @classmethod
    def from_states(
        cls,
        rows: np.ndarray,
        link: Link,
        gravity: float,
        bodies: Sequence[BodyReport],
        point: tuple[float, float],
    ) -> Self:
        """Compute what follows from samples of the state."""
        derived = np.empty((len(rows), 13))
        for row, body, out in zip(rows, bodies, derived, strict=True):
            kinetic = link.mass * (row[4] ** 2 + row[5] ** 2) + link.inertia * row[6] ** 2
            out[:] = (
                *link.tip(row[1:4], row[4:7], point),
                body.point[0],
                -body.point[2],
                body.force[0],
                -body.force[2],
                -body.moment[1],
                body.immersed_length,
                body.power,
                body.froude,
                kinetic / 2 + link.mass * gravity * row[2],
            )
        return cls(*np.ascontiguousarray(np.hstack([rows, derived]).T))

    def table(self) -> np.ndarray:
        """Return all columns, shape (n, 20)."""
        return np.column_stack([getattr(self, field.name) for field in fields(self)])

    def write_npz(self, path: Path) -> None:
        """Write the samples as arrays by name."""
        with atomic_write(path) as part, part.open("wb") as file:
            np.savez_compressed(file, **vars(self))

    @classmethod
    def read_npz(cls, path: Path) -> Self:
        arrays = read_arrays(path, [field.name for field in fields(cls)])
        t = arrays["t"]
        if t.ndim != 1 or not len(t) or any(a.shape != t.shape for a in arrays.values()):
            raise OutputError(f"{path} is damaged: its columns differ in length")
        return cls(**arrays)


def degrees(angle: float) -> float:
    """Convert radians to degrees, without rounding errors in the last digit."""
    return round(math.degrees(angle), 12)
