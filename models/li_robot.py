"""The six-legged robot of Li, Zhang and Goldman, with measured speeds on poppy seed."""

import math
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from mjgranular._util.checks import is_finite
from mjgranular.errors import InputError
from mjgranular.models.link import LEGGED, add_part, robot_scene

HIPS = (-0.05, 0.0, 0.05)
"""Positions of the hips along the body [m]; not published, chosen from the drawing of Li et al."""

_PIECES = 16  # straight pieces of an arc; chosen
_TALL = 0.01  # height of the body [m]; chosen, not measured
_APART = 0.02  # distance of the legs' centers from the body's, along y [m]; chosen
_LEG_MASS = 1e-5  # [kg]; the published mass is assigned to the body
# Motors, so that they keep their rate: inertia of a rotor [kg m^2], torque over the error of the
# rate [N m s/rad]. Chosen.
_ROTOR, _GAIN = 1e-2, 100.0


@dataclass(frozen=True)
class LiRobot:
    """A robot with six legs that turn at a constant rate, in alternating tripods, in a plane.

    Li, Zhang and Goldman (Science 339, 1408, 2013, supplement) measured the speeds of this robot on
    loosely packed poppy seed, with seven legs of different curvature.

    Body `body` moves in the plane y = 0: its joints are the slides `x`, forward, and `z`, up, and
    the hinge `pitch` about y. Joints and motors `front_left` to `rear_right` turn the legs about y;
    the control of a motor is the leg's rate [rad/s]. A leg at angle 0 hangs down from its hip, and
    moves backward as it turns. Parts of the robot do not collide with each other.

    The positions of the hips and their distance from the belly are not published. They are assumed
    at `HIPS` along the body and at the height of the belly.

    Attributes:
        curvature: of the legs, half the chord over the radius of the arc: 1 is a semicircle that
            bulges in the direction of motion in the sand, 0 straight, -1 the reversed semicircle.

    Raises:
        InputError: a curvature outside its range.
    """

    length: ClassVar[float] = 0.13  # of the body [m]
    width: ClassVar[float] = 0.02  # of the belly [m]
    mass: ClassVar[float] = 0.15  # of the robot [kg]
    inertia: ClassVar[float] = 2.08e-4  # about the pitch axis, through the center of mass [kg m^2]
    chord: ClassVar[float] = 0.041  # from hip to tip of a leg [m]
    leg_width: ClassVar[float] = 0.01  # along y [m]
    thickness: ClassVar[float] = 0.003  # of a leg [m]

    curvature: float = 1.0

    def __post_init__(self) -> None:
        if not (is_finite(self.curvature) and abs(self.curvature) <= 1):
            raise InputError(f"the legs' curvature must be from -1 to 1, got {self.curvature}")

    def spec(self, timestep: float = 1e-3) -> mujoco.MjSpec:
        """Build an editable model, with a floor at z = 0."""
        spec = robot_scene("li_robot", timestep, LEGGED)
        body = spec.worldbody.add_body(
            name="body",
            mass=self.mass - 6 * _LEG_MASS,
            inertia=[self.inertia] * 3,
            explicitinertial=True,
        )
        slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(name="x", type=slide, axis=[1, 0, 0])
        body.add_joint(name="z", type=slide, axis=[0, 0, 1])
        body.add_joint(name="pitch", type=hinge, axis=[0, 1, 0])
        halves = [self.length / 2, self.width / 2, _TALL / 2]
        add_part(body, "belly", "box", size=halves, material="shell")
        vertices, faces = self._leg()
        spec.add_mesh(name="leg", uservert=vertices.ravel(), userface=faces.ravel())
        for name, x, side in self._legs():
            leg = body.add_body(name=name, pos=[x, side * _APART, -_TALL / 2])
            leg.add_joint(name=name, type=hinge, axis=[0, 1, 0], armature=_ROTOR)
            add_part(leg, name, "mesh", meshname="leg", mass=_LEG_MASS, material="leg")
            motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.set_to_velocity(kv=_GAIN)
        return spec

    def model(self, timestep: float = 1e-3) -> mujoco.MjModel:
        """Compile the model with a given time step [s]."""
        return self.spec(timestep).compile()

    def start(self, frequency: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return `qpos`, `qvel`, `ctrl`: belly on z = 0, legs turning at a frequency [Hz]."""
        rate = 2 * math.pi * frequency
        # One tripod moves backward as the other moves forward: none starts in the sand.
        sides = [(1 if x == 0 else -1) * side for _, x, side in self._legs()]
        qpos = np.array([0.0, _TALL / 2, 0.0, *(side * math.pi / 2 for side in sides)])
        return qpos, np.array([0.0, 0.0, 0.0, *[rate] * 6]), np.full(6, rate)

    def _legs(self) -> list[tuple[str, float, int]]:
        """Return name, position along the body [m] and side of each leg."""
        names = zip(("rear", "middle", "front"), HIPS, strict=True)
        return [(f"{n}_{s}", x, y) for n, x in names for s, y in (("left", 1), ("right", -1))]

    def _leg(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the vertices [m] and triangles of a leg's mesh, in the frame of its hip."""
        half = math.asin(abs(self.curvature))
        turn = math.copysign(1.0, self.curvature) * half
        s = np.linspace(-1.0, 1.0, (_PIECES if half else 1) + 1)
        # The middle line, and its normal to the side of the bulge of a positive curvature.
        x, z = np.zeros_like(s), s
        if half:
            radius = 1 / self.curvature
            x, z = radius * (np.cos(turn) - np.cos(s * turn)), radius * np.sin(s * turn)
        line = self.chord / 2 * np.stack([x, 0 * s, -1.0 - z], -1)
        normal = np.stack([-np.cos(s * turn), 0 * s, -np.sin(s * turn)], -1)
        out, across = np.array([[1, 1, -1, -1], [-1, 1, 1, -1]])[..., None] / 2
        sides = across * [0, self.leg_width, 0]
        vertices = line[:, None] + out * self.thickness * normal[:, None] + sides
        first, k = 4 * np.arange(len(s) - 1)[:, None], np.arange(4)
        after = (k + 1) % 4
        around = np.stack([first + k, first + 4 + k, first + 4 + after, first + after], axis=-1)
        quads = np.concatenate([[k, 4 * len(s) - 1 - k], around.reshape(-1, 4)])
        return vertices.reshape(-1, 3), quads[:, [2, 1, 0, 3, 2, 0]].reshape(-1, 3)
