"""The run of an impact: the link meets the sand, its end T stops, and perhaps it comes to rest."""

from __future__ import annotations

import math
from collections.abc import Callable

import mujoco
import numpy as np

from mjgranular._util.checks import check_kind
from mjgranular.errors import UnstableError, warn_user
from mjgranular.experiment.impact import Impact, ImpactResult, Rest, Stop
from mjgranular.experiment.sampling import Recorder, Sampler
from mjgranular.experiment.trajectory import Trajectory
from mjgranular.experiment.watch import REST_WINDOW, RestWatch, StopWatch
from mjgranular.sand.work import WorkMeter

# Energy that the sand may seem to give before the run is ended, over the energy there was to
# begin with. A passive medium gives none; the explicit sign of the static force a little.
_ENERGY_MARGIN = 0.05
_TRACKS_FOR = 0.4  # tracks are recorded as often as over a whole run of that duration [s]; chosen
_PROGRESS_STEPS = 5000  # between two calls of `progress`


def run_impact(impact: Impact, *, progress: Callable[[float], None] | None = None) -> ImpactResult:
    """Drop the link.

    Args:
        impact: the drop.
        progress: called now and then with the simulated time [s].

    Returns:
        The result, also if T did not stop, or the link did not come to rest, within the duration.

    Raises:
        UnstableError: the simulation diverged, because the time step is too large for the scheme.

    Warns:
        GranularWarning: the time step is above the bound of the explicit scheme.
    """
    check_kind(impact, Impact, "run_impact")
    bound = impact.largest_step()
    if impact.scheme_taken == "explicit" and impact.timestep > bound:
        warn_user(
            f"the time step {impact.timestep:g} s is above {bound:.2g} s, the bound below which "
            f"the explicit scheme is sure to be stable for this impact"
        )
    run = _Run(impact)
    run.follow(progress)
    return run.result()


