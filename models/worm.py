"""A worm: a chain of thick links with servos at its joints, for robots that swim and crawl."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.models.chain import Chain

Posture = Literal["level", "upright"]


@dataclass(frozen=True)
class Worm:
    """Equal links, each a capsule around itself and past its joints, bent by position servos.

    The capsules' round ends lie hidden in one another: what the sand meets is a smooth body. Mass
    and moments of inertia are those of a cylinder of the body's length and width, cut into links.

    A level worm is free in the level plane at a depth and nowhere else; its joints turn about z. An
    upright one is free in the plane y = 0, and its joints turn about -y. Both have their head
    ahead, at +x; joints are named as `Chain` names them.

    Attributes:
        count: number of links.
        length: of the body [m].
        width: of the body [m].
        density: of the body [kg/m^3].
        posture: "level" or "upright".
        depth: of the axis of a level worm [m].
        bend: greatest angle that a servo is asked for, either way [rad].
        stiffness: gain of a servo [N m/rad]; its torque has no other limit.
        lag: time in which an unloaded servo comes closer by a factor e [s].
        armature: inertia of a servo's rotor, at the joint [kg m^2].

    Raises:
        InputError: a value outside its range.
    """

    count: int = 7
    length: float = 0.12
    width: float = 0.016
    density: float = 1100.0
    posture: Posture = "level"
    depth: float = 0.048
    bend: float = 1.0
    stiffness: float = 5.0
    lag: float = 0.02
    armature: float = 1e-5

    def __post_init__(self) -> None:
        if not isinstance(self.count, int) or isinstance(self.count, bool) or self.count < 1:
            raise InputError(f"a worm has one link or more, not {self.count!r}")
        if self.posture not in get_args(Posture):
            raise InputError(
                f"the worm's posture must be one of {', '.join(get_args(Posture))}, "
                f"not {self.posture!r}"
            )
        for name in ("length", "width", "density", "bend", "stiffness", "lag"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"the worm's {name} must be positive, not {value}")
        if not (math.isfinite(self.depth) and math.isfinite(self.armature) and self.armature >= 0):
            raise InputError(
                "the worm's depth and armature must be finite, the latter not negative"
            )

    @property
    def step(self) -> float:
        """Length of a link [m]."""
        return self.length / self.count

    @property
    def chain(self) -> Chain:
        """The chain that gives joints and servos. Its own rods are thin; the worm's are put on."""
        level = self.posture == "level"
        thin = self.step / 2
        return Chain(
            self.count,
            length=self.step,
            diameter=thin,
            density=self.density * (self.width / thin) ** 2,
            base="level" if level else "free",
            height=-self.depth if level else None,
            actuators="position",
            kp=self.stiffness,
            kv=self.stiffness * self.lag,
        )

    @property
    def mass(self) -> float:
        """Of the body [kg]."""
        return self.chain.mass

    def spec(self, timestep: float) -> mujoco.MjSpec:
        """An editable model, with a floor at z = 0, at a time step [s].

        Args:
            timestep: with the implicit-fast integrator.
        """
        spec = self.chain.spec()
        spec.modelname = "worm"
        spec.comment = "A worm: mjgranular.models.Worm."
        for name in ("bed", "table"):
            spec.delete(spec.geom(name))
        spec.delete(spec.key("start"))
        spec.option.timestep = timestep
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        for light in spec.lights:  # a level worm lies on what is drawn of the sand
            light.castshadow = self.posture == "upright"
        spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[50, 50, 1])
        skin = spec.add_material(name="skin")
        skin.rgba, skin.specular, skin.shininess = [0.72, 0.36, 0.22, 1], 0.3, 0.4
        head = spec.add_material(name="head")
        head.rgba, head.specular, head.shininess = [0.25, 0.27, 0.31, 1], 0.3, 0.4
        for index in range(self.count):
            name = f"link{index}"
            body = spec.body(name)
            spec.delete(spec.geom(name))
            # The thin rod's moment of inertia along its axis would be too small by far.
            link = self.chain.link
            across = link.mass * (3 * (self.width / 2) ** 2 + self.step**2) / 12
            body.inertia = [across, across, link.mass * self.width**2 / 8]
            body.add_geom(
                name=name,
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                size=[self.width / 2, self.step / 2, 0],
                material="skin" if index else "head",
                contype=0,
                conaffinity=1,
            )
            if index:
                spec.joint(f"q{index}").armature = self.armature
                servo = spec.actuator(f"q{index}")
                servo.ctrllimited = True
                servo.ctrlrange = [-self.bend, self.bend]
        return spec

    def straight(self) -> np.ndarray:
        """`qpos` of the straight worm along x, head ahead; an upright one on the floor."""
        if self.posture == "level":
            return np.zeros(self.count + 2)
        qpos = np.zeros(self.count + 2)
        qpos[1], qpos[2] = self.width / 2, -math.pi / 2
        return qpos
