"""One motion, measured or simulated, and errors of one against the other."""

from dataclasses import dataclass

import numpy as np

from mjgranular.errors import InputError

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
            previous row; for a wheel along its heading, for a turning leg along x; None if unknown.
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
        lowest point ends there. None if it never touches or stops, or if differences are noisy.
        """
        if self.time is None or not self.depth.max() > 0:
            return None
        speed = np.gradient(self.depth, self.time) if self.speed is None else self.speed
        i = int(np.argmax(self.depth >= 0))
        rows = slice(max(0, i - 1), i + 1)
        touch = np.interp(0.0, self.depth[rows], self.time[rows])
        if self.to_the_stop:
            return float(self.time[-1] - touch)
        k = int(np.argmax(speed))
        limit = _STOPPED * speed[k]
        slow = k + np.flatnonzero(speed[k:] < limit)
        if not len(slow) or (self.speed is None and speed[slow[0] :].max() > 2 * limit):
            return None
        i = int(slow[0])
        return float(np.interp(limit, speed[[i, i - 1]], self.time[[i, i - 1]]) - touch)

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


@dataclass(frozen=True)
class Errors:
    """Errors of a prediction, relative to the measured value, positive if too large.

    None where the quantity is not measured or does not exist.

    Attributes:
        trajectory: RMS error over all rows, in parts of the largest depth or force; for a drop in
            `compare` over time, in parts of the final depth; for forces in several directions that
            of the vector; for a robot the mean error of its speeds.
        depth: error of the final depth of a drop; the mean error of a wheel's sinkage.
        stopping_time: error of the time from the touch to the stop: of the lowest point in a fit,
            else of the center of mass.
        force: error of the mean force, in `compare` over the last fifth of a push or drag; of
            forces on a leg or wheel, by least squares.
        pitch: RMS error in a fit, else the error of the final pitch [degrees].
        peak: error of the largest force after a 1 ms mean.
        lift: error of lift, by least squares; None if lift is the load.
        speed: mean error of a robot's speeds.
    """

    trajectory: float
    depth: float | None = None
    stopping_time: float | None = None
    force: float | None = None
    pitch: float | None = None
    peak: float | None = None
    lift: float | None = None
    speed: float | None = None

    @property
    def final(self) -> float:
        """Error of what the run is about: speed of a robot, force, or depth of a drop."""
        every = (self.speed, self.force, self.depth)
        return next(error for error in every if error is not None)


def compare(measured: Motion, simulated: Motion) -> Errors:
    """Compute the errors of a simulated motion: at any times for a drop, else row by row.

    Raises:
        InputError: only one is a drop, or a drop has no row in the sand.
    """
    if measured.rate is not None and measured.speed is not None and simulated.speed is not None:
        speeds = simulated.speed / measured.speed - 1
        return Errors(trajectory=float(np.abs(speeds).mean()), speed=float(speeds.mean()))
    if measured.time is None or simulated.time is None:
        return _compare_forces(measured, simulated)
    final = measured.final_depth
    if not final > 0:
        raise InputError("the measured drop ends above the sand: there is no depth to compare with")
    depth = np.interp(measured.time, simulated.time, simulated.depth)
    pitch = None
    if measured.pitch is not None and simulated.pitch is not None:
        last = np.interp(measured.time[-1], simulated.time, simulated.pitch)
        pitch = float(last - measured.pitch[-1])
    # A time average: rows need not be evenly spaced.
    squares = np.trapezoid((depth - measured.depth) ** 2, measured.time)
    return Errors(
        trajectory=float(np.sqrt(squares / (measured.time[-1] - measured.time[0])) / final),
        depth=simulated.final_depth / final - 1,
        stopping_time=relative(measured.stop, simulated.stop),
        peak=relative(measured.peak_force, simulated.peak_force),
        pitch=pitch,
    )


def gain(measured: np.ndarray, simulated: np.ndarray) -> float:
    """Return the least-squares factor from measured to simulated values, minus one."""
    return float((measured * simulated).sum() / (measured * measured).sum()) - 1


def relative(measured: float | None, simulated: float | None) -> float | None:
    """Return the error relative to the measured value; None if one of the two is None."""
    return None if measured is None or simulated is None else simulated / measured - 1


def rms(values: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def _compare_forces(measured: Motion, simulated: Motion) -> Errors:
    if measured.force is None or simulated.force is None:
        raise InputError("a push or drag is compared by its force: one of the two has none")
    if measured.force.shape != simulated.force.shape:
        raise InputError("a push or drag is compared row by row: the two differ in length")
    names = ("force", "side", "lift")
    pairs = [(getattr(measured, name), getattr(simulated, name)) for name in names]
    known = [pair for pair in pairs if pair[0] is not None and pair[1] is not None]
    forces, found = np.array(known).transpose(1, 0, 2)
    error = np.linalg.norm(found - forces, axis=0)
    if measured.angle is None:
        late = max(1, len(measured.force) // 5)
        force = float(simulated.force[-late:].mean() / measured.force[-late:].mean()) - 1
    else:
        force = gain(measured.force, simulated.force)
    sinks = not np.array_equal(measured.depth, simulated.depth, equal_nan=True)
    lift = None
    if measured.lift is not None and simulated.lift is not None and not sinks:
        lift = gain(measured.lift, simulated.lift)
    return Errors(
        trajectory=rms(error) / float(np.linalg.norm(forces, axis=0).max()),
        depth=float((simulated.depth / measured.depth).mean()) - 1 if sinks else None,
        force=force,
        lift=lift,
    )
