"""The run itself: the link meets the sand, its end T stops, and it may be followed on to rest."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import mujoco
import numpy as np

from mjgranular._util.checks import kind_of
from mjgranular.errors import InputError, UnstableError, warn_user
from mjgranular.experiment.impact import Impact, ImpactResult, Rest, Stop
from mjgranular.experiment.slips import warn_of_slips
from mjgranular.experiment.trajectory import Recorder, Trajectory
from mjgranular.experiment.watch import REST_WINDOW, STILL, RestWatch
from mjgranular.prints import PrintsRecorder
from mjgranular.sand.report import BodyReport

# Energy that the sand may seem to give before the run is ended, over the energy there was to
# begin with. A passive medium gives none; the explicit sign of the static force a little.
_ENERGY_MARGIN = 0.05
# Steps that a line is laid through where velocities tremble. Chosen by trying: at 1e-6 s, 3 of 120
# drawn conditions still miss 0.1 % of the stopping time (the worst 1.7 %); up to 1024 steps miss as
# many. What is left is the creep of the explicit scheme.
_MOST_AVERAGED = 32
_LOOKED_AT = (
    0.4  # of which it is looked at prints as often as over a whole run [s]: each ms; chosen
)
_PROGRESS_STEPS = 5000  # between two calls of `progress`


def run_impact(impact: Impact, *, progress: Callable[[float], None] | None = None) -> ImpactResult:
    """Drops the link.

    Args:
        impact: the drop.
        progress: called now and then with the simulated time [s].

    Returns:
        The result. That T did not stop, or the link did not come to rest, within the duration is
        a result too.

    Raises:
        UnstableError: the simulation diverged, because the time step is too large for the scheme.

    Warns:
        GranularWarning: the time step is above the bound of the explicit scheme.
        RangeWarning: a height, a speed or a density that is a slip of units, most likely.
    """
    if not isinstance(impact, Impact):
        raise InputError(f"run_impact takes an Impact, not {kind_of(impact)}")
    warn_of_slips(
        lengths={"the height of release": impact.height},
        speed=impact.speed,
        density=impact.density,
    )
    bound = impact.largest_step()
    if impact.scheme_taken == "explicit" and impact.timestep > bound:
        warn_user(
            f"the time step {impact.timestep:g} s is above {bound:.2g} s, the bound below which "
            f"the explicit scheme is sure to be stable for this impact"
        )
    return _Run(impact).follow(progress)


def _crossing(recent: deque[float]) -> float | None:
    """Finds the time at which a velocity crosses zero, or comes to it, at its last value.

    Where the link slides on the static force (E keeps its height while T still sinks), the explicit
    sign of that force makes velocities tremble from step to step, and a velocity that comes down to
    zero slowly touches it early. Then a straight line through the last steps decides.

    Args:
        recent: the velocity at the last steps, at least two; the last is not above `STILL`.

    Returns:
        The crossing, in steps after the last but one; None if the velocity only trembles.
    """
    last, now = recent[-2], recent[-1]
    if len(recent) >= 8:
        v = np.array(recent)
        slope, value = np.polyfit(np.arange(len(v)) - (len(v) - 2), v, 1)
        if np.median(np.abs(np.diff(v, 2))) > abs(slope):
            return -value / slope if slope < 0 and value + slope <= 0 else None
    return min(last / (last - now), 1.0) if last > max(now, 0.0) else 0.0


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
        # MuJoCo's velocities lie half a step before its positions (docs/scheme.md). Released in the
        # air, the link has so much less of gravity's speed half a step before.
        self.gravity = float(np.linalg.norm(self.model.opt.gravity))
        self.data.qvel[1] += impact.timestep / 2 * self.gravity
        self.point = self.link.lowest(impact.angle)  # T, as a point of the body
        self.touchdown: float | None = 0.0 if impact.height == 0 else None
        self.stop: Stop | None = None
        self.rest: Rest | None = None
        self.steps = 0
        self.felt: dict[float, BodyReport] = {}  # at samples, of sand that remembers
        self.prints = None
        if self.sand.memory is not None:
            self.prints = PrintsRecorder(self.sand, self.data, _LOOKED_AT)
            self.prints.look(0.0)
        self.before_stop = Recorder(7)
        self.after_stop = Recorder(7)
        # Energy is counted from the least that the link can have in reach: a drop by its length.
        scale = self.energy() + self.link.mass * self.gravity * self.link.reach
        self.most_energy = self.energy() + _ENERGY_MARGIN * scale

    def energy(self) -> float:
        """Kinetic and potential energy [J]."""
        link = self.link
        vx, vz, omega = self.data.qvel.tolist()
        kinetic = link.mass * (vx * vx + vz * vz) + link.inertia * omega * omega
        return kinetic / 2 + link.mass * self.gravity * float(self.data.qpos[1])

    def follow(self, progress: Callable[[float], None] | None) -> ImpactResult:
        """Steps until the end."""
        impact, data, link = self.impact, self.data, self.link
        step, qpos, qvel, tip = self.sand.step, data.qpos, data.qvel, link.tip
        point = self.point
        timestep = impact.timestep
        total = math.ceil(impact.duration / timestep - 1e-9)
        check_every = max(1, round(REST_WINDOW / timestep / 50))
        watch = RestWatch()
        recent: deque[float] = deque(maxlen=_MOST_AVERAGED)  # velocities of T, down

        self.sample(self.before_stop)
        before: tuple[float, ...] | None = None
        sinking = False  # T has moved down since it touched the sand
        position, velocity = qpos.tolist(), qvel.tolist()
        prints = self.prints
        for index in range(total):
            step(data)
            self.steps = index + 1
            if prints is not None:
                prints.look(self.steps * timestep)
            if self.stop is None:
                # T at the time of `position`, which lies between the two velocities.
                after = qvel.tolist()
                mean = [(u + v) / 2 for u, v in zip(velocity, after, strict=True)]
                now = tip(position, mean, point)
                position, velocity = qpos.tolist(), after
                recent.append(now[3])
                if self.touchdown is None and before is not None and now[1] >= 0:
                    self.touchdown = timestep * (index - now[1] / (now[1] - before[1]))
                if self.touchdown is not None and before is not None and now[3] <= STILL:
                    sinking = sinking or before[3] > STILL
                    part = _crossing(recent) if sinking else None
                else:
                    part = None
                if part is not None and before is not None:
                    self.stop = self.locate_stop(index, part, before, now)
                    self.check_energy()
                    self.sample(self.before_stop)
                    if impact.until == "stop":
                        break
                elif self.before_stop.due():
                    self.check_energy()
                    self.sample(self.before_stop)
                before = now
            else:
                if self.after_stop.due():
                    self.check_energy()
                    self.sample(self.after_stop)
                if index % check_every == 0 and watch.still(self.steps * timestep, self.ends()):
                    self.rest = self.settled(watch.since)
                    self.sample(self.after_stop)
                    break
            if progress is not None and index % _PROGRESS_STEPS == 0:
                progress(self.steps * timestep)
        self.check_energy()
        if prints is not None:
            prints.look(self.steps * timestep, last=True)
        rows = np.vstack([self.before_stop.rows(), self.after_stop.rows()])
        rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
        return ImpactResult(
            impact=impact,
            law=impact.law or self.sand.law.name,
            touchdown=self.touchdown,
            stop=self.stop,
            rest=self.rest,
            trajectory=Trajectory.from_states(rows, link, self.sand, point, self.felt),
            steps=self.steps,
            prints=None if prints is None else prints.prints(),
        )

    def sample(self, recorder: Recorder) -> None:
        """Takes a sample of the state."""
        t = self.steps * self.impact.timestep
        recorder.take(t, self.data.qpos, self.data.qvel)
        if self.prints is not None:
            self.felt[t] = self.sand.report(self.data)["link"]

    def locate_stop(
        self, index: int, part: float, before: tuple[float, ...], now: tuple[float, ...]
    ) -> Stop:
        """The stop, `part` of a step after the one before `index`: T's velocity is linear there."""
        h = self.impact.timestep
        part = min(part, 1.0)
        q, omega = float(self.data.qpos[2]), float(self.data.qvel[2])
        assert self.touchdown is not None
        return Stop(
            time=(index - 1 + part) * h - self.touchdown,
            # Where velocities tremble, the crossing may lie some steps back: depth stands there.
            depth=before[1] + h * part * before[3] / 2 if part >= 0 else before[1],
            x=before[0] + part * (now[0] - before[0]),
            angle=q - (2 - part) * h * omega,
            angular_velocity=omega,
            step=index - 1,
        )

    def ends(self) -> np.ndarray:
        """Both ends of the link, x and z of each [m], shape (4,)."""
        x, z, q = self.data.qpos.tolist()
        half = self.link.reach / 2
        s, c = half * math.sin(q), half * math.cos(q)
        return np.array([x + s, z - c, x - s, z + c])

    def settled(self, since: float) -> Rest:
        """The state of rest."""
        assert self.touchdown is not None
        ends = self.ends()
        q = float(self.data.qpos[2])
        lean = math.atan(math.tan(q)) if abs(math.cos(q)) > 1e-12 else math.pi / 2
        return Rest(time=since - self.touchdown, depth=-float(ends[1::2].min()), angle=lean)

    def check_energy(self) -> None:
        """End the run when the simulation has diverged."""
        energy = self.energy()
        if not energy <= self.most_energy:  # also when it is not a number
            raise UnstableError(
                f"the run was stopped at t = {self.steps * self.impact.timestep:.4g} s: the link "
                f"has more energy than it began with, so the time step "
                f"{self.impact.timestep:g} s is too large for the {self.impact.scheme_taken} "
                f"scheme; below {self.impact.largest_step():.2g} s it is sure to be stable"
            )
