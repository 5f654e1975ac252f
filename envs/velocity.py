"""Robots that follow commanded velocities on sand."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import mujoco
import numpy as np

from mjgranular._util.checks import check_count
from mjgranular.envs.ranges import Sample
from mjgranular.envs.task import Start, State, Task, coordinates
from mjgranular.errors import InputError, loading, shown
from mjgranular.models import robot_path
from mjgranular.shape.sizes import geom_axes

_COMMANDS, _PUSHES = 8, 20  # at most, in an episode of 20 s
_LATE = 3  # the longest delay, in steps

_COMMAND_TIME = (3.0, 8.0)  # of a command [s]; these and the next two as in mjlab
_PUSH_TIME = (1.0, 3.0)  # from one push to the next [s]
_PUSH_SIZE = np.array([0.5, 0.5, 0.4, 0.52, 0.52, 0.78])  # [m/s], [rad/s]
_STANDING, _FORWARD = 0.1, 0.2  # shares of commands to stand, and to walk straight ahead

_TILT = math.cos(math.radians(70))  # as in mjlab
# Proportional to the strength of the motors.
_OF_MOTORS = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")


class Motor(NamedTuple):
    """The motor of a joint, behind its gear."""

    torque: float  # the largest [N m]
    inertia: float  # of its rotor [kg m^2]
    # As in MuJoCo Playground. With mjlab's, a natural frequency of 10 Hz, the trunk of a Go1 sags
    # and a scripted trot does not get ahead on sand.
    stiffness: float = 35.0  # [N m/rad]
    damping: float = 0.5  # [N m s/rad]


class Gait(NamedTuple):
    """A scripted gait: what each leg does, its joints from the hip down. All chosen."""

    rate: float  # steps of each leg in a second
    swing: float  # height of a swinging foot over the surface [m]
    leg: float  # height of a hip over its sole in the stance [m]
    gain: float  # strides over what would do without slip
    lift: tuple[float, ...]  # offsets that raise a swinging leg [rad]
    stride: tuple[float, ...]  # joints that swing it back, 1 or -1


@dataclass(frozen=True, kw_only=True)
class Go1Velocity(Task):
    """Follow commands of velocity on four legs.

    ## Description
    A Unitree Go1, 12.7 kg, walks on Quikrete medium sand at commanded velocities: ahead,
    sideways and in yaw. Commands and pushes are those of mjlab's velocity task, which has a hard
    floor; rewards and motors are after mjlab's and MuJoCo Playground's. The robot's files are not
    in this package: `mjgranular.models.robot_path` finds them.

    The sand meets the lower legs, with the geoms that the robot collides with:

    | body | geoms | why |
    |---|---|---|
    | `*_calf` | a sphere of 46 mm, the foot | it carries the robot, and sinks by some 3 cm |
    | `*_calf` | capsules of 20 mm, the shank | what follows the foot into weak sand |
    | others | none | the episode is over before they reach the sand |

    Parts of the robot do not collide with each other.

    ## Action Space
    `Box(-1, 1, (12,), float32)`: positions that the motors go to, 50 times a second, as offsets
    from those of a trot at the commanded velocity ahead; from the stance if the command is to
    stand. The trot lifts diagonal legs in turn, twice a second: thighs by 0.5 and calves by -1 rad,
    and swings them by 1.5 of the stride that would do without slip. It does not keep its balance.

    | index | name | unit | range |
    |---|---|---|---|
    | 0, 1, 2 | hip, thigh and calf of the front right leg | rad | -1 to 1 |
    | 3 to 5 | front left | rad | -1 to 1 |
    | 6 to 8 | rear right | rad | -1 to 1 |
    | 9 to 11 | rear left | rad | -1 to 1 |

    ## Observation Space
    `Box(-inf, inf, (47,), float64)`: what the robot can measure; order of joints as above.

    | index | name | unit | range |
    |---|---|---|---|
    | 0 to 2 | direction of gravity, in the frame of the trunk | 1 | -1 to 1 |
    | 3 to 5 | angular velocity of the trunk, in its frame | rad/s | any |
    | 6 to 17 | joint angles from the stance | rad | limits of the joints |
    | 18 to 29 | joint velocities | rad/s | any |
    | 30 to 41 | last action | rad | -1 to 1 |
    | 42, 43 | commanded velocity ahead and to the left | m/s | `command_x`, `command_y` |
    | 44 | commanded yaw rate, to the left | rad/s | `command_yaw` |
    | 45, 46 | sine and cosine of the trot's phase; 0 if the command is to stand | 1 | -1 to 1 |

    With `history=4`, 168 more: 0 to 41 of the last four steps, the latest first; at first zeros.

    With `privileged=True`, `info["privileged"]` has what no robot measures, for a critic:

    | index | name | unit | range |
    |---|---|---|---|
    | 0 to 2 | velocity of the trunk, in its frame | m/s | any |
    | 3 to 6 | heights of the soles over the untouched surface, in the order of legs | m | any |
    | 7 to 9 | force of the sand on the robot, in the world's frame | N | any |
    | 10, 11 | drawn strength and density of the sand | 1 | `randomise` |
    | 12 | drawn slope | rad | `randomise` |
    | 13 | drawn strength of the motors | 1 | `motor_strength` |
    | 14 | drawn delay of the targets, in steps | 1 | `delay` |

    ## Rewards
    The sum of these, each times the duration of a step, 0.02 s:

    | name | value | weight |
    |---|---|---|
    | `reward_linear` | exp(-e^2 / 0.25), e from the commanded velocity [m/s], 0 along z | 3 |
    | `reward_angular` | exp(-e^2 / 0.5), e from the commanded yaw rate [rad/s] | 1.5 |
    | `reward_error` | error of the velocity along the surface [m/s] | 0 |
    | `reward_yaw_error` | error of the yaw rate [rad/s] | 0 |
    | `reward_height` | how much nearer than 0.1 m the trunk is to where an episode ends [m] | 0 |
    | `reward_upright` | exp(-s^2 / 0.2), s the sine of the tilt from the axis z | 1 |
    | `reward_pose` | exp of minus the mean square deviation from the stance | 0.5 |
    | `reward_gait` | exp(-e^2 / 0.01), e [m] off a trot's heights, 0 for feet sunk in stance | 2 |
    | `reward_wobble` | square of the rates of roll and pitch [rad^2/s^2] | -0.05 |
    | `reward_rate` | square of the change of the action | -0.02 |
    | `reward_torque` | square of the torques [N^2 m^2] | -2e-4 |
    | `reward_slip` | square of the speed along the surface of feet in the sand [m^2/s^2] | -0.1 |

    The exponentials are flat near zero: with `error_weight=9` and `yaw_error_weight=1.5`, times
    which the errors themselves are subtracted, commands are followed more closely. Deviations from
    the stance count in units of 0.3 rad, of calves 0.6 rad; a third of that if the command is to
    stand. The 0.1 m of `reward_height` are chosen, not measured. Tilt and motion along the surface
    are relative to the plane z = 0, which is the surface on level sand and on sampled slopes, but
    not on dunes or a `Plane` with a slope.

    ## Starting State
    In its stance on the surface, heading anywhere; joints are off by up to `reset_noise_scale` rad
    and turn at up to that in rad/s.

    At first, for a time drawn from `settling_time`, the command is to stand: a robot that is put
    down sinks until its feet carry it, a Go1 by 8 cm in weak sand. Then a command holds for three
    to eight seconds. One of ten is to stand, one of five to walk straight ahead, at 0.3 m/s or
    more. Every one to three seconds a push changes the trunk's velocity by up to `push_scale` times
    0.5 m/s along x and y, 0.4 m/s along z, 0.52 rad/s in roll and pitch and 0.78 rad/s in yaw.
    There are 7 more commands and 20 pushes, enough for 20 s: later the last command holds.

    Torques of all motors, and their limits, are those of the data sheet times a factor that is
    drawn from `motor_strength`. Targets of the motors come late by a number of steps of 0.02 s that
    is drawn from `delay`, at most 3.

    ## Episode End
    Terminated when the trunk tilts by more than 70 degrees from the axis z, or meets the surface:
    its center is less than 0.06 m above it. Truncated after 1000 steps of 0.02 s.

    ## Arguments
    `robot_file`, a name of MuJoCo Menagerie or a path of MJCF with the same legs, whose other
    joints are locked; `command_x=(-0.8, 0.8)`, `command_y=(-0.4, 0.4)`, `command_yaw=(-1, 1)`,
    `settling_time=(0.5, 0.5)` in seconds, `push_scale=1`, `motor_strength=(1, 1)`, `delay=(0, 0)`,
    `reset_noise_scale=0.05`, `history=0` earlier steps in the observation, `privileged=False`, the
    sizes of the weights above, such as `linear_weight=3`, `frame_skip=4` substeps of 5 ms, and
    those of `Task`: the medium, randomised sand and so on. `bodies` are the feet unless given. The
    default resolution is 2.
    """

    title: ClassVar[str] = "a Unitree Go1 follows commands of velocity"
    reads: ClassVar[tuple[str, ...]] = ("site_xpos", "actuator_force")
    camera: ClassVar[dict[str, Any]] = {
        "trackbodyid": 1, "distance": 1.6, "azimuth": 125.0, "elevation": -15.0,
    }  # fmt: skip
    timestep: ClassVar[float] = 0.005
    # Bodies of the feet; legs of one sign swing together.
    feet: ClassVar[dict[str, float]] = {"FR_calf": 1, "FL_calf": -1, "RR_calf": -1, "RL_calf": 1}
    # Of each leg, from the trunk down.
    motors: ClassVar[dict[str, Motor]] = {
        "hip": Motor(23.7, 0.000111842 * 6.0**2),  # data sheet and gears as in mjlab
        "thigh": Motor(23.7, 0.000111842 * 6.0**2),
        "calf": Motor(35.55, 0.000111842 * 9.0**2),
    }
    # Joint angles [rad], and deviations from them that a gait needs.
    stance: ClassVar[tuple[float, ...]] = 2 * (0.1, 0.9, -1.8, -0.1, 0.9, -1.8)
    pose: ClassVar[tuple[float, ...]] = 4 * (0.3, 0.3, 0.6)
    gait: ClassVar[Gait] = Gait(2.0, 0.08, 0.27, 1.5, (0.0, 0.5, -1.0), (0.0, 1.0, 0.0))
    # Height of the trunk's frame at which an episode ends [m]; None for where the trunk touches.
    low: ClassVar[float | None] = None

    robot_file: str | Path = "unitree_go1"
    resolution: int | None = 2
    frame_skip: int = 4
    command_x: tuple[float, float] = (-0.8, 0.8)
    command_y: tuple[float, float] = (-0.4, 0.4)
    command_yaw: tuple[float, float] = (-1.0, 1.0)
    settling_time: tuple[float, float] = (0.5, 0.5)  # chosen: in weak sand a Go1 sinks for 0.2 s
    push_scale: float = 1.0
    motor_strength: tuple[float, float] = (1.0, 1.0)
    delay: tuple[int, int] = (0, 0)
    reset_noise_scale: float = 0.05
    history: int = 0
    privileged: bool = False
    linear_weight: float = 3.0
    angular_weight: float = 1.5
    error_weight: float = 0.0
    yaw_error_weight: float = 0.0
    height_weight: float = 0.0
    upright_weight: float = 1.0
    pose_weight: float = 0.5
    gait_weight: float = 2.0
    wobble_weight: float = 0.05
    rate_weight: float = 0.02
    torque_weight: float = 2e-4
    slip_weight: float = 0.1

    def __post_init__(self) -> None:
        if self.bodies is None:
            object.__setattr__(self, "bodies", tuple(self.feet))
        super().__post_init__()
        check_count("history", self.history, least=0)
        legs, joints = len(self.feet), len(self.motors)
        for name, values, count in (
            ("stance", self.stance, legs * joints),
            ("pose", self.pose, legs * joints),
            ("gait.lift", self.gait.lift, joints),
            ("gait.stride", self.gait.stride, joints),
        ):
            if len(values) != count:
                which = f"{type(self).__name__}.{name}"
                raise InputError(f"{which} must have {count} numbers, not {len(values)}")
        for name in ("command_x", "command_y", "command_yaw"):
            if not np.isfinite(getattr(self, name)).all():
                raise InputError(f"{name} must be a range of finite numbers")
        for name, least in (("settling_time", 0.0), ("motor_strength", 1e-6)):
            first, last = getattr(self, name)
            if not least <= first <= last < math.inf:
                raise InputError(
                    f"{name} must be a range of finite numbers of at least {least:g}, "
                    f"not {(first, last)}"
                )
        for steps in self.delay:
            check_count("delay", steps, least=0, most=_LATE)

    def load(self) -> mujoco.MjSpec:
        """Return the robot, from its file."""
        with loading(self.robot_file):
            return mujoco.MjSpec.from_file(str(robot_path(self.robot_file)))

    def robot(self) -> mujoco.MjSpec:
        spec = self.load()
        if not np.any(spec.option.gravity):
            raise InputError(f"the model {spec.modelname} has no gravity")
        joints = self._find_joints(spec)
        names = [joint.name for joint in joints]
        for each in (*spec.sensors, *spec.actuators, *spec.keys):
            spec.delete(each)
        for joint in spec.joints[1:]:
            if joint.name not in names:
                spec.delete(joint)
        for joint, motor in zip(joints, len(self.feet) * [*self.motors.values()], strict=True):
            _add_motor(spec, joint, motor)
        for foot in self.feet:
            self.add_sole(spec, spec.body(foot))
        for body in spec.bodies[1:]:
            for geom in body.geoms:
                geom.conaffinity = int(bool(geom.contype or geom.conaffinity))
                geom.contype = 0
        if self.low is None and not any(geom.conaffinity for geom in spec.joints[0].parent.geoms):
            raise InputError(f"no geom of the trunk collides: set {type(self).__name__}.low [m]")
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[50, 50, 1])
        spec.option.timestep = self.timestep
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.nuserdata = self._episode.itemsize // 8
        return spec

    def _find_joints(self, spec: mujoco.MjSpec) -> list[mujoco.MjsJoint]:
        """Return the joints that get motors, leg by leg, each from the trunk down."""
        name = f"the model {spec.modelname}"
        if not spec.joints or spec.joints[0].type != mujoco.mjtJoint.mjJNT_FREE:
            raise InputError(f"the first joint of {name} must be a free joint, that of the trunk")
        legs = []
        for foot in self.feet:
            if (body := spec.body(foot)) is None:
                raise InputError(f"{name} must have the bodies {', '.join(self.feet)}")
            leg: list[mujoco.MjsJoint] = []
            while body is not None and body.name != spec.joints[0].parent.name:
                leg, body = [*body.joints, *leg], body.parent
            hinges = [joint for joint in leg if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
            if len(hinges) != len(leg) or len(leg) != len(self.motors):
                raise InputError(
                    f"between trunk and {foot}, {name} must have the hinges "
                    f"{', '.join(self.motors)}, not {', '.join(j.name for j in leg) or 'none'}"
                )
            legs += leg
        return legs

    def add_sole(self, spec: mujoco.MjSpec, foot: mujoco.MjsBody) -> None:
        """Mark the sole of a foot: the lowest sphere of the calf."""
        spheres = [
            geom
            for geom in foot.geoms
            if geom.type == mujoco.mjtGeom.mjGEOM_SPHERE and (geom.contype or geom.conaffinity)
        ]
        if not spheres:
            raise InputError(f"the body {foot.name} must have a sphere that collides: its foot")
        lowest = min(spheres, key=lambda geom: geom.pos[2])
        foot.add_site(name=_sole_name(foot.name), pos=lowest.pos, size=lowest.size, group=5)

    @cached_property
    def _episode(self) -> np.dtype:
        """What `userdata` has of an episode."""
        count, sensed = len(self.stance), 6 + 3 * len(self.stance)
        return np.dtype(
            [
                ("step", float),  # number of steps so far
                ("slope", float, (2,)),  # sine and cosine
                # Drawn at the start; commands and pushes each with the step at which it begins.
                ("commands", float, (_COMMANDS, 4)),
                ("pushes", float, (_PUSHES, 7)),
                ("motors", float, (2,)),  # their strength, and the delay of their targets
                ("action", float, (count,)),  # the last one
                ("targets", float, (_LATE, count)),  # earlier ones, the last first
                ("past", float, (self.history, sensed)),  # observed before, the last step first
            ]
        )

    def drawn(self, state: State) -> np.ndarray:
        """Return what the user data of episodes have, records of shape (n,)."""
        return state.userdata.view(self._episode)[:, 0]

    @cached_property
    def _stance(self) -> np.ndarray:
        """Joint angles of the stance [rad], shape (n_joints,)."""
        return np.array(self.stance)

    @cached_property
    def _angles(self) -> np.ndarray:
        """Indices of the motors' joints in `qpos`, shape (n_joints,)."""
        return self.model.jnt_qposadr[self.model.actuator_trnid[:, 0]]

    @cached_property
    def _pairs(self) -> np.ndarray:
        """Signs of the legs: those of one sign swing together."""
        return np.array([*self.feet.values()])

    @cached_property
    def _low(self) -> float:
        """`low`, or where the trunk meets level ground [m]."""
        if self.low is not None:
            return self.low
        model, trunk = self.model, self.model.geom_bodyid == self.model.jnt_bodyid[0]
        parts = np.flatnonzero(trunk & (model.geom_conaffinity != 0))
        return -min(
            model.geom_pos[geom, 2] - np.abs(geom_axes(model, geom)[2]) @ model.geom_aabb[geom, 3:]
            for geom in parts.tolist()
        )

    @cached_property
    def _feet(self) -> list[int]:
        """Rows of the feet in `site_xpos`."""
        return [self.model.site(_sole_name(foot)).id for foot in self.feet]

    @cached_property
    def _radius(self) -> float:
        """Height of a foot's site over its sole [m]."""
        return float(self.model.site(self._feet[0]).size[0])

    @cached_property
    def _standing(self) -> tuple[np.ndarray, float]:
        """`qpos` in the stance, with the lowest foot at z = 0, and how far out feet stand [m]."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.model.qpos0
        data.qpos[:2], data.qpos[self._angles] = 0.0, self._stance
        mujoco.mj_kinematics(self.model, data)
        data.qpos[2] += self._radius - data.site_xpos[self._feet, 2].min()
        return data.qpos.copy(), float(np.linalg.norm(data.site_xpos[self._feet, :2], axis=1).max())

    # The start of an episode, with all that happens in it.

    def start(self, random: np.random.Generator, height: Callable[[float, float], float]) -> Start:
        noise, (standing, reach) = self.reset_noise_scale, self._standing
        qpos, places = standing.copy(), (-reach, 0.0, reach)
        qpos[2] += max(height(x, y) for x in places for y in places)
        heading = random.uniform(-math.pi, math.pi)
        qpos[3:7] = math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)
        qpos[7:] += random.uniform(-noise, noise, len(self._stance))
        qvel = np.zeros(self.model.nv)
        qvel[6:] = random.uniform(-noise, noise, len(self._stance))
        drawn = np.zeros(1, self._episode)
        drawn["slope"] = 0.0, 1.0
        drawn["commands"], drawn["pushes"] = self._draw_commands(random), self._draw_pushes(random)
        strength, (least, most) = _draw(random, *self.motor_strength), self.delay
        delay = random.integers(least, most + 1) if least < most else least
        drawn["motors"], drawn["targets"] = (strength, delay), self._stance
        varied = self.motor_strength != (1.0, 1.0)
        motors = {name: strength * getattr(self.model, name) for name in _OF_MOTORS if varied}
        return Start(qpos, qvel, drawn.view(float), motors)

    def begin(self, random: np.random.Generator, sample: Sample | None) -> Start:
        start = super().begin(random, sample)
        if sample is not None:
            assert start.userdata is not None
            slope = math.sin(sample.slope), math.cos(sample.slope)
            start.userdata.view(self._episode)["slope"] = slope
        return start

    @property
    def varied(self) -> tuple[str, ...]:
        fixed = self.motor_strength == (1.0, 1.0)
        return super().varied if fixed else (*super().varied, *_OF_MOTORS)

    def _draw_commands(self, random: np.random.Generator) -> np.ndarray:
        """Return steps at which commands begin, and commands; shape (_COMMANDS, 4)."""
        ranges = (self.command_x, self.command_y, self.command_yaw)
        table = np.zeros((_COMMANDS, 4))
        times = random.uniform(*_COMMAND_TIME, _COMMANDS - 2)
        settling = _draw(random, *self.settling_time)
        table[1:, 0] = np.round(np.array([settling, *times]) / self.dt).cumsum()
        for row in table[1:]:
            row[1:] = [random.uniform(*limits) for limits in ranges]
            kind = random.uniform()
            if kind < _STANDING:
                row[1:] = 0.0
            elif kind < _STANDING + _FORWARD:
                row[1:] = min(max(abs(row[1]), 0.3), self.command_x[1]), 0.0, 0.0
        return table

    def _draw_pushes(self, random: np.random.Generator) -> np.ndarray:
        """Return steps of pushes, and changes of the trunk's velocity; shape (_PUSHES, 7)."""
        table = np.zeros((_PUSHES, 7))
        table[:, 0] = np.round(random.uniform(*_PUSH_TIME, _PUSHES) / self.dt).cumsum()
        limit = self.push_scale * _PUSH_SIZE
        table[:, 1:] = random.uniform(-limit, limit, (_PUSHES, 6))
        return table

    # A step.

    def mark(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        return self.drawn(state)["action"].copy(), state.site_xpos.take(self._feet, axis=1)

    def act(self, action: np.ndarray, state: State) -> np.ndarray:
        applied, drawn = np.clip(action, -1.0, 1.0).astype(float), self.drawn(state)
        if self.history:
            sensed = self.once(state, "sensed", self._sense)[:, None]
            drawn["past"] = np.concatenate([sensed, drawn["past"][:, :-1]], axis=1)
        drawn["action"] = applied
        drawn["step"] += 1
        state.found.clear()  # the command and the phase of the gait are those of the next step
        pushes = drawn["pushes"]
        for row, push in np.argwhere(pushes[:, :, 0] == drawn["step"][:, None]):
            state.qvel[row, :6] += pushes[row, push, 1:]
        targets = self._stance + self._trot(state) + applied
        if self.delay == (0, 0):
            return targets
        known = np.concatenate([targets[:, None], drawn["targets"]], axis=1)
        drawn["targets"] = known[:, :-1]
        return known[np.arange(len(known)), drawn["motors"][:, 1].astype(int)]

    def command(self, state: State) -> np.ndarray:
        """Return commands: velocity ahead, to the left [m/s], yaw rate [rad/s]; shape (n, 3)."""
        return self.once(state, "command", self._command)

    def set_command(self, state: State, command: Any) -> None:
        """Replace the commands of episodes that have begun, as drawn for them, by one.

        Args:
            state: `env.unwrapped.state`.
            command: velocity ahead, to the left [m/s], and yaw rate [rad/s], shape (3,) or (n, 3).

        Raises:
            InputError: another shape, or what is not a finite number.
        """
        try:
            new = np.asarray(command, float)
        except (TypeError, ValueError):
            new = np.array(math.nan)
        if new.shape not in ((3,), (len(state.userdata), 3)) or not np.isfinite(new).all():
            raise InputError(f"a command must be three finite numbers, not {shown(command)}")
        table = self.drawn(state)["commands"]
        table[:, :, 0], table[:, :, 1:] = 0.0, new.reshape(-1, 1, 3)
        state.found.clear()

    def _command(self, state: State) -> np.ndarray:
        drawn = self.drawn(state)
        table, begun = drawn["commands"], drawn["commands"][:, :, 0] <= drawn["step"][:, None]
        return table[np.arange(len(table)), begun.sum(axis=1) - 1, 1:]

    def _trot(self, state: State) -> np.ndarray:
        """Return offsets from the stance, (n, n_joints): a trot at the commanded velocity, or 0."""
        command, clock = self.command(state), self._clock(state)
        gait, pairs = self.gait, self._pairs
        lift = np.maximum(clock[:, :1] * pairs, 0.0)
        stride = clock[:, 1:] * pairs * command[:, :1] * (gait.gain / (4 * gait.rate * gait.leg))
        offsets = [a * lift + b * stride for a, b in zip(gait.lift, gait.stride, strict=True)]
        return np.stack(offsets, axis=2).reshape(len(lift), -1)

    def _clock(self, state: State) -> np.ndarray:
        """Return sine and cosine of the gait's phase, 0 if the command is to stand; (n, 2)."""
        return self.once(state, "clock", self._find_clock)

    def _find_clock(self, state: State) -> np.ndarray:
        angles = 2 * math.pi * self.gait.rate * self.dt * self.drawn(state)["step"]
        clock = np.array([(math.sin(angle), math.cos(angle)) for angle in angles.tolist()])
        walks = np.square(self.command(state)).sum(axis=1) > 0.0
        return np.where(walks[:, None], clock, 0.0)

    def observe(self, state: State) -> np.ndarray:
        sensed, past = self.once(state, "sensed", self._sense), self.drawn(state)["past"]
        seen = [sensed, self.command(state), self._clock(state), *past.transpose(1, 0, 2)]
        return np.concatenate(seen, axis=1)

    def _sense(self, state: State) -> np.ndarray:
        """Return what the robot measures, and its last action, shape (n, sensed)."""
        drawn = self.drawn(state)
        sine, cosine = drawn["slope"].T
        gravity = (-sine, np.zeros(len(sine)), -cosine)
        return np.concatenate(
            [
                np.stack(_to_body(state.qpos, gravity), axis=1),
                state.qvel[:, 3:6],
                state.qpos[:, self._angles] - self._stance,
                state.qvel[:, self._angles - 1],  # a free joint has a number less there
                drawn["action"],
            ],
            axis=1,
        )

    def rewards(self, before: Any, action: np.ndarray, state: State) -> dict[str, np.ndarray]:
        last, feet_before = before
        feet, command = state.site_xpos.take(self._feet, axis=1), self.command(state)
        velocity, turning = self.velocity(state), state.qvel[:, 3:6]
        normal = _to_body(state.qpos, (0.0, 0.0, 1.0))
        tilt = np.square(normal[0]) + np.square(normal[1])
        stands = np.square(command).sum(axis=1) == 0.0
        needed = np.array(self.pose)
        offset = (state.qpos[:, self._angles] - self._stance) / np.where(
            stands[:, None], needed / 3, needed
        )
        speed = np.sqrt(np.square((feet - feet_before)[:, :, :2] / self.dt).sum(axis=2))
        height = self.once(state, "heights", self._heights)
        lift = self.gait.swing * self._clock(state)[:, :1] * self._pairs
        stray = np.where(lift > 1e-9, height - lift, np.maximum(height, 0.0))
        change = self.drawn(state)["action"] - last
        slip = np.where(height < 0.0, np.square(speed), 0.0)
        linear = command * [1.0, 1.0, 0.0] - velocity
        yaw = turning[:, 2] - command[:, 2]
        terms = {
            "linear": self.linear_weight * _exp(-np.square(linear).sum(axis=1) / 0.25),
            "angular": self.angular_weight * _exp(-np.square(yaw) / 0.5),
            "error": -self.error_weight * np.sqrt(np.square(linear[:, :2]).sum(axis=1)),
            "yaw_error": -self.yaw_error_weight * np.abs(yaw),
            "height": self.height_weight * np.minimum(self._spare(state) - 0.1, 0.0),
            "upright": self.upright_weight * _exp(-tilt / 0.2),
            "pose": self.pose_weight * _exp(-np.square(offset).sum(axis=1) / offset.shape[1]),
            "gait": self.gait_weight * _exp(-np.square(stray).sum(axis=1) / 0.01),
            "wobble": -self.wobble_weight * np.square(turning[:, :2]).sum(axis=1),
            "rate": -self.rate_weight * np.square(change).sum(axis=1),
            "torque": -self.torque_weight * np.square(state.actuator_force).sum(axis=1),
            "slip": -self.slip_weight * slip.sum(axis=1),
        }
        return {f"reward_{name}": self.dt * value for name, value in terms.items()}

    def terminated(self, state: State) -> np.ndarray:
        upright = _to_body(state.qpos, (0.0, 0.0, 1.0))[2] > _TILT
        return ~((self._spare(state) > 0.0) & upright)

    def _spare(self, state: State) -> np.ndarray:
        """Return how far the trunk is above where an episode ends [m], shape (n,)."""
        return state.qpos[:, 2] - self._ground(state, state.qpos[:, None, :3])[:, 0] - self._low

    def velocity(self, state: State) -> np.ndarray:
        """Return velocities of the trunk in its own frame [m/s], shape (n, 3)."""
        return np.stack(_to_body(state.qpos, state.qvel[:, :3].T), axis=1)

    def reset_info(self, state: State) -> dict[str, np.ndarray]:
        info = super().reset_info(state)
        if self.privileged:
            sand = np.stack((state.strength, state.density, state.slope), axis=1)
            heights = self.once(state, "heights", self._heights)
            known = (self.velocity(state), heights, info["sand/force"], sand)
            info["privileged"] = np.concatenate([*known, self.drawn(state)["motors"]], axis=1)
        return info

    def place(self, state: State) -> dict[str, np.ndarray]:
        return coordinates("position", state.qpos, "xy") | {"command": self.command(state).copy()}

    def progress(self, before: Any, state: State) -> dict[str, np.ndarray]:
        velocity, command = self.velocity(state), self.command(state)
        error = np.sqrt(np.square(velocity[:, :2] - command[:, :2]).sum(axis=1))
        return {
            "velocity": velocity,
            "velocity_error": error,
            "yaw_rate_error": np.abs(state.qvel[:, 5] - command[:, 2]),
        }

    def _heights(self, state: State) -> np.ndarray:
        """Return heights of the soles over the untouched surface [m], shape (n, n_feet)."""
        feet = state.site_xpos.take(self._feet, axis=1)
        return feet[:, :, 2] - self._radius - self._ground(state, feet)

    def _ground(self, state: State, points: np.ndarray) -> np.ndarray:
        """Return heights of the untouched surface under points of shape (n, k, 3) [m]."""
        heights = np.zeros(points.shape[:2])
        for number in range(len(self.choices)):
            height = self.ground(number)
            if height is not None:
                for row in np.flatnonzero(state.active == number):
                    heights[row] = [height(x, y) for x, y, _ in points[row].tolist()]
        return heights


@dataclass(frozen=True, kw_only=True)
class Go2Velocity(Go1Velocity):
    """Follow commands of velocity on four legs, with a Unitree Go2.

    ## Description
    `Go1Velocity` with another robot: a Unitree Go2, 15.2 kg. The sand meets its feet, spheres of
    44 mm, and its lower legs, cylinders of 22 to 26 mm.

    ## Action Space
    `Box(-1, 1, (12,), float32)`: that of `Go1Velocity`, whatever the order of joints in the file.

    ## Episode End
    As in `Go1Velocity`, but the trunk meets the surface at 0.107 m above it.
    """

    sections: ClassVar[dict[str, str]] = Task.sections | {
        "Observation Space": "`Box(-inf, inf, (47,), float64)`: that of `Go1Velocity`.",
        "Rewards": "Those of `Go1Velocity`.",
        "Starting State": "As in `Go1Velocity`.",
        "Arguments": "Those of `Go1Velocity`, `frame_skip=4` as there.",
    }
    title: ClassVar[str] = "a Unitree Go2 follows commands of velocity"
    motors: ClassVar[dict[str, Motor]] = {  # as in MuJoCo Menagerie
        "hip": Motor(23.7, 0.01),
        "thigh": Motor(23.7, 0.01),
        "calf": Motor(45.43, 0.01),
    }

    robot_file: str | Path = "unitree_go2"


@dataclass(frozen=True, kw_only=True)
class G1Velocity(Go1Velocity):
    """Follow commands of velocity on two legs.

    ## Description
    A Unitree G1, 33 kg, walks on Quikrete medium sand at commanded velocities, by its legs; waist
    and arms are locked at angles of zero. Motors are those of mjlab, stiffness and damping those of
    the first version of Unitree's own training (unitree_rl_gym; its later ones are softer: 100 at
    hips, 150 N m/rad at knees).

    The sand meets the soles, which also stand on a rigid floor:

    | body | geom | why |
    |---|---|---|
    | `*_ankle_roll_link` | a box around what collides, up to the ankle | small spheres sink |
    | others | none | the ankle stays over the sand where the foot carries the robot |

    ## Action Space
    `Box(-1, 1, (12,), float32)`: positions that the motors go to, 50 times a second, as offsets
    from those of a walk at the commanded velocity ahead; from the stance if the command is to
    stand. The walk lifts a leg in turn, 1.25 times a second each, by bending its knee by 0.7 rad
    with the sole level, and swings it by 1.2 of the stride without slip. It does not balance.

    | index | name | unit | range |
    |---|---|---|---|
    | 0 to 2 | hip of the left leg: pitch, roll and yaw | rad | -1 to 1 |
    | 3 | knee | rad | -1 to 1 |
    | 4, 5 | ankle: pitch and roll | rad | -1 to 1 |
    | 6 to 11 | right leg | rad | -1 to 1 |

    ## Observation Space
    `Box(-inf, inf, (47,), float64)`: that of `Go1Velocity`, of the pelvis and these joints. Two
    soles make 13 numbers of `info["privileged"]`.

    ## Rewards
    Those of `Go1Velocity`. Deviations from the stance count in units of 0.4 rad (hip pitch, ankle
    pitch), 0.6 rad (knee) and 0.15 rad (others).

    ## Starting State
    As in `Go1Velocity`, knees bent by 0.67 rad.

    ## Episode End
    As in `Go1Velocity`, but the center of the pelvis is less than 0.4 m above the surface.

    ## Arguments
    Those of `Go1Velocity`, `frame_skip=4` as there; `command_x=(-0.4, 0.8)`,
    `command_y=(-0.3, 0.3)`, `command_yaw=(-0.8, 0.8)`.
    """

    title: ClassVar[str] = "a Unitree G1 follows commands of velocity"
    camera: ClassVar[dict[str, Any]] = {
        "trackbodyid": 1, "distance": 2.8, "azimuth": 125.0, "elevation": -10.0,
    }  # fmt: skip
    feet: ClassVar[dict[str, float]] = {"left_ankle_roll_link": 1, "right_ankle_roll_link": -1}
    motors: ClassVar[dict[str, Motor]] = {
        "hip_pitch": Motor(88.0, 0.0102, 150.0, 2.0),
        "hip_roll": Motor(139.0, 0.0251, 150.0, 2.0),
        "hip_yaw": Motor(88.0, 0.0102, 150.0, 2.0),
        "knee": Motor(139.0, 0.0251, 300.0, 4.0),
        "ankle_pitch": Motor(50.0, 0.0072, 40.0, 2.0),
        "ankle_roll": Motor(50.0, 0.0072, 40.0, 2.0),
    }
    stance: ClassVar[tuple[float, ...]] = 2 * (-0.312, 0.0, 0.0, 0.669, -0.363, 0.0)  # mjlab's
    pose: ClassVar[tuple[float, ...]] = 2 * (0.4, 0.15, 0.15, 0.6, 0.4, 0.15)
    gait: ClassVar[Gait] = Gait(
        1.25, 0.08, 0.65, 1.2, (-0.35, 0.0, 0.0, 0.7, -0.35, 0.0), (1.0, 0.0, 0.0, 0.0, -1.0, 0.0)
    )
    low: ClassVar[float | None] = 0.4

    robot_file: str | Path = "unitree_g1"
    command_x: tuple[float, float] = (-0.4, 0.8)
    command_y: tuple[float, float] = (-0.3, 0.3)
    command_yaw: tuple[float, float] = (-0.8, 0.8)

    def add_sole(self, spec: mujoco.MjSpec, foot: mujoco.MjsBody) -> None:
        """Replace what a foot collides with by a box around it, up to the ankle's axis."""
        hard = [geom for geom in foot.geoms if geom.contype or geom.conaffinity]
        if not hard:
            raise InputError(f"the body {foot.name} must have a geom that collides: its foot")
        with loading("the robot"):
            model = spec.compile()
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for geom in (geom.id for geom in hard):
            axes, box = geom_axes(model, geom), model.geom_aabb[geom]
            middle, reach = model.geom_pos[geom] + axes @ box[:3], np.abs(axes) @ box[3:]
            low, high = np.minimum(low, middle - reach), np.maximum(high, middle + reach)
        high[2] = 0.0
        for geom in hard:
            geom.contype = geom.conaffinity = 0
        middle, halves = (low + high) / 2, (high - low) / 2
        name = _sole_name(foot.name)
        foot.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=middle, size=halves, mass=0.0,
            conaffinity=1, group=3, friction=hard[0].friction,
        )  # fmt: skip
        foot.add_site(name=name, pos=middle, size=[halves[2], 0.0, 0.0], group=5)


