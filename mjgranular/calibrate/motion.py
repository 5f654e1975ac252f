"""One motion, measured or simulated, and its summary."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_STOPPED = 0.01  # in parts of the largest speed: a slower body has stopped; as in `data/seen`
_MEAN = 1e-3  # averaging time of forces before the largest is taken [s]


@dataclass(frozen=True)
class Motion:
    """A measured or simulated motion, one row per sample; arrays of shape (n,). SI units, degrees.

    Attributes:
        depth: depth of the body's lowest point [m], positive below the surface; NaN if unknown.
        time: [s]; None for a push or drag without one.
        speed: downward speed of the center of mass; for a drag, wheel or robot, speed along its
            path [m/s]; None if unknown.
        force: force of the sand against the motion [N]: for a drop, the mean upward force since the
            previous row; for a wheel, along its heading; for a turning leg, along x. None if
            unknown.
        pitch: angle of the body's axis from the vertical [degrees]; None without an axis.
        to_the_stop: whether the record ends where the lowest point stops.
        lift: upward force of the sand [N].
        side: force of the sand against a wheel's motion along its axle [N].
        angle: angle of a leg from straight down, or of a wheel's path from its heading [degrees].
        spin: spin of a wheel, positive if it rolls ahead [rad/s].
        rate: turns of a robot's legs per second [Hz].
    """

    depth: np.ndarray
    time: np.ndarray | None = None
    speed: np.ndarray | None = None
    force: np.ndarray | None = None
    pitch: np.ndarray | None = None
    to_the_stop: bool = False
    lift: np.ndarray | None = None
    side: np.ndarray | None = None
    angle: np.ndarray | None = None
    spin: np.ndarray | None = None
    rate: np.ndarray | None = None

    @property
    def final_depth(self) -> float:
        """Final depth [m]."""
        return float(self.depth[-1])

    @property
    def stop(self) -> float | None:
        """The time from the touch to the stop of the center of mass [s].

        It has stopped when its downward speed is first below 1 % of the largest. Without a column
        of speeds, that of the lowest point is used, from differences. A record `to_the_stop` of the
        lowest point ends there. None if it never touches or stops.
        """
        if self.time is None or self.depth.max() <= 0:
            return None
        speed = np.gradient(self.depth, self.time) if self.speed is None else self.speed
        touch = _touch(self.time, self.depth)
        if touch is not None and self.to_the_stop:
            return float(self.time[-1] - touch)
        k = int(np.argmax(speed))
        slow = np.flatnonzero(speed[k:] < _STOPPED * speed[k])
        if not len(slow) or touch is None:
            return None
        i = k + int(slow[0])
        part = (speed[i - 1] - _STOPPED * speed[k]) / (speed[i - 1] - speed[i])
        return float(self.time[i - 1] + part * (self.time[i] - self.time[i - 1]) - touch)

    @property
    def peak_force(self) -> float | None:
        """The largest mean force over a millisecond [N]; None without forces.

        Rows further apart are averaged over a longer time.
        """
        if self.force is None or self.time is None or len(self.time) < 3:
            return None
        impulse = np.concatenate([[0.0], np.cumsum(self.force[1:] * np.diff(self.time))])
        begin = self.time[self.time <= self.time[-1] - _MEAN]
        gained = np.interp(begin + _MEAN, self.time, impulse) - np.interp(begin, self.time, impulse)
        return float(gained.max() / _MEAN) if len(gained) else None


def _touch(time: np.ndarray, depth: np.ndarray) -> float | None:
    """Return the time at which a body touches the surface."""
    inside = np.flatnonzero(depth >= 0)
    if not len(inside):
        return None
    i = int(inside[0])
    if i == 0:
        return float(time[0])
    part = -depth[i - 1] / (depth[i] - depth[i - 1])
    return float(time[i - 1] + part * (time[i] - time[i - 1]))