class _Run:
    """A run under way."""

    def __init__(self, impact: Impact) -> None:
        self.impact = impact
        self.link = impact.link
        self.model = self.link.model(impact.timestep)
        self.sand = impact.sand(self.model)
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:] = self.link.touching(impact.angle)
        self.data.qpos[1] += impact.height
        self.data.qvel[:] = self.link.moving(
            impact.angle, impact.speed, impact.tangential_speed, impact.angular_velocity
        )
        # MuJoCo's velocities are half a step before its positions (docs/scheme.md). Released in the
        # air, the link has less of gravity's speed half a step before.
        self.gravity = float(np.linalg.norm(self.model.opt.gravity))
        self.data.qvel[1] += impact.timestep / 2 * self.gravity
        self.point = self.link.lowest(impact.angle)  # T, as a point of the body
        self.watch = StopWatch(impact.timestep)
        self.stop: Stop | None = None
        self.rest: Rest | None = None
        self.steps = 0
        self.sampler = Sampler(self.sand, self.data, _TRACKS_FOR)
        self.meter = WorkMeter(self.sand, self.data)
        self.before_stop = Recorder(7)
        self.after_stop = Recorder(7)
        # Energy is counted from the least that the link can have in reach: a drop by its length.
        scale = self.energy() + self.link.mass * self.gravity * self.link.reach
        self.most_energy = self.energy() + _ENERGY_MARGIN * scale

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.steps * self.impact.timestep

    def energy(self) -> float:
        """Return the kinetic and potential energy [J]."""
        link = self.link
        vx, vz, omega = self.data.qvel.tolist()
        kinetic = link.mass * (vx * vx + vz * vz) + link.inertia * omega * omega
        return kinetic / 2 + link.mass * self.gravity * float(self.data.qpos[1])

    def follow(self, progress: Callable[[float], None] | None) -> None:
        """Step until the end."""
        impact = self.impact
        total = math.ceil(impact.duration / impact.timestep - 1e-9)
        self.sample(self.before_stop)
        going = self._fall(total, progress)
        if going and impact.until == "rest":
            self._come_to_rest(total, progress)
        self.check_energy()
        self.sampler.look(self.time, last=True)

    def _step(self, progress: Callable[[float], None] | None) -> None:
        self.sand.step(self.data)
        self.steps += 1
        self.meter.add()
        self.sampler.look(self.time)
        if progress is not None and self.steps % _PROGRESS_STEPS == 0:
            progress(self.time)

    def _fall(self, total: int, progress: Callable[[float], None] | None) -> bool:
        """Step until T stops; return False if it does not."""
        qpos, qvel, tip, point = self.data.qpos, self.data.qvel, self.link.tip, self.point
        position, velocity = qpos.tolist(), qvel.tolist()
        x_before = 0.0
        while self.steps < total:
            self._step(progress)
            # T at the time of `position`, which is between the two velocities.
            after = qvel.tolist()
            mean = [(u + v) / 2 for u, v in zip(velocity, after, strict=True)]
            x, depth, _, down = tip(position, mean, point)
            position, velocity = qpos.tolist(), after
            if self.watch.follow(depth, down):
                self.stop = self._stop(x_before, x)
                self.sample(self.before_stop)
                return True
            if self.before_stop.due():
                self.sample(self.before_stop)
            x_before = x
        return False

    def _stop(self, x_before: float, x: float) -> Stop:
        """Return the stop, at which T's velocity is linear in time."""
        watch, q, omega = self.watch, float(self.data.qpos[2]), float(self.data.qvel[2])
        assert watch.time is not None
        return Stop(
            time=watch.time,
            depth=watch.depth,
            x=x_before + watch.part * (x - x_before),
            angle=q - (2 - watch.part) * self.impact.timestep * omega,
            angular_velocity=omega,
            step=self.steps - 2,
        )

    def _come_to_rest(self, total: int, progress: Callable[[float], None] | None) -> None:
        """Step until the whole link is at rest."""
        check_every = max(1, round(REST_WINDOW / self.impact.timestep / 50))
        watch = RestWatch()
        while self.steps < total:
            self._step(progress)
            if self.after_stop.due():
                self.sample(self.after_stop)
            if (self.steps - 1) % check_every == 0 and watch.still(self.time, self._ends()):
                self.rest = self._settled(watch.since)
                self.sample(self.after_stop)
                return

    def sample(self, recorder: Recorder) -> None:
        """Take a sample of the state."""
        self.check_energy()
        self.sampler.take(self.time, recorder)

    def _ends(self) -> np.ndarray:
        """Return both ends of the link, x and z of each [m], shape (4,)."""
        x, z, q = self.data.qpos.tolist()
        half = self.link.reach / 2
        s, c = half * math.sin(q), half * math.cos(q)
        return np.array([x + s, z - c, x - s, z + c])

    def _settled(self, since: float) -> Rest:
        """Return the state of rest."""
        assert self.watch.touchdown is not None
        q = float(self.data.qpos[2])
        lean = math.atan(math.tan(q)) if abs(math.cos(q)) > 1e-12 else math.pi / 2
        position, (x, z) = self.data.qpos.tolist(), self.link.lowest(q)
        # Perhaps it has turned over.
        ends = [self.link.tip(position, [0.0] * 3, end) for end in ((x, z), (-x, -z))]
        depth = max(end[1] for end in ends)
        return Rest(time=since - self.watch.touchdown, depth=depth, angle=lean)

    def check_energy(self) -> None:
        """Check that the simulation has not diverged."""
        if not self.energy() <= self.most_energy:  # also if it is NaN
            raise UnstableError(
                f"the run was stopped at t = {self.time:.4g} s: the link "
                f"has more energy than it began with, so the time step "
                f"{self.impact.timestep:g} s is too large for the {self.impact.scheme_taken} "
                f"scheme; below {self.impact.largest_step():.2g} s it is sure to be stable"
            )

    def result(self) -> ImpactResult:
        """Return the finished run."""
        rows = np.vstack([self.before_stop.rows(), self.after_stop.rows()])
        reports = self.before_stop.reports + self.after_stop.reports
        first = np.unique(rows[:, 0], return_index=True)[1]
        rows, bodies = rows[first], [reports[number][0] for number in first]
        return ImpactResult(
            impact=self.impact,
            law=self.impact.law or self.sand.law.name,
            touchdown=self.watch.touchdown,
            stop=self.stop,
            rest=self.rest,
            trajectory=Trajectory.from_states(rows, self.link, self.gravity, bodies, self.point),
            steps=self.steps,
            greatest_force=float(max(self.meter.force[0], np.linalg.norm(bodies[-1].force))),
            prints=self.sampler.tracks(),
        )
