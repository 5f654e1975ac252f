"""Errors of a simulated motion against a measured one, over the whole motion."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from mjgranular.errors import InputError
from mjgranular.referee.motion import Motion


@dataclass(frozen=True)
class Errors:
    """Errors of a simulated motion, relative to the measured value, positive if too large.

    Attributes:
        trajectory: for a drop, the RMS error of depth over time, in parts of the final depth; for a
            robot, the mean error of its speeds; else the RMS error of force, a vector if lift was
            measured, in parts of the largest force.
        final: error of the final depth of a drop; of the mean force in the last fifth of a push or
            drag; of forces on a leg or wheel, by least squares; the mean error of a robot's speeds.
        stop: error of the stopping time; None if one of the two does not stop, and for a push or
            drag.
        peak: error of the largest force after a 1 ms mean; None if no force was measured.
        pitch: error of the final pitch [degrees]; None for bodies without one.
        lift: error of lift, by least squares; None if it was not measured or is the load.
        depth: mean error of a wheel's sinkage; None if the sinkage is given.
    """

    trajectory: float
    final: float
    stop: float | None = None
    peak: float | None = None
    pitch: float | None = None
    lift: float | None = None
    depth: float | None = None

    def plain(self) -> dict[str, float | None]:
        """Return the errors by name, as for JSON."""
        return asdict(self)


def compare(measured: Motion, simulated: Motion) -> Errors:
    """Compute the errors.

    Args:
        measured: the reference motion.
        simulated: the same motion with a law; at any times for a drop, else row by row.

    Raises:
        InputError: only one is a drop, or a drop has no row in the sand.
    """
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
        final=simulated.final_depth / final - 1,
        stop=_part(measured.stop, simulated.stop),
        peak=_part(measured.peak_force, simulated.peak_force),
        pitch=pitch,
    )


def gain(measured: np.ndarray, simulated: np.ndarray) -> float:
    """Return the least-squares factor from measured to simulated values, minus one."""
    return float((measured * simulated).sum() / (measured * measured).sum()) - 1


def _compare_forces(measured: Motion, simulated: Motion) -> Errors:
    if measured.rate is not None:
        assert measured.speed is not None
        assert simulated.speed is not None
        parts = simulated.speed / measured.speed - 1
        return Errors(trajectory=float(np.abs(parts).mean()), final=float(parts.mean()))
    if measured.force is None or simulated.force is None:
        raise InputError("a push or drag is compared by its force: one of the two has none")
    if measured.force.shape != simulated.force.shape:
        raise InputError("a push or drag is compared row by row: the two differ in length")
    pairs = [
        (one, other)
        for one, other in (
            (measured.force, simulated.force),
            (measured.side, simulated.side),
            (measured.lift, simulated.lift),
        )
        if one is not None and other is not None
    ]
    forces, found = np.array(pairs).transpose(1, 0, 2)
    error = np.linalg.norm(found - forces, axis=0)
    if measured.angle is None:
        late = max(1, len(measured.force) // 5)
        final = float(simulated.force[-late:].mean() / measured.force[-late:].mean()) - 1
    else:
        final = gain(measured.force, simulated.force)
    free = not np.array_equal(measured.depth, simulated.depth, equal_nan=True)
    lift = None
    if measured.lift is not None and simulated.lift is not None and not free:
        lift = gain(measured.lift, simulated.lift)
    return Errors(
        trajectory=float(np.sqrt((error**2).mean()) / np.linalg.norm(forces, axis=0).max()),
        final=final,
        lift=lift,
        depth=float((simulated.depth / measured.depth).mean()) - 1 if free else None,
    )


def _part(measured: float | None, simulated: float | None) -> float | None:
    return None if measured is None or simulated is None else simulated / measured - 1
