"""Chains of the paper's link: pendulums, free chains, chains on a slide, swimmers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import mujoco
import numpy as np

from mjgranular._util.checks import is_finite
from mjgranular.errors import InputError
from mjgranular.models.link import PAPER_LENGTH, Link, model_path, scale_scenery
from mjgranular.sand.material import LAW_TEXT

Base = Literal["free", "hinge", "slide", "level"]
Actuators = Literal["none", "motor", "position"]

_LEAN = math.pi / 4  # angle of the initial pose, as in link.xml [rad]
_SPEED = 1.0  # initial speed of a free chain, down [m/s]
_ACROSS, _ALONG = (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)  # axes of q (as in link.xml) and of p


@dataclass(frozen=True)
class Chain:
    """Equal slender links, each with a joint at the end of the previous one.

    Bodies `link0`, `link1`, ... have their frame at the center of mass C and their length along z;
    in the vertical plane the chain continues at the pole at -z. Sites `T0`, `T1`, ... are these
    ends. A link ends where the next begins: at the joint between them. Links do not collide with
    one another; they collide with geoms whose contype has bit 0.

    Joints between links are `q1`, `q2`, ... with the sign of the paper's angle: hinges about -y, so
    that the lower end moves to +x for positive angles; spatial chains also have `p1`, `p2`, ...
    about the link's x. Such a pair is a universal joint: it bends both ways and does not twist.
    Unlike for a ball joint, its angles can be read, limited and driven separately; at p = 90
    degrees, q turns the link about its own axis.

    The base holds the first link:

    - "free": slides `x`, `z`, which are the world coordinates of its C, and hinge `q0`; a spatial
      chain has a free joint `root`.
    - "hinge": a pendulum, its upper end hinged (`q0`, spatial also `p0`) at x = y = 0 and `height`.
    - "slide": the same hinge on a vertical slide `z`, the height of the hinge; the carriage has no
      mass.
    - "level": a swimmer, free in the level plane at `height`: slides `x`, `y` of the first link's
      C and `q0`, its angle from the x axis about z. The links lie along x with the first ahead, all
      joints turn about z. It cannot move up or down.

    Stiffness, damping and actuators are those of the joints between links; the base has none.

    Attributes:
        count: number of links n.
        length: L of each link, pole to pole [m].
        diameter: d [m].
        density: density of the rods [kg/m^3]; each has the mass of a cylinder, rho pi d^2/4 L.
        base: what holds the first link.
        height: height of the hinge, or of the level plane, above the sand [m]; None for nine tenths
            of the chain's length, or three diameters below the sand. Not used for other bases.
        spatial: whether joints bend both ways.
        stiffness: stiffness of the joints, straight at rest [N m/rad].
        damping: damping of the joints [N m s/rad].
        actuators: "motor" takes a torque [N m] as control, "position" an angle [rad].
        kp: gain of a position actuator [N m/rad].
        kv: damping of a position actuator [N m s/rad].
        torque: torque limit of an actuator in both directions [N m].

    Raises:
        InputError: a value outside its range, or options that exclude one another.
    """

    count: int = 2
    length: float = 0.2
    diameter: float = 0.01
    density: float = 7700.0
    base: Base = "free"
    height: float | None = None
    spatial: bool = False
    stiffness: float = 0.0
    damping: float = 0.0
    actuators: Actuators = "none"
    kp: float = 1.0
    kv: float = 0.0
    torque: float = math.inf

    def __post_init__(self) -> None:
        if not isinstance(self.count, int) or isinstance(self.count, bool) or self.count < 1:
            raise InputError(f"a chain has one link or more, not {self.count!r}")
        for name, allowed in (("base", get_args(Base)), ("actuators", get_args(Actuators))):
            if getattr(self, name) not in allowed:
                raise InputError(
                    f"the chain's {name} must be one of {', '.join(allowed)}, "
                    f"not {getattr(self, name)!r}"
                )
        for name, unit in (
            ("stiffness", "N m/rad"),
            ("damping", "N m s/rad"),
            ("kp", "N m/rad"),
            ("kv", "N m s/rad"),
        ):
            value = getattr(self, name)
            if not (is_finite(value) and value >= 0):
                raise InputError(
                    f"the chain's {name} must be finite and not negative, not {value} {unit}"
                )
        if not self.torque > 0:
            raise InputError(f"the chain's torque must be positive, not {self.torque} N m")
        if self.height is not None:
            if self.base not in ("hinge", "level"):
                raise InputError(f"a chain with base {self.base!r} has no height; its joints say")
            if not is_finite(self.height):
                raise InputError(f"the chain's height must be finite, not {self.height} m")
        if self.spatial and self.base == "level":
            raise InputError("a chain with base 'level' stays in its plane: it cannot be spatial")
        _ = self.link  # checks the sizes

    @property
    def link(self) -> Link:
        """One of the links."""
        return Link(self.length, self.diameter, self.density)

    @property
    def reach(self) -> float:
        """Length of the straight chain, n L [m]."""
        return self.count * self.length

    @property
    def mass(self) -> float:
        """Mass of all links [kg]."""
        return self.count * self.link.mass

    @property
    def base_height(self) -> float:
        """Height of the hinge or of the level plane above the sand [m]; 0 for other bases."""
        if self.height is not None:
            return self.height
        return {"hinge": 0.9 * self.reach, "level": -3 * self.diameter}.get(self.base, 0.0)

    def spec(self) -> mujoco.MjSpec:
        """Return an editable model: `link.xml` with this chain, scenery scaled with its length.

        Key frame `start`: the straight chain at 45 degrees, as placed by `posed`; a free one moves
        down at 1 m/s.
        """
        spec = mujoco.MjSpec.from_file(str(model_path("link")))
        spec.modelname = "chain"
        spec.comment = "A chain of slender links: mjgranular.models.Chain."
        spec.delete(spec.body("link"))
        spec.delete(spec.key("impact"))
        spec.delete(spec.text(LAW_TEXT))
        self._set_scenery(spec)
        parent = spec.worldbody
        for index in range(self.count):
            parent = self._add_link(parent, index)
        if self.actuators != "none":
            self._add_actuators(spec)
        level = self.base == "level"
        angles = [0.0 if level else _LEAN] * self.count
        qpos = self.posed(angles)
        # A free joint has one velocity less than positions.
        qvel = np.zeros(len(qpos) - (self.spatial and self.base == "free"))
        if self.base == "free":
            qvel[2 if self.spatial else 1] = -_SPEED
        spec.add_key(name="start", qpos=qpos.tolist(), qvel=qvel.tolist())
        return spec

    def model(self, timestep: float) -> mujoco.MjModel:
        """Return the compiled model with a given time step [s]."""
        spec = self.spec()
        spec.option.timestep = timestep
        return spec.compile()

    def posed(self, angles: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return `qpos` for given angles of the links, in the plane y = 0.

        The lowest end of a free chain is at the origin, that of a chain on a slide is on the
        surface; with a hinge or in the level plane the base fixes the position.

        Args:
            angles: angle of each link from the vertical, positive with the lower end toward +x;
                with base "level" from the x axis, counterclockwise [rad].
        """
        angle = np.asarray(angles, float)
        if angle.shape != (self.count,):
            raise InputError(
                f"a chain of {self.count} links needs as many angles, not {angle.size}"
            )
        bends = np.diff(angle)
        if self.spatial:
            bends = np.stack([bends, np.zeros_like(bends)], axis=1).ravel()
        # Ends of the links relative to the upper end of the first, x and z.
        steps = self.length * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
        ends = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
        lowest = ends[np.argmin(ends[:, 1])]
        x, z = ends[:2].mean(axis=0) - lowest  # of the first link's C
        first = [angle[0], 0.0] if self.spatial else [angle[0]]
        if self.base == "level":
            base = [0.0, 0.0, angle[0]]
        elif self.base == "hinge":
            base = first
        elif self.base == "slide":
            base = [-lowest[1], *first]
        elif self.spatial:  # a turn by the angle about -y
            half = angle[0] / 2
            base = [x, 0.0, z, math.cos(half), 0.0, -math.sin(half), 0.0]
        else:
            base = [x, z, angle[0]]
        return np.array([*base, *bends])

    def _add_link(self, parent: mujoco.MjsBody, index: int) -> mujoco.MjsBody:
        half, radius = self.length / 2, self.diameter / 2
        body = parent.add_body(name=f"link{index}")
        if index == 0:
            self._add_base(body)
        else:
            body.pos = [0, 0, -self.length]
            self._add_hinges(
                body, index, stiffness=[self.stiffness, 0, 0], damping=[self.damping, 0, 0]
            )
        link = self.link
        body.explicitinertial = True
        body.ipos = [0, 0, 0]  # unset, it would be taken from the body's position
        body.mass = link.mass
        body.inertia = [link.inertia, link.inertia, link.mass * self.diameter**2 / 8]
        body.add_geom(
            name=f"link{index}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=[radius, half - radius, 0],
            material="steel",
            contype=0,  # with conaffinity alone, links do not collide with each other
            conaffinity=1,
        )
        end = body.add_site(name=f"T{index}", pos=[0, 0, -half], group=4)
        end.size[0] = 0.4 * radius
        return body

    def _add_base(self, body: mujoco.MjsBody) -> None:
        def slide(name: str, axis: tuple[float, float, float]) -> None:
            body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)

        if self.base == "level":
            # The body's x, y, z are the world's y, z, x: the links lie along x.
            body.pos = [0, 0, self.base_height]
            body.quat = [0.5, 0.5, 0.5, 0.5]
            slide("x", (0, 0, 1))
            slide("y", (1, 0, 0))
            body.add_joint(name="q0", type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0, 1, 0))
        elif self.base == "free" and self.spatial:
            body.add_freejoint(name="root")
        elif self.base == "free":
            slide("x", (1, 0, 0))
            slide("z", (0, 0, 1))
            body.add_joint(name="q0", type=mujoco.mjtJoint.mjJNT_HINGE, axis=_ACROSS)
        else:
            body.pos = [0, 0, self.base_height - self.length / 2]
            if self.base == "slide":
                slide("z", (0, 0, 1))
            self._add_hinges(body, 0)
            pivot = body.add_site(name="pivot", pos=[0, 0, self.length / 2], material="table")
            pivot.size[0] = 0.7 * self.diameter

    def _add_hinges(self, body: mujoco.MjsBody, index: int, **options: list[float]) -> None:
        """Add hinges at the link's upper end."""
        across = (0.0, 1.0, 0.0) if self.base == "level" else _ACROSS
        for name, axis in (("q", across), ("p", _ALONG))[: 1 + self.spatial]:
            body.add_joint(
                name=f"{name}{index}",
                type=mujoco.mjtJoint.mjJNT_HINGE,
                pos=[0, 0, self.length / 2],
                axis=axis,
                **options,
            )

    def _add_actuators(self, spec: mujoco.MjSpec) -> None:
        for index in range(1, self.count):
            for name in ("q", "p")[: 1 + self.spatial]:
                actuator = spec.add_actuator(
                    name=f"{name}{index}",
                    target=f"{name}{index}",
                    trntype=mujoco.mjtTrn.mjTRN_JOINT,
                )
                if self.actuators == "motor":
                    actuator.set_to_motor()
                else:
                    actuator.set_to_position(kp=self.kp, kv=self.kv)
                if is_finite(self.torque):
                    actuator.forcelimited = True
                    actuator.forcerange = [-self.torque, self.torque]
                    if self.actuators == "motor":
                        actuator.ctrllimited = True
                        actuator.ctrlrange = [-self.torque, self.torque]

    def _set_scenery(self, spec: mujoco.MjSpec) -> None:
        scale_scenery(spec, self.reach / PAPER_LENGTH)
        # A cut along the plane of motion, as in link.xml; a spatial chain has none.
        bed, gap = spec.geom("bed"), 0.55 * self.diameter
        back = bed.pos[1] + bed.size[1]
        if self.spatial or self.base == "level":
            bed.pos[1], bed.size[1] = 0, back
        else:
            bed.pos[1], bed.size[1] = (back + gap) / 2, (back - gap) / 2
        if self.base == "level":  # a cut there too: the chain lies on it
            spec.geom("table").pos[2] += self.base_height - gap
            bed.pos[2] += self.base_height - gap
        for camera in spec.cameras:
            if self.base == "level":  # the first link's C is at the origin, the others behind
                camera.pos[0] -= self.reach / 2
            elif self.base != "free":
                camera.pos[0] += 0.2 * self.reach  # it swings to both sides
                camera.pos[2] += 0.3 * self.reach
        if self.base == "level":
            self._look_down(spec)

    def _look_down(self, spec: mujoco.MjSpec) -> None:
        for name, distance in (("side", 3.0), ("close", 1.5)):
            camera = spec.camera(name)
            camera.pos = [
                -self.reach / 2,
                -0.6 * distance * self.reach,
                0.8 * distance * self.reach + self.base_height,
            ]
            camera.alt.xyaxes = [1, 0, 0, 0, 0.8, 0.6]
