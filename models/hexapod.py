"""A six-legged robot with two joints in each leg."""

from typing import Any

import mujoco
import numpy as np

from mjgranular.models.link import LEGGED, add_part, add_servo, robot_scene

LEGS = ("front_left", "middle_left", "rear_left", "front_right", "middle_right", "rear_right")
"""Names of the legs, in the order of their joints and servos."""

_FOOT_MASS = 0.01  # mass of a hollow ball [kg]; chosen


class Hexapod:
    """A box on six legs, each with a hip that swings it back and forth and a knee that lifts it.

    All sizes and masses are chosen, not measured: those of a desktop robot with hobby servos. Body
    `torso` has x forward, y to the left, z up. Joints are `<leg>_swing`, positive as the foot moves
    forward on either side, and `<leg>_lift`, positive as it moves up. Parts do not collide.

    The joint torque is the servo's, up to its stall torque in both directions, minus `torque /
    speed` times the joint's speed: the line from stall torque to no-load speed of a DC motor.
    """

    length, width, height = 0.36, 0.16, 0.06  # of the torso [m]
    upper = 0.07  # length of the upper leg, outward from the torso [m]
    lower = 0.12  # length of the lower leg, downward [m]
    thickness = 0.024  # diameter of the legs [m]
    foot = 0.025  # radius of the ball at the end of a leg [m]
    torso_mass = 1.5  # with battery and electronics [kg]
    leg_mass = 0.15  # most of it in the servo at the knee [kg]
    swing, lift = 0.6, 0.6  # largest commanded angles of hip and knee, in both directions [rad]
    stiffness = 12.0  # gain of a servo [N m/rad]
    torque = 1.5  # stall torque of a servo [N m]
    speed = 6.0  # no-load speed of a servo [rad/s]
    armature = 2e-3  # inertia of a servo's rotor, at the joint [kg m^2]

    @property
    def standing(self) -> float:
        """Height of the torso's center when the feet are at z = 0, all angles zero [m]."""
        return self.lower + self.foot

    def spec(self, timestep: float) -> mujoco.MjSpec:
        """Return an editable model, with a floor at z = 0, at a time step [s]."""
        spec = robot_scene("hexapod", timestep, LEGGED)
        torso = spec.worldbody.add_body(name="torso", pos=[0, 0, self.standing])
        torso.add_freejoint(name="root")
        halves = [self.length / 2, self.width / 2, self.height / 2]
        add_part(torso, "torso", "box", size=halves, mass=self.torso_mass, material="shell")
        for number, leg in enumerate(LEGS):
            self._add_leg(spec, torso, leg, along=1 - number % 3, side=1 if number < 3 else -1)
        return spec

    def start(self) -> np.ndarray:
        """Return `qpos` on the floor, all angles zero."""
        qpos = np.zeros(19)
        qpos[2], qpos[3] = self.standing, 1.0
        return qpos

    def _add_leg(
        self, spec: mujoco.MjSpec, torso: mujoco.MjsBody, leg: str, *, along: int, side: int
    ) -> None:
        radius = self.thickness / 2
        place = [along * (self.length / 2 - radius), side * self.width / 2, 0]
        hip = torso.add_body(name=f"{leg}_hip", pos=place)
        knee = hip.add_body(name=f"{leg}_knee", pos=[0, side * self.upper, 0])
        for body, name, axis, share, end, limit in (
            (hip, "swing", [0, 0, -side], 0.3, [0, side * self.upper, 0], self.swing),
            (knee, "lift", [side, 0, 0], 0.7, [0, 0, -self.lower], self.lift),
        ):
            body.add_joint(
                name=f"{leg}_{name}",
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=axis,
                damping=[self.torque / self.speed, 0, 0],
                armature=self.armature,
            )
            look: dict[str, Any] = {"mass": share * self.leg_mass, "material": "leg"}
            geom = add_part(body, f"{leg}_{name}", "capsule", size=[radius, 0, 0], **look)
            geom.fromto = [0, 0, 0, *end]
            if body is knee:
                look["mass"] = _FOOT_MASS
                add_part(body, f"{leg}_foot", "sphere", size=[self.foot, 0, 0], pos=end, **look)
            add_servo(spec, f"{leg}_{name}", self.stiffness, limit, self.torque)
