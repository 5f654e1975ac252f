"""Dropped bodies: depth, and optionally pitch, over time."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjgranular.calibrate.curve import (
    GRAVITY,
    check_record,
    check_units,
    find_arrest,
    find_touch,
    settling,
)
from mjgranular.calibrate.errors import Errors, relative, rms
from mjgranular.calibrate.material import Material
from mjgranular.calibrate.motion import Motion
from mjgranular.calibrate.runs import Run
from mjgranular.calibrate.simulate import lowest_depth
from mjgranular.calibrate.simulator import Simulator
from mjgranular.calibrate.trial import Series, Trial
from mjgranular.errors import InputError, UnknownNameError, shown
from mjgranular.experiment.drop import Drop, load, start_from
from mjgranular.sand.chosen import geoms_in_sand
from mjgranular.sand.spec import SandSpec
from mjgranular.scheme import Implicit
from mjgranular.surface import Plane
from mjgranular.surface.floors import WOULD_CARRY, describe_floors, find_floors

_STEPS = 100  # steps of a simulated record, and twice that; chosen by trials, see `simulate`
_STEP_RANGE = (1e-5, 5e-4)  # range of the time step [s]; chosen
_AFTER = 1.5  # rows are used up to this many times the time to rest: later rows add nothing
_BEFORE = 0.1  # and from this part of it before the touch: rows in the air do not depend on sand
_LEAST_PITCH = 10.0  # scale of a pitch that hardly changes [degrees]; chosen
_TOUCH = 0.03  # parts of the depth by which the first touch may be off; chosen


class DropTrial(Trial):
    """A drop of a body of simple shape.

    Raises:
        InputError: times that go back, no contact, or implausible units.
    """

    carries = 3
    axis = "time"

    def __init__(self, run: Run) -> None:
        self.run = run
        self._where = f"run {shown(run.name)}"
        self._speed = run.speed or 0.0
        measured = run.measured()
        time, depth = measured["time"], measured["depth"]
        check_record(time, depth, self._where)
        if self._speed > 0 or run.body is not None:
            size = math.inf if run.body is None else run.body.size
            check_units(time, depth, self._speed, size, self._where)
        self.touch = self._touch(time, depth)
        since = time - self.touch
        curves = [np.maximum(depth, 0.0)]
        curves += [measured["pitch"]] if "pitch" in measured else []
        moving = max(settling(since, curve) for curve in curves)
        used = (since <= _AFTER * moving) & (since >= -min(_BEFORE * moving, self._longest_fall))
        self.places = time[used]
        self.series = (Series("depth", depth[used], float(depth.max())),)
        if "pitch" in measured:
            pitch = measured["pitch"]
            self._check_pitch(float(pitch[0]))
            scale = max(_LEAST_PITCH, float(np.ptp(pitch)))
            self.series += (Series("pitch", pitch[used], scale),)
        self.arrest = find_arrest(self.places - self.touch, depth[used])
        self._simulator = self._make_simulator(float(self.places[-1] - self.touch))
        if run.touch is None and self._speed > 0:
            self._free_touch(time, depth)

    @property
    def speeds(self) -> tuple[float, ...]:
        return (self._speed,)

    @property
    def _longest_fall(self) -> float:
        """The longest time that the body can have fallen before the touch [s]."""
        return self._speed / GRAVITY

    def _touch(self, time: np.ndarray, depth: np.ndarray) -> float:
        """Return the time of the touch [s], given or found."""
        touch = self.run.touch
        if touch is None:
            return find_touch(time, depth, self._speed)
        if not time[0] - (time[-1] - time[0]) <= touch < time[-1]:
            raise InputError(
                f"{self._where}: the touch at {touch} s is not within the record, which goes from "
                f"{time[0]:g} to {time[-1]:g} s"
            )
        return touch

    def _free_touch(self, time: np.ndarray, depth: np.ndarray) -> None:
        """Have the touch fitted with the constants."""
        gap = float(np.median(np.diff(time)))
        off = max(_TOUCH * float(depth.max()) / self._speed, gap)
        self.shift, self.shift_range = self.touch, (self.touch - off, self.touch + off)

    def _check_pitch(self, first: float) -> None:
        """Check the first pitch [degrees] against the angle of the run."""
        angle = round(math.degrees(self.run.angle), 9)
        if abs(first - angle) <= 10:
            return
        if abs(math.degrees(first) - angle) < 10:
            raise InputError(
                f"{self._where}: the first pitch is {first:.3g} degrees, and the angle {angle:g}: "
                "it looks like radians; name the column 'pitch [rad]'"
            )
        raise InputError(
            f"{self._where}: the first pitch is {first:.3g} degrees, and the angle of the run "
            f"{angle:g}: both are that of the axis from the vertical"
        )

    def _make_simulator(self, duration: float) -> Simulator:
        self._timestep = float(np.clip(duration / _STEPS, *_STEP_RANGE))
        self._duration = duration + self._timestep
        projectile = self.run.body.projectile
        self._qpos = np.array(projectile.touching(self.run.angle), float)
        self._qvel = np.array(projectile.moving(self.run.angle, self._speed, 0.0, 0.0), float)
        return Simulator(projectile.model(self._timestep), Implicit(), ("link",))

    def simulate(self, material: Material) -> Motion:
        self._simulator.use(material)
        late = 0.0 if self.shift is None else self.shift_range[1] - self.shift_range[0]
        # The scheme is of first order: with 300 steps a drag would come out 1.7 % too large. The
        # limit of two step sizes (Richardson) leaves 0.004 %.
        steps = int(np.ceil((self._duration + late) / self._timestep))
        path = 2 * self._path(steps, 2) - self._path(steps, 1)
        time = self._timestep * np.arange(len(path))
        depth = np.array([lowest_depth(self.run.body.projectile, row) for row in path])
        return Motion(depth=depth, time=time, pitch=np.degrees(path[:, 2]))

    def _path(self, steps: int, parts: int) -> np.ndarray:
        """Return positions before and after each of `steps` steps, each divided into `parts`."""
        simulator, timestep = self._simulator, self._timestep / parts
        simulator.model.opt.timestep = timestep
        qvel = self._qvel.copy()
        # MuJoCo's velocities lie half a step before its positions (docs/scheme.md).
        qvel[1] += timestep / 2 * GRAVITY
        simulator.reset(self._qpos, qvel)
        path = simulator.move(steps * parts, lambda: simulator.data.qpos, until_rest=True)
        return np.vstack([self._qpos, path[parts - 1 :: parts]])

    def since(self, shift: float | None) -> np.ndarray:
        return self.places - (self.touch if shift is None else shift)

    def predicted(self, outcome: Motion, shift: float | None) -> list[np.ndarray]:
        since = self.since(shift)
        above = np.minimum(since, 0.0)
        found = [np.interp(since, outcome.time, getattr(outcome, s.name)) for s in self.series]
        found[0] += self._speed * above + GRAVITY / 2 * above**2
        return found

    def errors(self, outcome: Motion, shift: float | None) -> Errors:
        found = self.predicted(outcome, shift)
        off = [f - s.values for f, s in zip(found, self.series, strict=True)]
        measured, predicted = self.arrest, find_arrest(self.since(shift), found[0])
        return Errors(
            depth=predicted.depth / measured.depth - 1,
            stopping_time=relative(measured.time, predicted.time),
            trajectory=rms(off[0]) / self.series[0].scale,
            pitch=rms(off[1]) if len(off) > 1 else None,
            measured_depth=measured.depth,
            predicted_depth=predicted.depth,
            measured_stopping_time=measured.time,
            predicted_stopping_time=predicted.time,
        )


class ModelTrial(DropTrial):
    """A body of a custom model: it starts from its keyframe at the first row of the record."""

    @property
    def _longest_fall(self) -> float:
        return 0.0

    def _touch(self, time: np.ndarray, depth: np.ndarray) -> float:
        return float(time[0])

    def _free_touch(self, time: np.ndarray, depth: np.ndarray) -> None:
        """Keep the touch: the model starts at the first row."""

    def _make_simulator(self, duration: float) -> Simulator:
        run = self.run
        model, _ = load(Drop(run.model, keyframe=run.keyframe))
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, run.model_body or "")
        if body < 0:
            names = [model.body(k).name for k in range(1, model.nbody)]
            raise UnknownNameError("body of the model", run.model_body, [n for n in names if n])
        floors = find_floors(model, geoms_in_sand(model, SandSpec()), Plane())
        if floors:
            raise InputError(
                f"{self._where}: {describe_floors(model, floors, WOULD_CARRY)}: remove it from the "
                "model, the sand is in its place"
            )
        data = mujoco.MjData(model)
        start_from(model, data, run.keyframe)
        self._body, self._steps = body, int(np.ceil(duration / model.opt.timestep)) + 2
        self._qpos, self._qvel = data.qpos.copy(), data.qvel.copy()
        if self._speed:
            joint = model.body_jntadr[model.body_rootid[body]]
            if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
                raise InputError(
                    f"{self._where}: a speed is for a model on a free joint; give this one a "
                    "keyframe with its velocities"
                )
            self._qvel[model.jnt_dofadr[joint] + 2] -= self._speed
        return Simulator(model, Implicit())

    def simulate(self, material: Material) -> Motion:
        simulator = self._simulator
        simulator.use(material)
        rows = np.flatnonzero(simulator.elements["body"] == self._body)
        if not len(rows):
            raise InputError(f"the body {self.run.model_body!r} does not meet the sand")
        simulator.reset(self._qpos, self._qvel)
        depth = simulator.move(self._steps, lambda: simulator.depths[rows].max())
        return Motion(depth=depth, time=simulator.model.opt.timestep * np.arange(len(depth)))

    def predicted(self, outcome: Motion, shift: float | None) -> list[np.ndarray]:
        return [np.interp(self.since(None), outcome.time, outcome.depth)]
