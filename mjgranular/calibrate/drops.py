"""Dropped bodies as the fit sees them: depth, and optionally pitch, over time."""

import math
from typing import NamedTuple

import mujoco
import numpy as np

from mjgranular.calibrate.material import Material
from mjgranular.calibrate.motion import Errors, Motion, relative, rms
from mjgranular.calibrate.runs import GRAVITY, Run
from mjgranular.calibrate.simulate import Simulator, lowest_depth
from mjgranular.calibrate.trial import Series, Trial
from mjgranular.errors import InputError
from mjgranular.experiment.drop import Drop, load, start_from
from mjgranular.models import Projectile
from mjgranular.sand.prepare import geoms_in_sand
from mjgranular.sand.spec import SandSpec
from mjgranular.scheme import Implicit
from mjgranular.shape.select import find_all
from mjgranular.surface import Plane
from mjgranular.surface.floors import WOULD_CARRY, describe_floors, find_floors

_BEGINNING = 0.1  # part of the depth within which a fall is nearly uniform; chosen
_NEAR_STOP = 0.75  # part of the depth beyond which a stop is searched; chosen
_END = 0.1  # part of the rows over which the final depth is averaged; chosen
_SLOWEST, _FASTEST = 0.02, 1.5  # mean speed on the way down over that of a free fall; chosen
_TIMES = 200  # number of stopping times tried
_VAGUE = 0.5  # part of a stopping time within which the rows must tell it; chosen
_STAYS = 0.03  # parts of its range within which a curve counts as settled; chosen

_STEPS = 100  # steps of a simulated record, and twice that; chosen by trials, see `simulate`
_STEP_RANGE = (1e-5, 5e-4)  # range of the time step [s]; chosen
_AFTER = 1.5  # rows are used up to this many times the time to rest: later rows add nothing
_BEFORE = 0.1  # and from this part of it before the touch: rows in the air do not depend on sand
_LEAST_PITCH = 10.0  # scale of a pitch that hardly changes [degrees]; chosen
_STILL = 1e-6  # largest velocity at which a body counts as at rest [m/s], [rad/s]; chosen
_CHECK_EVERY = 8  # steps between two checks for rest
_TOUCH = 0.03  # parts of the depth by which the first touch may be off; chosen


class Arrest(NamedTuple):
    """Final depth [m], and the time at which the lowest point stops, after the touch [s]."""

    depth: float
    time: float | None = None


def find_touch(time: np.ndarray, depth: np.ndarray, speed: float) -> float:
    """Return the time at which the lowest point touches the sand, from the rows around it [s].

    Above the sand the body falls freely; in the first tenth of its path it decelerates evenly.
    """
    greatest = depth.max()
    beyond = np.flatnonzero(depth > 3 * _BEGINNING * greatest)[0]
    early = np.flatnonzero(depth[: beyond + 1] < _BEGINNING * greatest)
    if speed == 0:
        return float(time[0])
    rows = early if len(early) else np.array([0])
    t, d = time[rows], depth[rows]
    square = speed**2 + 2 * GRAVITY * np.minimum(d, 0.0)
    falling = square > (0.5 * speed) ** 2  # before that the body was held, but for noise
    if not falling.any():
        falling = np.ones(len(d), bool)
    above = (np.sqrt(np.maximum(square, 0.0)) - speed) / GRAVITY
    below = d / speed * (1 + d / (4 * greatest))
    since = np.where(d > 0, below, above)
    return float(np.median((t - since)[falling]))