def _sole_name(foot: str) -> str:
    return f"{foot} sole"


def _add_motor(spec: mujoco.MjSpec, joint: mujoco.MjsJoint, motor: Motor) -> None:
    joint.armature, joint.damping, joint.frictionloss = motor.inertia, [0, 0, 0], 0.0
    joint.actfrclimited = 0  # by the motor's own range, which varies with its strength
    servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=motor.stiffness, kv=motor.damping)
    servo.forcelimited, servo.forcerange = True, [-motor.torque, motor.torque]


def _to_body(qpos: np.ndarray, vector: Any) -> tuple[Any, Any, Any]:
    """Rotate a vector of the world's frame into that of the trunk."""
    w, x, y, z = qpos[:, 3:7].T
    a, b, c = vector
    p, q, r = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return (
        a - w * p + (y * r - z * q),
        b - w * q + (z * p - x * r),
        c - w * r + (x * q - y * p),
    )


def _draw(random: np.random.Generator, low: float, high: float) -> float:
    """Draw from a range; one of a single value draws nothing, so that seeds keep their meaning."""
    return random.uniform(low, high) if low < high else low


def _exp(values: np.ndarray) -> np.ndarray:
    """Return the exponential; `np.exp` differs in the last bit between short and long arrays."""
    return np.array([math.exp(value) for value in values.tolist()])
