"""Samples of a run, and what the sand did at them."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjgranular.render import TrackRecorder, Tracks
from mjgranular.sand import Sand

_KEEP = 4096  # samples kept at most of each phase; chosen, not measured


class Recorder:
    """Evenly spaced samples of a run of unknown length.

    When the buffer is full, every other sample is dropped, and from then on every other one is
    taken: between half and all of the buffer is in use, whatever the number of steps.
    """

    def __init__(self, width: int, keep: int = _KEEP) -> None:
        self._rows = np.empty((keep, width))
        self._reports: list[Any] = []
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

    def take(self, *parts: np.ndarray | float, report: Any = None) -> None:
        """Take a sample of numbers, with a report."""
        if self._count == len(self._rows):
            half = len(self._rows) // 2
            self._rows[:half] = self._rows[::2]
            self._reports = self._reports[::2]
            self._count = half
            self._stride *= 2
            self._skip = self._stride - 1
        self._rows[self._count] = np.hstack(parts)
        self._reports.append(report)
        self._count += 1

    def rows(self) -> np.ndarray:
        """Return a copy of the samples, shape (n, width)."""
        return self._rows[: self._count].copy()

    @property
    def reports(self) -> list[Any]:
        """Return the reports of the samples."""
        return list(self._reports)


class Sampler:
    """Samples of the state of a run, of what the sand does then, and its tracks if it remembers.

    That follows from more than positions and velocities: from controls and memory too.
    """

    def __init__(self, sand: Sand, data: mujoco.MjData, duration: float) -> None:
        self._sand, self._data = sand, data
        self._tracks = None if sand.memory is None else TrackRecorder(sand, data, duration)
        self.look(0.0)

    def take(self, t: float, recorder: Recorder) -> None:
        """Take a sample at a time [s]: time, `qpos` and `qvel`."""
        report = self._sand.report(self._data).bodies
        recorder.take(t, self._data.qpos, self._data.qvel, report=report)

    def look(self, t: float, *, last: bool = False) -> None:
        """Record the tracks at a time [s], if it is due; call this in every step."""
        if self._tracks is not None:
            self._tracks.look(t, last=last)

    def tracks(self) -> Tracks | None:
        """Return the tracks; None for sand without memory."""
        return None if self._tracks is None else self._tracks.prints()
