"""A chain that swims buried in sand: wave efficiency and speed against the amplitude of its wave.

One sine wave runs along the body from head to tail, as in Maladen, Ding, Umbanhowar, Kamor and
Goldman, J. R. Soc. Interface 8, 1332 (2011); along the body it is one wavelength long. Inertia
plays no part: at every instant the body moves so that the sand's force and moment on it vanish.

The body is a chain of capsules. Their round ends lie hidden at the joints, where no grain touches
them, and make no facets (docs/shapes.md); dragged through the sand like the rest they would bring
the efficiency at an amplitude of 0.2 wavelengths from 0.50 down to 0.08. In its place short links
leave gaps on the outer side of each bend: forty of them reach 0.50, twenty 0.48, ten 0.42, seven
0.36.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import root

from mjgranular import Law, Report, Rft3dLaw, Sand, media
from mjgranular.models import Link

LENGTH = 0.12  # of the body [m], about a sandfish's; no result depends on it
SLENDERNESS = 7.5  # length over width, about a sandfish's
DEPTH = 3.0  # of the axis, in widths; chosen: the results change by 1 % from 1 to 4
PERIOD = 4.0  # of the wave [s]; slow enough for the laws to hold, no result depends on it
DENSITY = 50e3  # [kg/m^3]; chosen: heavy, so that explicit friction hardly shakes the links
PUBLISHED = (0.4, 0.6)  # wave efficiency, "about 0.5", at an amplitude of 0.2 wavelengths


@dataclass(frozen=True)
class Stroke:
    """What one cycle of the wave does.

    Attributes:
        speed: way in a cycle, in body lengths; negative if the tail leads.
        efficiency: way in a cycle, in wavelengths: forward speed over wave speed.
        turn: of the body in a cycle [rad].
        imbalance: greatest net force that was left, over the sum of what each link meets.
    """

    speed: float
    efficiency: float
    turn: float
    imbalance: float


class Wave:
    """A chain laid on a sine curve, one wavelength from end to end.

    Args:
        ratio: amplitude over wavelength.
        links: number of links.
    """

    def __init__(self, ratio: float, links: int) -> None:
        self.x = np.linspace(-1.0, 3.0, 40001)  # in wavelengths
        self.y = ratio * np.sin(2 * math.pi * self.x)
        steps = np.hypot(np.diff(self.x), np.diff(self.y))
        self.arc = np.concatenate([[0.0], np.cumsum(steps)])
        turn = self.arc[-1] / 4  # length of one wave's arc
        self.arc = self.arc / turn - 1  # 0 at x = 0, 1 at x = 1
        self.length = float(LENGTH / turn)  # wavelength [m]
        self.joints = np.linspace(1.0, 0.0, links + 1)  # head first

    def angles(self, phase: float) -> np.ndarray:
        """Angles of the links from the x axis [rad] when the head is `phase` waves along."""
        s = self.joints + phase % 1.0
        x, y = np.interp(s, self.arc, self.x), np.interp(s, self.arc, self.y)
        return np.arctan2(-np.diff(y), -np.diff(x))

    def rates(self, phase: float) -> np.ndarray:
        """Derivatives of the angles by the phase [rad]."""
        h = 1e-3
        return (self.angles(phase + h) - self.angles(phase - h)) / (2 * h)


def chain(links: int) -> mujoco.MjSpec:
    """A chain along x, the first link ahead, that moves in the level plane at its depth.

    Its capsules are wider than long, each around a whole link and past its joints. Mass and
    actuators matter only where somebody steps the model.
    """
    radius, length = LENGTH / SLENDERNESS / 2, LENGTH / links
    rod = Link(length, length / 2, DENSITY * (4 * radius / length) ** 2)  # gives the mass
    spec = mujoco.MjSpec()
    spec.option.timestep = 1e-5
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    parent = spec.worldbody
    for i in range(links):
        body = parent.add_body(name=f"link{i}", pos=[0, 0, -length])
        if i == 0:
            # The body's x, y, z are the world's y, z, x: the links lie along x.
            body.pos, body.quat = [0, 0, -2 * DEPTH * radius], [0.5, 0.5, 0.5, 0.5]
            body.add_joint(name="x", type=slide, axis=[0, 0, 1])
            body.add_joint(name="y", type=slide, axis=[1, 0, 0])
        joint = body.add_joint(name=f"q{i}", type=hinge, axis=[0, 1, 0])
        if i > 0:
            joint.pos = [0, 0, length / 2]
            servo = spec.add_actuator(target=f"q{i}", trntype=mujoco.mjtTrn.mjTRN_JOINT)
            servo.set_to_position(kp=50.0, kv=0.5)
        body.explicitinertial, body.ipos, body.mass = True, [0, 0, 0], rod.mass
        body.inertia = [rod.inertia, rod.inertia, rod.mass * rod.diameter**2 / 8]
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[radius, length / 2, 0.0], contype=0)
        parent = body
    return spec


class Swimmer:
    """A buried chain in a level plane.

    Args:
        links: number of links.
        resolution: how finely each is cut; None for the default.
        medium: a medium's name.
        law: a law, or its name.
    """

    def __init__(
        self,
        *,
        links: int = 20,
        resolution: int | None = None,
        medium: str = "quikrete_medium",
        law: str | Law = "rft3d",
    ) -> None:
        self.links = links
        self.model = chain(links).compile()
        self.data = mujoco.MjData(self.model)
        # Explicit: the forces are those of the state at hand.
        self.sand = Sand(
            self.model, medium=medium, law=law, resolution=resolution, scheme="explicit"
        )

    def swim(self, ratio: float, *, phases: int = 16, backwards: bool = False) -> Stroke:
        """Follows one cycle; motions are by cycle, not by second.

        Args:
            ratio: amplitude over wavelength.
            phases: steps of the cycle.
            backwards: let the wave run from tail to head.
        """
        wave, sense = Wave(ratio, self.links), -1.0 if backwards else 1.0
        motion = np.zeros((phases + 1, 3))  # of the head, and of the wave's x axis
        imbalance = 0.0
        for i in range(phases):
            phase = sense * i / phases
            angle, rate = wave.angles(phase), sense * wave.rates(phase)
            # Half way between a wave that stands in the sand and a body that does.
            half = sense * np.array(
                [
                    LENGTH * math.cos(angle[0]) - wave.length / 2,
                    LENGTH * math.sin(angle[0]),
                    0.0,
                ]
            )
            guesses = (half, motion[i - 1]) if i else (half,)
            motion[i], left = self.balance(angle, rate, guesses)
            imbalance = max(imbalance, left)
            if imbalance > 0.05:
                raise RuntimeError(f"no balance of forces at A/lambda = {ratio}, phase {phase}")
        motion[-1] = motion[0]
        turn = np.concatenate([[0.0], np.cumsum(motion[1:, 2] + motion[:-1, 2])]) / (2 * phases)
        c, s = np.cos(turn), np.sin(turn)
        ahead = (c * motion[:, 0] - s * motion[:, 1])[:-1].mean()
        aside = (s * motion[:, 0] + c * motion[:, 1])[:-1].mean()
        # The body yaws to and fro, so that its way is at some angle to the wave's first x axis.
        way = float(np.copysign(np.hypot(ahead, aside), ahead))
        return Stroke(
            speed=way / LENGTH,
            efficiency=way / wave.length,
            turn=float(turn[-1]),
            imbalance=imbalance,
        )

    def balance(
        self, angle: np.ndarray, rate: np.ndarray, guesses: tuple[np.ndarray, ...]
    ) -> tuple[np.ndarray, float]:
        """The motion in which the sand's forces on the body cancel.

        Args:
            angle: of the links from the x axis [rad], shape (links,).
            rate: at which the wave changes them [rad/cycle].
            guesses: motions to start from.

        Returns:
            Motion of the first link's centre [m/cycle] and turn of the body [rad/cycle], shape
            (3,), and the net force left over the sum of what each link meets.
        """
        unit = np.array([LENGTH, LENGTH, 1.0])
        best = (np.zeros(3), math.inf)

        def residual(motion: np.ndarray) -> np.ndarray:
            net, total = self.resistance(angle, rate, motion * unit)
            return net / total

        for guess in guesses:
            solution = root(residual, guess / unit, tol=1e-6)
            left = float(np.abs(solution.fun).max())
            if left < best[1]:
                best = (solution.x * unit, left)
        return best

    def resistance(
        self, angle: np.ndarray, rate: np.ndarray, motion: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Net force x, y and moment over half the body's length [N], and the sum of sizes [N]."""
        model, data = self.model, self.data
        self.place(angle, rate, motion)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        self.sand.apply(data)
        force = data.xfrc_applied[1:]
        x, y = (data.xipos[1:, :2] - data.xipos[1:, :2].mean(axis=0)).T
        moment = (force[:, 5] + x * force[:, 1] - y * force[:, 0]).sum()
        net = np.array([*force[:, :2].sum(axis=0), moment / (LENGTH / 2)])
        return net, float(np.linalg.norm(force[:, :2], axis=1).sum())

    def place(self, angle: np.ndarray, rate: np.ndarray, motion: np.ndarray) -> None:
        """Gives the body that shape and motion."""
        self.data.qpos[:] = 0.0, 0.0, angle[0], *np.diff(angle)
        speeds = np.array([*motion[:2], rate[0] + motion[2], *np.diff(rate)])
        self.data.qvel[:] = speeds / PERIOD

    def report(self) -> Report:
        """The sand's forces in the present shape and motion."""
        return self.sand.report(self.data)


