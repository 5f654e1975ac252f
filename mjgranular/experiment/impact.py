"""The impact of a link: its options and its result."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import mujoco
import numpy as np

from mjgranular._util.checks import check_finite, check_kind, kind_of
from mjgranular.errors import InputError, UnstableError, listed, warn_user
from mjgranular.experiment.sampling import REST_WINDOW, Recorder, RestWatch, StopWatch, WorkMeter
from mjgranular.experiment.trajectory import Trajectory, degrees
from mjgranular.law import get_law
from mjgranular.law.link import DistributedLinkLaw, LinkLaw
from mjgranular.medium import get_medium
from mjgranular.models import Projectile
from mjgranular.models.link import Shape
from mjgranular.relief.memory import Memory, as_memory
from mjgranular.render import TrackRecorder, Tracks
from mjgranular.sand import Sand, SandSpec
from mjgranular.scheme import get_scheme

Until = Literal["stop", "rest"]

# Fields that a summary has as they are.
_UNCHANGED = ("tangential_speed", "angular_velocity", "height", "length", "diameter", "density")


@dataclass(frozen=True)
class Impact:
    """A drop of the link, SI units and radians. The defaults are the paper's first case.

    `law` and `memory` are those of `PlainSand`.

    Attributes:
        speed: velocity of the lower end T at release, down [m/s].
        angle: angle of the link from the vertical, less than a right angle [rad].
        tangential_speed: velocity of T along the surface at release, to where the link leans [m/s].
        angular_velocity: rate of change of the angle at release [rad/s].
        height: height of T above the surface at release [m].
        length: length of the link [m].
        diameter: diameter of the link [m].
        density: density of the link [kg/m^3].
        medium: name of the sand, see `mjgranular list media`, or a YAML file.
        scheme: how forces become a step. Default: explicit, or implicit where the law needs it.
        timestep: time step of the simulation [s].
        until: "stop" ends the run when T stops, "rest" when the whole link does, which needs a law
            such as link_distributed.
        duration: simulated time after which the run ends at the latest [s].
        body: shape of the body: link, or another shape of that length and diameter.
    """

    speed: float = 10.0
    angle: float = math.pi / 4
    tangential_speed: float = 0.0
    angular_velocity: float = 0.0
    height: float = 0.0
    length: float = 0.2
    diameter: float = 0.01
    density: float = 7700.0
    medium: str = "play_sand"
    law: str | None = None
    scheme: str | None = None
    timestep: float = 1e-5
    until: Until = "stop"
    duration: float = 2.0
    body: Shape = "link"
    memory: str | float | None = None

    def __post_init__(self) -> None:
        for name in ("speed", "angle", "tangential_speed", "angular_velocity", "height"):
            check_finite(name, getattr(self, name))
        if self.speed < 0:
            raise InputError(f"the downward speed of T must not be negative, got {self.speed} m/s")
        if abs(self.angle) >= math.pi / 2:
            raise InputError(
                f"the angle from the vertical must be less than 90 degrees, got "
                f"{degrees(self.angle):g}: a flat link meets the sand with its whole length at "
                "once, and the law's immersed length y_T / cos q has no meaning there"
            )
        if self.height < 0:
            raise InputError(
                f"the height of T must be 0 or more, not below the surface, got {self.height} m"
            )
        for name, value in (("time step", self.timestep), ("duration", self.duration)):
            check_finite(f"the {name}", value, "s", positive=True)
        if self.timestep > self.duration:
            raise InputError(
                f"the time step ({self.timestep} s) is longer than the duration ({self.duration} s)"
            )
        if self.until not in get_args(Until):
            raise InputError(f"until must be one of {listed(get_args(Until))}, got {self.until!r}")
        if not isinstance(self.law, str | None) or not isinstance(self.medium, str):
            what = self.medium if isinstance(self.law, str | None) else self.law
            raise InputError(f"medium and law of an impact must be names, got {kind_of(what)}")
        if isinstance(self.memory, Memory):
            raise InputError(
                "memory of an impact must be the side of a cell [m], or words 'cell=0.005 extent=1'"
            )
        as_memory(self.memory)
        _ = self.link
        medium = get_medium(self.medium)
        get_law(self.law, medium)
        get_scheme(self.scheme_taken)

    @property
    def title(self) -> str:
        return self.body

    @property
    def link(self) -> Projectile:
        """The link, or the body that replaces it."""
        return Projectile(self.length, self.diameter, self.density, self.body)

    @property
    def scheme_taken(self) -> str:
        if self.scheme is not None:
            return self.scheme
        return "implicit" if get_law(self.law, get_medium(self.medium)).adds_mass else "explicit"

    @property
    def described(self) -> SandSpec:
        return SandSpec(
            medium=self.medium,
            law=self.law,
            scheme=self.scheme_taken,
            bodies="link",
            memory=self.memory,
        )

    def largest_step(self) -> float:
        """Return the largest time step for which the drag is sure not to overshoot [s].

        At immersed length l the drag is at most `eta_d rho_g d l |v| v`, at E, whose effective
        mass is `1 / (1/m + L_CE^2/I)`. The ratio is greatest for the whole link, l = L, where E is
        C. The speed at E is at most that at release, plus what gravity adds on the way.
        """
        link, medium = self.link, get_medium(self.medium)
        law = get_law(self.law, medium)
        if not isinstance(law, (LinkLaw, DistributedLinkLaw)):
            return math.inf  # no bound is known for the others
        at_release = math.hypot(self.speed, self.tangential_speed)
        at_release += abs(self.angular_velocity) * link.length
        speed = math.sqrt(at_release**2 + 2 * 9.81 * (self.height + link.length))
        quadratic = law.eta_d * medium.density.value * link.diameter * link.length
        rate = 2 * quadratic * speed / link.mass
        # Adams-Bashforth of second order is stable up to there.
        return math.inf if rate == 0 else 1 / rate


@dataclass(frozen=True)
class Stop:
    """The instant at which the vertical velocity of T is first zero.

    Attributes:
        time: time since T touched the surface [s]: the stopping time.
        depth: depth of T [m].
        x: position of T along the surface, from the release [m].
        angle: angle of the link from the vertical [rad].
        angular_velocity: [rad/s].
        step: index of the step that contains it.
    """

    time: float
    depth: float
    x: float
    angle: float
    angular_velocity: float
    step: int


@dataclass(frozen=True)
class Rest:
    """The instant from which the link stays where it is.

    Attributes:
        time: time since T touched the surface [s].
        depth: depth of the lowest point [m].
        angle: angle of the link from the vertical [rad], in (-pi/2, pi/2].
    """

    time: float
    depth: float
    angle: float


@dataclass(frozen=True)
class ImpactResult:
    """A finished run.

    Attributes:
        impact: the drop that was requested.
        law: name of the law.
        touchdown: time from release until T touched the surface [s]; None if it did not.
        stop: when T stopped; None if it did not.
        rest: when the link came to rest; None if it did not, or the run ended at the stop.
        trajectory: the samples.
        steps: number of steps taken.
        greatest_force: of the sand, over all steps [N].
        prints: tracks in the sand; None for sand without memory.
    """

    impact: Impact
    law: str
    touchdown: float | None
    stop: Stop | None
    rest: Rest | None
    trajectory: Trajectory
    steps: int
    greatest_force: float
    prints: Tracks | None = None

    def summary(self) -> dict[str, Any]:
        """Return the result in plain numbers, SI units; names with `_deg` are in degrees."""
        stop, rest, impact = self.stop, self.rest, self.impact
        return {
            "law": self.law,
            "medium": impact.medium,
            "scheme": impact.scheme_taken,
            "timestep": impact.timestep,
            "body": impact.body,
            "speed": impact.speed,
            "angle_deg": degrees(impact.angle),
            "stopping_time": None if stop is None else stop.time,
            "depth": float(self.trajectory.y_T.max()) if stop is None else stop.depth,
            "stopped": stop is not None,
            **{name: getattr(impact, name) for name in _UNCHANGED},
            "touchdown_time": self.touchdown,
            "stop_angle_deg": None if stop is None else degrees(stop.angle),
            "stop_angular_velocity": None if stop is None else stop.angular_velocity,
            "stop_x": None if stop is None else stop.x,
            "until": impact.until,
            "at_rest": rest is not None,
            "rest_time": None if rest is None else rest.time,
            "rest_depth": None if rest is None else rest.depth,
            "rest_angle_deg": None if rest is None else degrees(rest.angle),
            "greatest_force": self.greatest_force,
            "steps": self.steps,
        }


# Energy that the sand may seem to give before the run is ended, over the energy there was to
# begin with. A passive medium gives none; the explicit sign of the static force a little.
_ENERGY_MARGIN = 0.05
_TRACKS_FOR = 0.4  # tracks are recorded as often as over a whole run of that duration [s]; chosen
_PROGRESS_STEPS = 5000  # between two calls of `progress`


def run_impact(impact: Impact, *, progress: Callable[[float], None] | None = None) -> ImpactResult:
    """Drop the link; `progress` is called now and then with the simulated time [s].

    There is a result also if T did not stop, or the link did not come to rest, within the duration.

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
    def __init__(self, impact: Impact) -> None:
        self.impact = impact
        self.link = impact.link
        self.model = self.link.model(impact.timestep)
        self.sand = Sand(self.model, impact.described)
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
        self.before = self.data.qpos.tolist(), self.data.qvel.tolist()
        self.x_before = 0.0  # of T
        self.stop: Stop | None = None
        self.rest: Rest | None = None
        self.steps = 0
        remembers = self.sand.memory is not None
        self.tracks = TrackRecorder(self.sand, self.data, _TRACKS_FOR) if remembers else None
        self.meter = WorkMeter(self.sand, self.data)
        self.before_stop = Recorder(7)
        self.after_stop = Recorder(7)
        # Energy is counted from the least that the link can have in reach: a drop by its length.
        scale = self.energy() + self.link.mass * self.gravity * self.link.reach
        self.most_energy = self.energy() + _ENERGY_MARGIN * scale

    @property
    def time(self) -> float:
        return self.steps * self.impact.timestep

    def energy(self) -> float:
        link = self.link
        vx, vz, omega = self.data.qvel.tolist()
        kinetic = link.mass * (vx * vx + vz * vz) + link.inertia * omega * omega
        return kinetic / 2 + link.mass * self.gravity * float(self.data.qpos[1])

    def follow(self, progress: Callable[[float], None] | None) -> None:
        """Step until T stops, or with `until="rest"` until the link stays where it is."""
        impact, total = self.impact, math.ceil(self.impact.duration / self.impact.timestep - 1e-9)
        check_every = max(1, round(REST_WINDOW / impact.timestep / 50))
        watch = RestWatch()
        self.sample(self.before_stop)
        for self.steps in range(1, total + 1):
            self.sand.step(self.data)
            self.meter.add()
            self.look()
            if progress is not None and self.steps % _PROGRESS_STEPS == 0:
                progress(self.time)
            if self.stop is None:
                self.stop = self._follow_tip()
                if self.stop is not None or self.before_stop.due():
                    self.sample(self.before_stop)
                if self.stop is not None and impact.until == "stop":
                    break
                continue
            if self.after_stop.due():
                self.sample(self.after_stop)
            if (self.steps - 1) % check_every == 0 and watch.still(self.time, self._ends()):
                self.rest = self._settled(watch.since)
                self.sample(self.after_stop)
                break
        self.check_energy()
        self.look(last=True)

    def _follow_tip(self) -> Stop | None:
        """Follow T for a step; return where it stops."""
        # T at the time of the position before, which is between the two velocities.
        position, velocity = self.before
        after = self.data.qvel.tolist()
        mean = [(u + v) / 2 for u, v in zip(velocity, after, strict=True)]
        x, depth, _, down = self.link.tip(position, mean, self.point)
        self.before = self.data.qpos.tolist(), after
        stop, x_before, self.x_before = self.watch.follow(depth, down), self.x_before, x
        if stop is None:
            return None
        # T's velocity is linear in time there.
        q, omega, (time, deepest, part) = float(self.data.qpos[2]), after[2], stop
        return Stop(
            time=time,
            depth=deepest,
            x=x_before + part * (x - x_before),
            angle=q - (2 - part) * self.impact.timestep * omega,
            angular_velocity=omega,
            step=self.steps - 2,
        )

    def sample(self, recorder: Recorder) -> None:
        self.check_energy()
        report = self.sand.report(self.data).bodies
        recorder.take(self.time, self.data.qpos, self.data.qvel, report=report)

    def look(self, *, last: bool = False) -> None:
        if self.tracks is not None:
            self.tracks.look(self.time, last=last)

    def _ends(self) -> np.ndarray:
        """Return both ends of the link, x and z of each [m], shape (4,)."""
        x, z, q = self.data.qpos.tolist()
        half = self.link.reach / 2
        s, c = half * math.sin(q), half * math.cos(q)
        return np.array([x + s, z - c, x - s, z + c])

    def _settled(self, since: float) -> Rest:
        assert self.watch.touchdown is not None
        q = float(self.data.qpos[2])
        lean = math.atan(math.tan(q)) if abs(math.cos(q)) > 1e-12 else math.pi / 2
        position, (x, z) = self.data.qpos.tolist(), self.link.lowest(q)
        # Perhaps it has turned over.
        ends = [self.link.tip(position, [0.0] * 3, end) for end in ((x, z), (-x, -z))]
        depth = max(end[1] for end in ends)
        return Rest(time=since - self.watch.touchdown, depth=depth, angle=lean)

    def check_energy(self) -> None:
        if not self.energy() <= self.most_energy:  # also if it is NaN
            raise UnstableError(
                f"the run was stopped at t = {self.time:.4g} s: the link has more energy than it "
                f"began with, so the time step {self.impact.timestep:g} s is too large for the "
                f"{self.impact.scheme_taken} scheme; below {self.impact.largest_step():.2g} s it "
                "is sure to be stable"
            )

    def result(self) -> ImpactResult:
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
            prints=None if self.tracks is None else self.tracks.prints(),
        )
