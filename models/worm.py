"""A worm: a chain of thick links with servos at its joints, for robots that swim and crawl."""

import math
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from mjgranular._util.checks import check_count, check_finite
from mjgranular.errors import InputError
from mjgranular.models.link import DARK, Link, add_part, add_servo, robot_scene


@dataclass(frozen=True)
class Worm:
    """Equal links, each a capsule that extends past its joints, bent by position servos.

    The round ends of the capsules overlap, so that the sand meets a smooth body. Mass and moments
    of inertia are those of a cylinder of the body's length and width, cut into links.

    A level worm moves only in the level plane at a depth; its joints turn about z. An upright one
    moves in the plane y = 0, and its joints turn about -y. Both have their head in front, at +x.
    The tree of bodies begins at the middle link, whose center moves on slides `x` and `y` or `z`
    and turns by `q0`; a joint `qi` between links i - 1 and i, counted from the head, is the angle
    of the latter relative to the former. A time step moves the root along a straight line and all
    else about it: with the root in the middle the errors of both halves cancel, while with the root
    at the head they drive the whole worm one way.

    The joint torque is the servo's, up to its stall torque in both directions, minus `torque /
    speed` times the joint's speed: the line from stall torque to no-load speed of a DC motor. All
    values are chosen; a level worm can swim with them, and they exceed those of real servos.
    """

    count: int = 7  # number of links
    length: float = 0.12  # length of the body [m]
    width: float = 0.016  # width of the body [m]
    density: float = 1100.0  # density of the body [kg/m^3]
    posture: Literal["level", "upright"] = "level"
    depth: float = 0.048  # depth of the axis of a level worm [m]
    bend: float = 1.0  # largest commanded servo angle in both directions [rad]
    stiffness: float = 5.0  # gain of a servo [N m/rad]
    torque: float = 1.0  # stall torque of a servo [N m]
    speed: float = 8.0  # no-load speed of a servo [rad/s]
    armature: float = 1e-4  # inertia of a servo's rotor, at the joint [kg m^2]

    def __post_init__(self) -> None:
        check_count("Worm: count", self.count)
        if self.posture not in ("level", "upright"):
            raise InputError(f"posture must be level or upright, got {self.posture!r}")
        for name in ("length", "width", "density", "bend", "stiffness", "torque", "speed"):
            check_finite(f"the worm's {name}", getattr(self, name), positive=True)

    @property
    def step(self) -> float:
        """Length of a link [m]."""
        return self.length / self.count

    @property
    def root(self) -> int:
        """Index of the root link of the tree of bodies: the middle one."""
        return self.count // 2

    @property
    def order(self) -> tuple[int, ...]:
        """Indices of the joints `q1`, `q2`, ... in `qpos` and `qvel`, from the head to the tail."""
        first = 3  # after the slides and q0; in front of the root the tree goes to the head
        behind = first + self.root
        return (*reversed(range(first, behind)), *range(behind, self.count + 2))

    def spec(self, timestep: float) -> mujoco.MjSpec:
        """Return an editable model, with a floor at z = 0, at a time step [s]."""
        colors = {"skin": (0.72, 0.36, 0.22), "head": DARK}
        spec = robot_scene("worm", timestep, colors)
        if self.posture == "level":
            for light in spec.lights:  # it lies on the rendered sand
                light.castshadow = False
        middle = self._add_root(spec)
        parent = middle
        for index in reversed(range(self.root)):
            parent = self._add_link(parent, index, ahead=True)
        parent = middle
        for index in range(self.root + 1, self.count):
            parent = self._add_link(parent, index, ahead=False)
        for index in range(1, self.count):
            add_servo(spec, f"q{index}", self.stiffness, self.bend, self.torque)
        return spec

    def straight(self) -> np.ndarray:
        """Return `qpos` of the straight worm along +x; an upright one lies on the floor."""
        qpos = np.zeros(self.count + 2)
        if self.posture == "upright":
            qpos[1], qpos[2] = self.width / 2, -math.pi / 2
        return qpos

    @property
    def _axis(self) -> np.ndarray:
        """Axis of the joints, in a link's frame, whose z points to the head."""
        return np.array([0.0, 1.0 if self.posture == "level" else -1.0, 0.0])

    def _add_root(self, spec: mujoco.MjSpec) -> mujoco.MjsBody:
        body = spec.worldbody.add_body(name=f"link{self.root}")
        if self.posture == "level":
            # The body's x, y, z are the world's y, z, x: the links lie along x.
            body.pos, body.quat = [0, 0, -self.depth], [0.5, 0.5, 0.5, 0.5]
            slides = (("x", (0, 0, 1)), ("y", (1, 0, 0)))
        else:
            slides = (("x", (1, 0, 0)), ("z", (0, 0, 1)))
        for name, axis in slides:
            body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        body.add_joint(name="q0", type=mujoco.mjtJoint.mjJNT_HINGE, axis=self._axis)
        self._fill(body, self.root)
        return body

    def _add_link(self, parent: mujoco.MjsBody, index: int, *, ahead: bool) -> mujoco.MjsBody:
        side = 1 if ahead else -1
        body = parent.add_body(name=f"link{index}", pos=[0, 0, side * self.step])
        body.add_joint(
            name=f"q{index + ahead}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            pos=[0, 0, -side * self.step / 2],
            axis=-side * self._axis,  # the angle of the rear link relative to the one in front
            damping=[self.torque / self.speed, 0, 0],
            armature=self.armature,
        )
        self._fill(body, index)
        return body

    def _fill(self, body: mujoco.MjsBody, index: int) -> None:
        thin = self.step / 2  # a link is slender: a thin one, of the mass of a wide cylinder
        mass = Link(self.step, thin, self.density * (self.width / thin) ** 2).mass
        across = mass * (3 * (self.width / 2) ** 2 + self.step**2) / 12
        body.explicitinertial = True
        body.ipos = [0, 0, 0]  # unset, it would be taken from the body's position
        body.mass, body.inertia = mass, [across, across, mass * self.width**2 / 8]
        size, material = [self.width / 2, self.step / 2, 0], "skin" if index else "head"
        add_part(body, f"link{index}", "capsule", size=size, material=material)
