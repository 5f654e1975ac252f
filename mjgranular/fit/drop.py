"""Dropped bodies: depth, and optionally pitch, over time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from mjgranular.errors import InputError, UnknownNameError, shown
from mjgranular.experiment.drop import Drop, load, start_from
from mjgranular.fit.bench import Bench
from mjgranular.fit.body import degrees
from mjgranular.fit.constants import Material
from mjgranular.fit.curve import GRAVITY, check_units, find_arrest, find_touch
from mjgranular.fit.result import RunErrors
from mjgranular.fit.run import Run
from mjgranular.fit.trial import Series, Trial, rms
from mjgranular.sand.chosen import geoms_in_sand
from mjgranular.sand.spec import SandSpec
from mjgranular.scheme import Implicit
from mjgranular.surface import Plane
from mjgranular.surface.floors import WOULD_CARRY, describe_floors, find_floors

_STEPS = 100  # steps of a simulated record, and twice that; chosen by trials, see `simulate`
_STEP_RANGE = (1e-5, 5e-4)  # range of the time step [s]; chosen
_AFTER = 1.5  # rows are used up to this many times the time to rest: later rows add nothing
_BEFORE = 0.1  # and from this part of it before the touch: rows in the air do not depend on sand
_STAYS = 0.03  # parts of its range within which a curve counts as settled; chosen
_LEAST_PITCH = 10.0  # scale of a pitch that hardly changes [degrees]; chosen
_TOUCH = 0.03  # parts of the depth by which the first touch may be off; chosen


@dataclass(frozen=True)
class Fall:
    """A simulated fall, from the touch on.

    Attributes:
        time: [s], shape (n,).
        depth: depth of the lowest point [m], shape (n,).
        pitch: [degrees], shape (n,).
    """

    time: np.ndarray
    depth: np.ndarray
    pitch: np.ndarray


class DropTrial(Trial):
    """A drop of a body of simple shape.

    Raises:
        InputError: times that go back, no contact, or implausible units.
    """

    carries = 3
    axis = "time"

    def __init__(self, run: Run) -> None:
        self.run = run
        measured = run.measured()
        time, depth = measured["time"], measured["depth"]
        where = f"run {shown(run.name)}"
        check_record(time, depth, where)
        speed, size = self._first_speed(), self._size()
        if speed > 0 or run.body is not None:
            check_units(time, depth, speed, size, where)
        self.touch = self._touch(time, depth)
        curves = [np.maximum(depth, 0.0)]
        curves += [measured["pitch"]] if "pitch" in measured else []
        moving = max(settling(time - self.touch, curve) for curve in curves)
        since = time - self.touch
        used = (since <= _AFTER * moving) & (since >= -min(_BEFORE * moving, self._first_rise()))
        self.places = time[used]
        self.series = (Series("depth", depth[used], float(depth.max())),)
        if "pitch" in measured:
            pitch = measured["pitch"]
            self._check_pitch(pitch, where)
            scale = max(_LEAST_PITCH, float(np.ptp(pitch)))
            self.series += (Series("pitch", pitch[used], scale),)
        self.arrest = find_arrest(self.places - self.touch, depth[used])
        self._make_bench(float(self.places[-1] - self.touch))
        if run.touch is None and speed > 0:
            gap = float(np.median(np.diff(time)))
            off = max(_TOUCH * float(depth.max()) / speed, gap)
            self.shift, self.shift_range = self.touch, (self.touch - off, self.touch + off)

    def _first_speed(self) -> float:
        return self.run.speed or 0.0

    def _first_rise(self) -> float:
        """Return the latest time before the touch at which the body was at rest [s]."""
        return self._first_speed() / GRAVITY

    def _size(self) -> float:
        assert self.run.body is not None
        return self.run.body.size

    def _touch(self, time: np.ndarray, depth: np.ndarray) -> float:
        if self.run.touch is not None:
            if not time[0] - (time[-1] - time[0]) <= self.run.touch < time[-1]:
                raise InputError(
                    f"run {shown(self.name)}: the touch at {self.run.touch} s is not within the "
                    f"record, which goes from {time[0]:g} to {time[-1]:g} s"
                )
            return self.run.touch
        return find_touch(time, depth, self._first_speed())

    def _check_pitch(self, pitch: np.ndarray, where: str) -> None:
        angle = degrees(self.run.angle)
        off = abs(pitch[0] - angle)
        if off > 10 and abs(math.degrees(pitch[0]) - angle) < 10:
            raise InputError(
                f"{where}: a pitch of {pitch[0]:.3g} degrees at first, and an angle of {angle:g}: "
                "it looks like radians; name the column 'pitch [rad]'"
            )
        if off > 10:
            raise InputError(
                f"{where}: the pitch begins with {pitch[0]:.3g} degrees, and the angle of the run "
                f"is {angle:g}: both are that of the axis from the vertical"
            )

    def _make_bench(self, duration: float) -> None:
        run = self.run
        assert run.body is not None
        timestep = float(np.clip(duration / _STEPS, *_STEP_RANGE))
        projectile = run.body.projectile
        model = projectile.model(timestep)
        self._duration = duration + timestep
        self._qpos = projectile.touching(run.angle)
        self._qvel = projectile.moving(run.angle, self._first_speed(), 0.0, 0.0)
        self._timestep = timestep
        self.bench = Bench(model, Implicit(), ("link",))

    def simulate(self, material: Material) -> Fall:
        self.bench.use(material)
        assert self.run.body is not None
        late = 0.0 if self.shift is None else self.shift_range[1] - self.shift_range[0]
        # The scheme is of first order: with 300 steps a drag would come out 1.7 % too large. The
        # limit of two step sizes (Richardson) leaves 0.004 %.
        steps = int(np.ceil((self._duration + late) / self._timestep))
        coarse, fine = self._path(steps, 1), self._path(steps, 2)
        path = 2 * fine - coarse
        time = self._timestep * np.arange(len(path))
        depth = self.run.body.reach(path[:, 2]) - path[:, 1]
        return Fall(time, depth, np.degrees(path[:, 2]))

    def _path(self, steps: int, parts: int) -> np.ndarray:
        """Return positions after each of `steps` steps, each divided into `parts`."""
        timestep = self._timestep / parts
        self.bench.model.opt.timestep = timestep
        qvel = self._qvel.copy()
        # MuJoCo's velocities lie half a step before its positions (docs/scheme.md).
        qvel[1] += timestep / 2 * GRAVITY
        return self.bench.move(self._qpos, qvel, steps * parts)[::parts]

    def predicted(self, outcome: Fall, shift: float | None) -> list[np.ndarray]:
        since = self.places - (self.touch if shift is None else shift)
        depth = np.interp(since, outcome.time, outcome.depth)
        above = np.minimum(since, 0.0)
        depth += self._first_speed() * above + GRAVITY / 2 * above**2
        every = {"depth": depth}
        if len(self.series) > 1:
            every["pitch"] = np.interp(since, outcome.time, outcome.pitch)
        return [every[series.name] for series in self.series]

    def errors(self, outcome: Fall, shift: float | None) -> RunErrors:
        found = self.predicted(outcome, shift)
        depth = found[0]
        since = self.places - (self.touch if shift is None else shift)
        here = find_arrest(since, depth)
        stop, measured = here.time, self.arrest.time
        off = [f - s.values for f, s in zip(found, self.series, strict=True)]
        return RunErrors(
            depth=here.depth / self.arrest.depth - 1,
            stopping_time=None if stop is None or measured is None else stop / measured - 1,
            trajectory=rms(off[0]) / self.series[0].scale,
            pitch=rms(off[1]) if len(off) > 1 else None,
            measured_depth=self.arrest.depth,
            predicted_depth=here.depth,
            measured_stopping_time=measured,
            predicted_stopping_time=stop,
        )


class ModelTrial(DropTrial):
    """A body of a custom model: it starts from its keyframe at the first row of the record."""

    def _size(self) -> float:
        return math.inf

    def _touch(self, time: np.ndarray, depth: np.ndarray) -> float:
        return float(time[0])

    def _first_rise(self) -> float:
        return 0.0

    def _make_bench(self, duration: float) -> None:
        run = self.run
        assert run.model is not None
        model, _ = load(Drop(run.model, keyframe=run.keyframe))
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, run.model_body or "")
        if body < 0:
            names = [model.body(k).name for k in range(1, model.nbody)]
            raise UnknownNameError("body of the model", run.model_body, [n for n in names if n])
        floors = find_floors(model, geoms_in_sand(model, SandSpec()), Plane())
        if floors:
            raise InputError(
                f"run {shown(run.name)}: {describe_floors(model, floors, WOULD_CARRY)}: take it "
                "out of the model, the sand is in its place"
            )
        data = mujoco.MjData(model)
        start_from(model, data, run.keyframe)
        self._body = body
        self._duration = duration + model.opt.timestep
        self._qpos, self._qvel = data.qpos.copy(), data.qvel.copy()
        if run.speed:
            joint = model.body_jntadr[model.body_rootid[body]]
            if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
                raise InputError(
                    f"run {shown(run.name)}: a speed is for a model on a free joint; give this one "
                    "a keyframe with its velocities"
                )
            self._qvel[model.jnt_dofadr[joint] + 2] -= run.speed
        self.bench = Bench(model, Implicit())
        self.shift = None

    def simulate(self, material: Material) -> Fall:
        self.bench.use(material)
        depth = self.bench.watch(self._qpos, self._qvel, self._duration, self._body)
        time = self.bench.model.opt.timestep * np.arange(len(depth))
        return Fall(time, depth, np.zeros(len(depth)))

    def predicted(self, outcome: Fall, shift: float | None) -> list[np.ndarray]:
        return [np.interp(self.places - self.touch, outcome.time, outcome.depth)]


def settling(since: np.ndarray, values: np.ndarray) -> float:
    """Return when a curve has settled to its end value but for noise, else its last time.

    Args:
        since: time since the touch [s], shape (n,).
        values: shape (n,).
    """
    width = max(1, len(values) // 20)
    smooth = np.convolve(values, np.ones(width) / width, mode="valid")
    away = np.flatnonzero(np.abs(smooth - smooth[-1]) > _STAYS * np.ptp(smooth))
    last = min(len(since) - 1, int(away[-1]) + width) if len(away) else 0
    return float(since[last])


def check_record(time: np.ndarray, depth: np.ndarray, where: str) -> None:
    """Check that a record has enough rows, increasing times and contact.

    Raises:
        InputError: it does not; says which is missing.
    """
    if len(time) < 4:
        raise InputError(f"{where}: {len(time)} rows are no trajectory: at least 4 are needed")
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        row = int(back[0])
        raise InputError(
            f"{where}: the time goes back or stands still, from {time[row]:g} s to "
            f"{time[row + 1]:g} s in row {row + 2}: times have to grow"
        )
    if depth.max() <= 0:
        raise InputError(
            f"{where}: no contact, the depth is at most {depth.max():.4g} m: depths are positive "
            "below the surface"
        )