def main() -> None:
    """Draws the figure and prints the numbers in it."""
    from matplotlib import pyplot as plt
    from style import BLUE, GREY, ORANGE, SAND, save

    ratios = np.linspace(0.05, 0.4, 15)
    rft3d = Rft3dLaw.from_medium(media["quikrete_medium"])
    friction = f"$\\mu_s$ = {rft3d.surface_friction:g}"
    series: tuple[tuple[str, str, str, dict[str, Any]], ...] = (
        (f"3D RFT, {friction} (preset)", BLUE, "-", {}),
        ("3D RFT, $\\mu_s$ = 0.2", BLUE, "--", {"law": replace(rft3d, surface_friction=0.2)}),
        ("3D RFT, $\\mu_s$ = 0.6", BLUE, ":", {"law": replace(rft3d, surface_friction=0.6)}),
        ("2D RFT, split for 3D", ORANGE, "-", {"medium": "glass_beads", "law": "rft2d"}),
    )
    figure, axes = plt.subplots(1, 2, figsize=(8.6, 3.7), sharex=True)
    for label, colour, line, options in series:
        swimmer = Swimmer(links=40, resolution=24, **options)
        strokes = [swimmer.swim(ratio) for ratio in ratios]
        efficiency = [stroke.efficiency for stroke in strokes]
        speed = [stroke.speed for stroke in strokes]
        axes[0].plot(ratios, efficiency, color=colour, ls=line, label=label)
        axes[1].plot(ratios, speed, color=colour, ls=line)
        best = int(np.argmax(speed))
        axes[1].plot(ratios[best], speed[best], "o", color=colour, ms=5)
        print(
            f"{label}: efficiency at 0.2 {np.interp(0.2, ratios, efficiency):.3f}, "
            f"speed there {np.interp(0.2, ratios, speed):.3f}, "
            f"best {speed[best]:.3f} at {ratios[best]:.3f}, "
            f"imbalance {max(stroke.imbalance for stroke in strokes):.4f}"
        )
    low, high = PUBLISHED
    axes[0].fill_between([0.175, 0.225], low, high, color=SAND, label="published: about 0.5")
    axes[1].axvspan(0.175, 0.225, color=SAND, label="published: fastest near 0.2")
    axes[1].plot([], [], "o", color=GREY, ms=5, label="fastest")
    axes[0].set(ylabel="forward speed / wave speed [-]", ylim=(0, 1))
    axes[1].set(ylabel="forward speed [body lengths / cycle]", ylim=(0, 0.75))
    axes[0].set_title("wave efficiency")
    axes[1].set_title("speed of a body one wavelength long")
    for axis, place in zip(axes, ("upper left", "upper right"), strict=True):
        axis.set(xlabel="amplitude / wavelength [-]", xlim=(0.04, 0.41))
        axis.legend(loc=place, fontsize=8)
    save(figure, "swimming")


if __name__ == "__main__":
    main()
