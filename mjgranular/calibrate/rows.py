"""Runs of prescribed motion, wheels and robots: forces, sinkages or speeds row by row."""

from __future__ import annotations

import numpy as np

from mjgranular.calibrate.errors import Errors, rms
from mjgranular.calibrate.material import Material
from mjgranular.calibrate.motion import Motion
from mjgranular.calibrate.runs import MeasuredRun, Run
from mjgranular.calibrate.simulate import place, simulator_of
from mjgranular.calibrate.trial import Series, Trial
from mjgranular.errors import InputError, shown

_POINTS = 41  # points at which the force of a smooth path is computed; linear in between
_UNITS = (("mm", 1e-3), ("cm", 1e-2))
_DEEPEST = 20.0  # depth of a push, at most, in largest extents of the body; chosen, wide


class PushTrial(Trial):
    """A body pushed straight down, or dragged along: force against depth or speed.

    Raises:
        InputError: no contact, or implausible units.
    """

    def __init__(self, run: Run) -> None:
        assert run.body is not None
        self.run = run
        self.axis = "speed" if run.kind == "drag" else "depth"
        where = f"run {shown(run.name)}"
        measured = run.measured()
        self.places, force = measured[self.axis], measured["force"]
        if run.kind == "drag":
            assert run.depth is not None
            _check_depth(run.depth, run, where)
            if not (self.places > 0).all():
                least = self.places.min()
                raise InputError(f"{where}: speeds of a drag must be positive, got {least:g} m/s")
        else:
            deepest = self.places.max()
            _check_depth(deepest, run, where)
            if not deepest > 0:
                raise InputError(f"{where}: no contact, the depth is at most {deepest:.4g} m")
            inside = self.places > 0
            self.places, force = self.places[inside], force[inside]
        if len(force) < 2:
            raise InputError(f"{where}: a {run.kind} needs at least 2 rows in the sand, got 1")
        if force.mean() <= 0:
            raise InputError(
                f"{where}: the mean force must be positive, that of the sand against the motion, "
                f"got {force.mean():.3g} N"
            )
        self.series = (Series("force", force, float(np.abs(force).max())),)
        self._simulated = self._run_at(self._points())
        self._simulator = simulator_of(self._simulated, "place")

    def _points(self) -> np.ndarray:
        """Return the places at which the force is computed."""
        if self.axis == "speed" or len(self.places) <= _POINTS:
            return np.unique(self.places)
        return np.linspace(self.places.min(), self.places.max(), _POINTS)

    def _run_at(self, places: np.ndarray) -> MeasuredRun:
        """Return the run with rows at these places; its forces are not used."""
        run, none = self.run, np.zeros(len(places))
        assert run.body is not None
        if self.axis == "speed":
            motion = Motion(depth=none + run.depth, speed=places, force=none)
        else:
            motion = Motion(depth=places, force=none)
        angle = float(np.degrees(run.angle))
        return MeasuredRun(
            run.name, run.kind, run.body.projectile, motion, speed=run.push_speed, angle=angle
        )

    @property
    def speeds(self) -> tuple[float, ...]:
        if self.axis == "depth":
            return (self.run.push_speed,)
        return float(self.places.min()), float(self.places.max())

    def simulate(self, material: Material) -> np.ndarray:
        self._simulator.use(material)
        motion = place(self._simulated, self._simulator)
        at = motion.speed if self.axis == "speed" else motion.depth
        return np.interp(self.places, at, motion.force)

    def predicted(self, outcome: np.ndarray, shift: float | None) -> list[np.ndarray]:
        return [outcome]

    def errors(self, outcome: np.ndarray, shift: float | None) -> Errors:
        series = self.series[0]
        return Errors(
            trajectory=rms(outcome - series.values) / series.scale,
            force=float(outcome.mean() / series.values.mean() - 1),
        )


def _check_depth(depth: float, run: Run, where: str) -> None:
    """Check that a depth is plausible in meters; guess the unit if not."""
    assert run.body is not None
    size = run.body.size
    if depth <= _DEEPEST * size:
        return
    what = f"{where}: a depth of {depth:.4g} m for a body of {size:.3g} m"
    for unit, factor in _UNITS:
        if depth * factor <= _DEEPEST * size:
            raise InputError(f"{what} looks like {unit}: name the column 'depth [{unit}]'")
    raise InputError(f"{what} is not plausible: check the units")
