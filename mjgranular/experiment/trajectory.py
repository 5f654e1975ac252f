"""Trajectories: samples of the state of a run, and what follows from them."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import mujoco
import numpy as np

from mjgranular._util.files import atomic_write
from mjgranular._util.io import read_arrays
from mjgranular.errors import OutputError
from mjgranular.models import Link
from mjgranular.prints import Prints
from mjgranular.sand import Sand
from mjgranular.sand.report import BodyReport

_KEEP = 4096  # samples kept at most of each phase; chosen, not measured


class Recorder:
    """Keeps evenly spaced samples of a run whose length is not known beforehand.

    When the buffer is full every other sample is dropped and from then on every other one is
    taken: between half and all of the buffer is in use, whatever the number of steps.

    Args:
        width: numbers in a sample.
        keep: samples kept at most; even.
    """

    def __init__(self, width: int, keep: int = _KEEP) -> None:
        self._rows = np.empty((keep, width))
        self._count = 0
        self._stride = 1
        self._skip = 0

    def due(self) -> bool:
        """Return whether to take a sample in this step; call it once a step."""
        if self._skip:
            self._skip -= 1
            return False
        self._skip = self._stride - 1
        return True

    def take(self, *parts: np.ndarray | float) -> None:
        """Takes a sample."""
        if self._count == len(self._rows):
            half = len(self._rows) // 2
            self._rows[:half] = self._rows[::2]
            self._count = half
            self._stride *= 2
            self._skip = self._stride - 1
        self._rows[self._count] = np.hstack(parts)
        self._count += 1

    def rows(self) -> np.ndarray:
        """The samples, shape (n, width)."""
        return self._rows[: self._count].copy()


@dataclass(frozen=True)
class Trajectory:
    """A run of the link, one row a sample. Arrays of shape (n,); depth is positive down.

    Velocities are those of MuJoCo's `qvel`, half a time step before the positions.

    Attributes:
        t: time since release [s].
        x: of the mass centre C, along the surface [m].
        z: of C, up from the surface [m].
        q: angle from the vertical [rad].
        vx: velocity of C along x [m/s].
        vz: velocity of C, up [m/s].
        omega: dq/dt [rad/s].
        x_T: of the lower end T, along the surface [m].
        y_T: depth of T [m].
        v_Tx: velocity of T along x [m/s].
        v_Ty: velocity of T, down [m/s].
        x_E: of E, where the sand's force acts on the deepest element [m].
        y_E: depth of E [m].
        F_x: force of the sand along x [N].
        F_y: force of the sand, down [N].
        M: moment of the sand about C, in the sense of q [N m].
        length: immersed length [m].
        power: of the sand on the link [W].
        froude: Froude number |v_E| / sqrt(g d).
        energy: kinetic energy, and potential above C at the surface [J].
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
        sand: Sand,
        point: tuple[float, float] | None = None,
        felt: Mapping[float, BodyReport] | None = None,
    ) -> Trajectory:
        """Works out what follows from samples of the state.

        Args:
            rows: time, `qpos` and `qvel`, shape (n, 7).
            link: the link.
            sand: the sand on its model.
            point: T in the body's frame; None for the link's lower pole.
            felt: reports at the times of the samples, for sand that was another then.
        """
        data = mujoco.MjData(sand.model)
        gravity = float(np.linalg.norm(sand.model.opt.gravity))
        derived = np.empty((len(rows), 13))
        for row, out in zip(rows, derived, strict=True):
            data.time = row[0]
            data.qpos[:] = row[1:4]
            data.qvel[:] = row[4:7]
            body = felt[row[0]] if felt else sand.report(data)["link"]
            kinetic = link.mass * (row[4] ** 2 + row[5] ** 2) + link.inertia * row[6] ** 2
            out[:] = (
                *link.tip(data.qpos, data.qvel, point),
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
        """All columns, shape (n, 20)."""
        return np.column_stack([getattr(self, field.name) for field in fields(self)])

    def write_csv(self, path: Path) -> None:
        """Writes the samples with a line of names that carry their units."""
        with atomic_write(path) as part, part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([f"{f.name} [{UNITS[f.name]}]" for f in fields(self)])
            writer.writerows([[repr(float(v)) for v in row] for row in self.table()])

    def write_npz(self, path: Path, prints: Prints | None = None) -> None:
        """Writes the samples as arrays by name, and prints beside them."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self)}
        arrays |= {} if prints is None else prints.arrays()
        with atomic_write(path) as part, part.open("wb") as file:
            np.savez_compressed(file, **arrays)

    @classmethod
    def read_npz(cls, path: Path) -> Trajectory:
        """Reads what `write_npz` wrote.

        Raises:
            OutputError: the file is missing, or it holds no trajectory.
        """
        arrays = read_arrays(path, [field.name for field in fields(cls)])
        t = arrays["t"]
        if t.ndim != 1 or not len(t) or any(a.shape != t.shape for a in arrays.values()):
            raise OutputError(f"{path} is damaged: a trajectory has as many samples in each column")
        if (np.diff(t) <= 0).any():
            raise OutputError(f"{path} is damaged: the times of a trajectory grow")
        return cls(**arrays)


UNITS = {
    **dict.fromkeys(("x", "z", "x_T", "y_T", "x_E", "y_E", "length"), "m"),
    **dict.fromkeys(("vx", "vz", "v_Tx", "v_Ty"), "m/s"),
    **dict.fromkeys(("F_x", "F_y"), "N"),
    "t": "s",
    "q": "rad",
    "omega": "rad/s",
    "M": "N m",
    "power": "W",
    "froude": "-",
    "energy": "J",
}
"""Unit of each column of `Trajectory`."""


def degrees(angle: float) -> float:
    """Degrees of an angle in radians, free of the last digit's noise."""
    return round(math.degrees(angle), 12)
