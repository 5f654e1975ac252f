"""Samples of a run, and what the sand did: at them, and over every step."""

from collections import deque
from typing import Any

import mujoco
import numpy as np

from mjgranular.kernel import entry
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import CVEL, SUBTREE_COM, XIPOS, floats, row_of, table_at
from mjgranular.kernel.motion import Motion, motion_along, read_motion, velocity_at
from mjgranular.kernel.records import bodies_of, contacts_of
from mjgranular.kernel.vector import dot, norm, read_vector
from mjgranular.sand.sand import Sand

_KEEP = 4096  # samples kept at most of each phase; chosen, not measured


class Recorder:
    """Evenly spaced samples of a run of unknown length.

    When the buffer is full, every other sample is dropped, and from then on every other one is
    taken: between half and all of the buffer is in use, whatever the number of steps.
    """

    def __init__(self, width: int, keep: int = _KEEP) -> None:
        self._rows = np.empty((keep, width))
        self.reports: list[Any] = []
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
        if self._count == len(self._rows):
            half = len(self._rows) // 2
            self._rows[:half] = self._rows[::2]
            self.reports = self.reports[::2]
            self._count = half
            self._stride *= 2
            self._skip = self._stride - 1
        self._rows[self._count] = np.hstack(parts)
        self.reports.append(report)
        self._count += 1

    def rows(self) -> np.ndarray:
        """Return a copy of the samples, shape (n, width)."""
        return self._rows[: self._count].copy()


# Rest: every point stays within this distance for this long, 1 mm/s. Chosen, not measured; the
# explicit scheme creeps and trembles at a speed that grows with the time step.
REST_WINDOW = 0.02
REST_DISTANCE = 2e-5

STILL = 1e-9
"""Speed below which a point stands still [m/s]; chosen: the implicit scheme leaves some 1e-12."""

# Steps that a line is fitted to where velocities tremble. Chosen by trying: at 1e-6 s, 3 of 120
# drawn conditions still miss 0.1 % of the stopping time (the worst 1.7 %); up to 1024 steps miss as
# many. What is left is the creep of the explicit scheme.
_MOST_AVERAGED = 32


class StopWatch:
    """Touchdown and stop of a point, from its depth and velocity at every step."""

    def __init__(self, timestep: float) -> None:
        self.touchdown: float | None = None  # time from the first step to the touch [s]
        self._timestep = timestep
        self._steps = 0
        self._before: tuple[float, float] | None = None
        self._velocities: deque[float] = deque(maxlen=_MOST_AVERAGED)
        self._sinking = False  # it has moved down since it touched the sand

    def follow(self, depth: float, velocity: float) -> tuple[float, float, float] | None:
        """Take depth [m] and downward velocity [m/s] of the next step; None before the stop.

        The stop is where the vertical velocity is first zero. Return the time from the touch to it
        [s], the depth then [m], and when it was, in steps after the last but one.
        """
        before, self._before = self._before, (depth, velocity)
        step, self._steps = self._steps, self._steps + 1
        self._velocities.append(velocity)
        if before is None:
            # A point that starts on the surface may be rounded to slightly above it.
            self.touchdown = 0.0 if depth > -1e-12 else None
            return None
        if self.touchdown is None and depth >= 0:
            self.touchdown = self._timestep * (step - depth / (depth - before[0]))
        if self.touchdown is None or velocity > STILL:
            return None
        self._sinking = self._sinking or before[1] > STILL
        part = self._crossing() if self._sinking else None
        if part is None:
            return None
        time = (step - 1 + part) * self._timestep - self.touchdown
        # Where velocities tremble, the crossing may be some steps earlier: there depth is constant.
        return time, before[0] + self._timestep * max(part, 0.0) * before[1] / 2, part

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


@compiled
def add_work(address, velocity, totals, h):
    """Add the work of the last step's wrenches [J], and return the number of bodies.

    `totals` has a row for each of work, greatest force [N] and greatest depth [m].

    A constant force F turns the velocity v into v' and does the work h F (v + v') / 2, exactly the
    change of kinetic energy, for any step size. `velocity` is the address of `qvel` at the end of
    the step; all else is from its start.
    """
    table = table_at(address)
    bodies, contacts = bodies_of(table), contacts_of(table)
    count, first = len(bodies), 0
    total = floats(totals, 3 * count)
    for slot in range(count):
        body = bodies[slot]
        begin = read_motion(row_of(table[CVEL], body.body, 6), 0)
        end = motion_along(table, body.last_dof, velocity, 1.0)
        both = Motion(begin.angular + end.angular, begin.linear + end.linear)
        com, tree = row_of(table[XIPOS], body.body, 3), row_of(table[SUBTREE_COM], body.root, 3)
        at_com = velocity_at(both, read_vector(com, 0) - read_vector(tree, 0))
        force, moment = read_vector(body.wrench, 0), read_vector(body.wrench, 3)
        power = dot(force, at_com) + dot(moment, both.angular)
        total[slot] += 0.5 * h * power
        total[count + slot] = max(total[count + slot], norm(force))
        for i in range(first, body.end):
            total[2 * count + slot] = max(total[2 * count + slot], contacts[i].depth)
        first = body.end
    return len(bodies)


class WorkMeter:
    """Counts the work of the sand on the bodies of a simulation that `Sand.step` advances.

    Attributes:
        work: work of the sand on each body so far [J], in the order of the bodies' ids.
        force: greatest force on each body, over all steps [N].
        depth: greatest depth of each body at the start of a step [m]; minus infinity at first.
    """

    def __init__(self, sand: Sand, data: mujoco.MjData) -> None:
        self._model, self._data = sand.model, data
        self._table = sand.table_of(data)
        self._add = entry(add_work, "int64(int64, int64, int64, float64)")
        self._totals = np.zeros((3, len(np.unique(sand.elements["body"]))))
        self.work, self.force, self.depth = self._totals
        self.depth[:] = -np.inf

    def add(self) -> None:
        """Add the work of a step. Call this after each `Sand.step`."""
        velocity = self._data.qvel.ctypes.data
        self._add(self._table, velocity, self._totals.ctypes.data, self._model.opt.timestep)
