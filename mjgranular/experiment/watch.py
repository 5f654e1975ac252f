"""When a point that falls onto sand stops, and when points are at rest."""

from __future__ import annotations

from collections import deque

import numpy as np

# Rest: every point stays within this distance for this long, 1 mm/s. Chosen, not measured; the
# explicit scheme creeps and trembles at a speed that grows with the time step.
REST_WINDOW = 0.02
REST_DISTANCE = 2e-5

STILL = 1e-9
"""Speed below which a point stands still [m/s]. The implicit scheme leaves some 1e-12 of either
sign; chosen."""

# Steps that a line is fitted to where velocities tremble. Chosen by trying: at 1e-6 s, 3 of 120
# drawn conditions still miss 0.1 % of the stopping time (the worst 1.7 %); up to 1024 steps miss as
# many. What is left is the creep of the explicit scheme.
_MOST_AVERAGED = 32


class StopWatch:
    """Touchdown and stop of a point, from its depth and velocity at every step.

    Attributes:
        touchdown: time since the first step at which the point touched the sand [s]; None until
            then.
        time: time from the touchdown until its vertical velocity was first zero [s]; None until
            then.
        depth: its depth then [m].
        part: when this was, in steps after the last but one.
    """

    def __init__(self, timestep: float) -> None:
        self.touchdown: float | None = None
        self.time: float | None = None
        self.depth = self.part = 0.0
        self._timestep = timestep
        self._steps = 0
        self._before: tuple[float, float] | None = None
        self._velocities: deque[float] = deque(maxlen=_MOST_AVERAGED)
        self._sinking = False  # it has moved down since it touched the sand

    def follow(self, depth: float, velocity: float) -> bool:
        """Take depth [m] and downward velocity [m/s] of the next step; return True at the stop."""
        before, self._before = self._before, (depth, velocity)
        step, self._steps = self._steps, self._steps + 1
        self._velocities.append(velocity)
        if before is None:
            # A point that starts on the surface may be rounded to slightly above it.
            self.touchdown = 0.0 if depth > -1e-12 else None
            return False
        if self.touchdown is None and depth >= 0:
            self.touchdown = self._timestep * (step - depth / (depth - before[0]))
        if self.touchdown is None or velocity > STILL:
            return False
        self._sinking = self._sinking or before[1] > STILL
        part = self._crossing() if self._sinking else None
        if part is None:
            return False
        self.time = (step - 1 + part) * self._timestep - self.touchdown
        # Where velocities tremble, the crossing may be some steps earlier: there depth is constant.
        self.depth = before[0] + self._timestep * max(part, 0.0) * before[1] / 2
        self.part = part
        return True

    def _crossing(self) -> float | None:
        """Return when the velocity crosses or reaches zero, in steps after the last but one.

        It is None if the velocity only trembles. Where a link slides on the static force (E keeps
        its height while T still sinks), the explicit sign of that force makes velocities tremble
        from step to step, and a velocity that slowly approaches zero touches it early. Then a
        straight line through the last steps decides.
        """
        last, now = self._velocities[-2], self._velocities[-1]
        if len(self._velocities) >= 8:
            v = np.array(self._velocities)
            slope, value = np.polyfit(np.arange(len(v)) - (len(v) - 2), v, 1)
            if np.median(np.abs(np.diff(v, 2))) > abs(slope):
                return -value / slope if slope < 0 and value + slope <= 0 else None
        return min(last / (last - now), 1.0) if last > max(now, 0.0) else 0.0


class RestWatch:
    """Time since which points are at rest, `since` [s]."""

    def __init__(self) -> None:
        self.since = 0.0
        self._low = np.zeros(0)
        self._high = np.zeros(0)

    def still(self, time: float, points: np.ndarray) -> bool:
        """Return whether the points have stayed where they are for the window of rest."""
        if self._low.size:
            low, high = np.minimum(self._low, points), np.maximum(self._high, points)
            if (high - low).max() <= REST_DISTANCE:
                self._low, self._high = low, high
                return time - self.since >= REST_WINDOW
        self._low = self._high = np.array(points)
        self.since = time
        return False
