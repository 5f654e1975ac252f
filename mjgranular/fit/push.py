"""Bodies with prescribed motion: force against depth, and against speed."""

from __future__ import annotations

import numpy as np

from mjgranular.errors import InputError, shown
from mjgranular.fit.bench import Bench
from mjgranular.fit.constants import Material
from mjgranular.fit.result import RunErrors
from mjgranular.fit.run import Run
from mjgranular.fit.trial import Series, Trial, rms
from mjgranular.scheme import Explicit

_POINTS = 41  # points at which the force of a smooth path is computed; linear in between
_UNITS = (("mm", 1e-3), ("cm", 1e-2))
_DEEPEST = 20.0  # depth of a push, at most, in largest extents of the body; chosen, wide


class PushTrial(Trial):
    """A body pushed straight down: force against depth.

    Raises:
        InputError: no contact, or implausible units.
    """

    axis = "depth"

    def __init__(self, run: Run) -> None:
        self.run = run
        measured = run.measured()
        where = f"run {shown(run.name)}"
        depth, force = measured["depth"], measured["force"]
        if not (depth > 0).any():
            raise InputError(f"{where}: no contact, the depth is at most {depth.max():.4g} m")
        _check_depth(float(depth.max()), run, where)
        inside = depth > 0
        if inside.sum() < 2:
            raise InputError(f"{where}: one row in the sand: at least 2 are needed")
        self.places = depth[inside]
        self.series = (_forces(force[inside], where),)
        self._make_bench()

    @property
    def speeds(self) -> tuple[float, ...]:
        return (self.run.push_speed,)

    def _make_bench(self) -> None:
        assert self.run.body is not None
        projectile = self.run.body.projectile
        self.bench = Bench(projectile.model(1e-4), Explicit(prescribed=True), ("link",))
        self._qpos = projectile.touching(self.run.angle)

    def _force(self, depth: float, velocity: tuple[float, float]) -> np.ndarray:
        qpos = self._qpos.copy()
        qpos[1] -= depth
        return self.bench.force(qpos, np.array([*velocity, 0.0]))

    def simulate(self, material: Material) -> np.ndarray:
        self.bench.use(material)
        if len(self.places) <= _POINTS:
            at = self.places
        else:
            at = np.linspace(self.places.min(), self.places.max(), _POINTS)
        down = (0.0, -self.run.push_speed)
        force = np.array([self._force(depth, down)[2] for depth in at])
        order = np.argsort(at)
        return np.interp(self.places, at[order], force[order])

    def predicted(self, outcome: np.ndarray, shift: float | None) -> list[np.ndarray]:
        return [outcome]

    def errors(self, outcome: np.ndarray, shift: float | None) -> RunErrors:
        series = self.series[0]
        off = outcome - series.values
        return RunErrors(
            trajectory=rms(off) / series.scale,
            force=float(outcome.mean() / series.values.mean() - 1),
        )


class DragTrial(PushTrial):
    """A body dragged at constant depth: force against speed."""

    axis = "speed"

    def __init__(self, run: Run) -> None:
        self.run = run
        measured = run.measured()
        where = f"run {shown(run.name)}"
        speed, force = measured["speed"], measured["force"]
        if not (speed > 0).all():
            raise InputError(f"{where}: the speed of a drag is positive, not {speed.min():g} m/s")
        if len(speed) < 2:
            raise InputError(f"{where}: one row: a drag needs at least 2 speeds")
        assert run.depth is not None
        _check_depth(run.depth, run, where)
        self.places = speed
        self.series = (_forces(force, where),)
        self._make_bench()

    @property
    def speeds(self) -> tuple[float, ...]:
        return float(self.places.min()), float(self.places.max())

    def simulate(self, material: Material) -> np.ndarray:
        self.bench.use(material)
        assert self.run.depth is not None
        at = np.unique(self.places)
        force = [-self._force(self.run.depth, (speed, 0.0))[0] for speed in at]
        return np.interp(self.places, at, force)


def _forces(force: np.ndarray, where: str) -> Series:
    if force.mean() <= 0:
        raise InputError(
            f"{where}: the force is {force.mean():.3g} N on average: it is that of the sand "
            "against the motion, and positive"
        )
    return Series("force", force, float(np.abs(force).max()))


def _check_depth(depth: float, run: Run, where: str) -> None:
    assert run.body is not None
    size = run.body.size
    if depth <= _DEEPEST * size:
        return
    for unit, factor in _UNITS:
        if depth * factor <= _DEEPEST * size:
            raise InputError(
                f"{where}: a depth of {depth:.4g} m for a body of {size:.3g} m looks like {unit}: "
                f"name the column 'depth [{unit}]'"
            )
    raise InputError(f"{where}: a depth of {depth:.4g} m for a body of {size:.3g} m cannot be")