def find_arrest(since: np.ndarray, depth: np.ndarray) -> Arrest:
    """Find where a fall ends, in the same way for measurements with noise and for computed curves.

    With constant deceleration at the end, `d = D - a (T - t)^2 / 2` before the body stops: D, a and
    T are fitted to the last quarter of the path. If the body rolls over afterwards, only the part
    before it rises again counts. There is no time if noise or few rows leave it open.
    """
    count = max(1, round(_END * len(depth)))
    final = float(depth[-count:].mean())
    width = max(1, len(depth) // 25)
    smooth = np.convolve(depth, np.ones(width) / width, mode="valid")
    middle = since[width // 2 : width // 2 + len(smooth)]
    top = smooth.max()
    first = int(np.argmax(smooth > _NEAR_STOP * top))
    low = np.flatnonzero(smooth[int(np.argmax(smooth)) :] < 0.97 * top)
    end = middle[min(len(middle) - 1, int(np.argmax(smooth)) + int(low[0]))] if len(low) else None
    rows = (since >= middle[first]) & (since <= (since[-1] if end is None else end))
    t, d = since[rows], depth[rows]
    if len(t) < 5:
        return Arrest(final)
    stops, errors = np.linspace(t[0], t[-1], _TIMES)[1:], []
    for stop in stops:
        basis = np.column_stack([np.ones(len(t)), np.maximum(stop - t, 0.0) ** 2])
        solution, *_ = np.linalg.lstsq(basis, d, rcond=None)
        errors.append(float(((basis @ solution - d) ** 2).sum()))
    at, least = float(stops[np.argmin(errors)]), min(errors)
    alike = stops[np.array(errors) <= least * (1 + 4 / (len(t) - 3))]  # within two deviations
    last = t[-1] - 1.5 * (t[-1] - t[0]) / _TIMES
    return Arrest(final, None if at >= last or np.ptp(alike) > _VAGUE * at else at)


def check_units(run: Run, time: np.ndarray) -> None:
    """Check that depths and times are plausible in meters and seconds."""
    depth, speed = run.motion.depth, run.speed
    size = run.body.reach if isinstance(run.body, Projectile) else math.inf
    greatest = float(depth.max())
    near = np.flatnonzero(depth >= 0.9 * greatest)[0]
    begin = np.flatnonzero(depth[: near + 1] <= _BEGINNING * greatest)
    took = float(time[near] - time[begin[-1] if len(begin) else 0])
    took = max(took, float(np.diff(time).min()))
    of_free_fall = 0.9 * greatest / (speed * took + GRAVITY * took**2 / 2)
    if not _SLOWEST <= of_free_fall <= _FASTEST or greatest > 50 * size:
        raise run.error(
            f"{greatest:.4g} m deep after {took:.3g} s at {speed:g} m/s is implausible: "
            "name units, such as 'depth [mm]' and 'time [ms]', and check the speed"
        )


def settling(since: np.ndarray, values: np.ndarray) -> float:
    """Return when a curve has settled to its end value but for noise, else its last time."""
    width = max(1, len(values) // 20)
    smooth = np.convolve(values, np.ones(width) / width, mode="valid")
    away = np.flatnonzero(np.abs(smooth - smooth[-1]) > _STAYS * np.ptp(smooth))
    last = min(len(since) - 1, int(away[-1]) + width) if len(away) else 0
    return float(since[last])


class DropTrial(Trial):
    """A drop of a body of simple shape."""

    carries = 3
    axis = "time"

    def __init__(self, run: Run) -> None:
        self.run = run
        self._speed = run.speed
        self.speeds = (self._speed,)
        time, depth, pitch = run.motion.time, run.motion.depth, run.motion.pitch
        assert time is not None
        time = time - time[0]  # a solver's tolerance is relative to the touch: no time since 1970
        if len(time) < 4:
            raise run.error(f"a trajectory needs at least 4 rows, got {len(time)}")
        if depth.max() <= 0:
            raise run.error(
                f"no contact: depths, positive downward, are at most {depth.max():.4g} m"
            )
        falls = run.kind == "drop"  # a model starts at its first row
        if falls and depth[-1] < min(depth[0], 0.0):
            raise run.error(
                f"the body ends {-depth[-1]:.4g} m above the sand: depths are positive downward"
            )
        if self._speed > 0 or falls:
            check_units(run, time)
        self.touch = find_touch(time, depth, self._speed) if falls else 0.0
        since = time - self.touch
        curves = [np.maximum(depth, 0.0), *([] if pitch is None else [pitch])]
        moving = max(settling(since, curve) for curve in curves)
        before = min(_BEFORE * moving, self._speed / GRAVITY) if falls else 0.0
        used = (since <= _AFTER * moving) & (since >= -before)
        self.places = time[used]
        self.series = (Series("depth", depth[used], float(depth.max())),)
        if pitch is not None:
            angle = round(math.degrees(run.angle), 9)
            if abs(pitch[0] - angle) > 10:
                raise run.error(
                    f"the angle is {angle:g} and the first pitch {pitch[0]:.3g} degrees: both are "
                    "that of the axis from the vertical; a column in radians is 'pitch [rad]'"
                )
            scale = max(_LEAST_PITCH, float(np.ptp(pitch)))
            self.series += (Series("pitch", pitch[used], scale),)
        self.arrest = find_arrest(self.places - self.touch, depth[used])
        self._simulator = self._make_simulator(float(self.places[-1] - self.touch))
        if falls and self._speed > 0:  # it is fitted with the constants
            off = max(_TOUCH * float(depth.max()) / self._speed, float(np.median(np.diff(time))))
            self.shift, self.shift_range = self.touch, (self.touch - off, self.touch + off)

    def _make_simulator(self, duration: float) -> Simulator:
        self._timestep = float(np.clip(duration / _STEPS, *_STEP_RANGE))
        self._duration = duration + self._timestep
        body, angle = self.run.body, self.run.angle
        self._qpos, self._qvel = body.touching(angle), body.moving(angle, self._speed, 0.0, 0.0)
        return Simulator(body.model(self._timestep), Implicit())

    def simulate(self, material: Material) -> Motion:
        self._simulator.use(material)
        late = 0.0 if self.shift is None else self.shift_range[1] - self.shift_range[0]
        # The scheme is of first order: with 300 steps a drag would come out 1.7 % too large. The
        # limit of two step sizes (Richardson) leaves 0.004 %.
        steps = int(np.ceil((self._duration + late) / self._timestep))
        path = 2 * self._path(steps, 2) - self._path(steps, 1)
        time = self._timestep * np.arange(len(path))
        depth = np.array([lowest_depth(self.run.body, row) for row in path])
        return Motion(depth=depth, time=time, pitch=np.degrees(path[:, 2]))

    def _path(self, steps: int, parts: int) -> np.ndarray:
        """Return positions before and after each of `steps` steps, each divided into `parts`."""
        simulator, timestep = self._simulator, self._timestep / parts
        simulator.model.opt.timestep = timestep
        qvel = self._qvel.copy()
        # MuJoCo's velocities lie half a step before its positions (docs/scheme.md).
        qvel[1] += timestep / 2 * GRAVITY
        simulator.reset(self._qpos, qvel)
        path = np.empty((1 + steps * parts, len(self._qpos)))
        path[0] = self._qpos
        for step in range(1, len(path)):
            simulator.step()
            path[step] = simulator.data.qpos
            if step % _CHECK_EVERY == 0 and np.abs(simulator.data.qvel).max() < _STILL:
                path[step:] = path[step]
                break
        return path[::parts]

    def since(self, shift: float | None) -> np.ndarray:
        return self.places - (self.touch if shift is None else shift)

    def predicted(self, outcome: Motion, shift: float | None) -> list[np.ndarray]:
        since = self.since(shift)
        above = np.minimum(since, 0.0)
        assert outcome.time is not None
        found = [np.interp(since, outcome.time, getattr(outcome, s.name)) for s in self.series]
        found[0] += self._speed * above + GRAVITY / 2 * above**2
        return found

    def errors(self, predicted: list[np.ndarray], shift: float | None) -> Errors:
        arrest = find_arrest(self.since(shift), predicted[0])
        off = [rms(p - s.values) for p, s in zip(predicted, self.series, strict=True)]
        return Errors(
            depth=arrest.depth / self.arrest.depth - 1,
            stopping_time=relative(self.arrest.time, arrest.time),
            trajectory=off[0] / self.series[0].scale,
            pitch=off[1] if len(off) > 1 else None,
        )


class ModelTrial(DropTrial):
    """A body of a custom model: it starts from its keyframe at the first row of the record."""

    def _make_simulator(self, duration: float) -> Simulator:
        run = self.run
        model, _ = load(Drop(run.model, keyframe=run.keyframe))
        (body,) = find_all(model, "body", run.model_body)
        if floors := find_floors(model, geoms_in_sand(model, SandSpec()), Plane()):
            raise run.error(
                f"{describe_floors(model, floors, WOULD_CARRY)}: remove it from the model, the "
                "sand is in its place"
            )
        data = mujoco.MjData(model)
        start_from(model, data, run.keyframe)
        self._body, self._steps = body, int(np.ceil(duration / model.opt.timestep)) + 2
        self._qpos, self._qvel = data.qpos.copy(), data.qvel.copy()
        if self._speed:
            joint = model.body_jntadr[model.body_rootid[body]]
            if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
                raise run.error("a speed is for a free joint; use a keyframe with velocities")
            self._qvel[model.jnt_dofadr[joint] + 2] -= self._speed
        return Simulator(model, Implicit())

    def simulate(self, material: Material) -> Motion:
        simulator = self._simulator
        simulator.use(material)
        if not len(simulator.depths_of(self._body)):
            raise InputError(f"the body {self.run.model_body!r} does not meet the sand")
        simulator.reset(self._qpos, self._qvel)
        depth = np.empty(self._steps)
        for k in range(self._steps):
            simulator.step()
            depth[k] = simulator.depths_of(self._body).max()
        return Motion(depth=depth, time=simulator.model.opt.timestep * np.arange(self._steps))
