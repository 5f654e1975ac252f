"""Score a law against what moves sideways: legs that turn, drawn bodies, a robot, a wheel.

    python referee/sideways.py [--law SPEC]

Nothing is fitted but the strength of drawn bodies, which comes from a push in the same bed.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mjgranular import Explicit, Sand
from mjgranular.law import Law
from mjgranular.medium import Medium, Quantity, get_medium
from mjgranular.medium.presets import FOURIER_KEYS, GENERIC_FOURIER
from mjgranular.medium.stiffness import FRICTION_CUBIC, LEVEL_PLATE
from mjgranular.models import Projectile
from mjgranular.referee import MeasuredRun, Motion, simulate
from mjgranular.sand.material import law_of

DATA = Path("/work/shared/experiments")
GRAVITY = 9.81
Choice = str | Law | None
Vector = tuple[float, float, float]
Force = Callable[[float, float, Vector, float], np.ndarray]
STILL = (0.0, 0.0, 0.0)

LEG = {"length": 0.0762, "width": 0.0254, "thickness": 0.0064}
HIP, RATE = 0.02, 0.2  # height of the hip [m], rate [rad/s]


def rows_of(name: str) -> list[dict[str, str]]:
    """Return the rows of a file of measurements, by column."""
    with (DATA / name).open() as file:
        return list(csv.DictReader(file))


def sand_of(name: str, density: float, friction: float, surface: float, **more: float) -> Medium:
    """Return a medium of known density, friction and, where given, `grain` and `level` stiffness.

    Args:
        name: of the medium.
        density: in bulk [kg/m^3].
        friction: internal, its coefficient.
        surface: friction of the body.
        more: `grain` [m]; `level`: stress over depth under a level plate pushed down [N/m^3].
    """
    published = LEVEL_PLATE * GRAVITY * density * float(FRICTION_CUBIC(friction))
    level = more.get("level", published)
    values = {
        "density": density,
        "internal_friction": friction,
        "surface_friction": surface,
        "scale": level / published,
    }
    given = {key: Quantity(value, "", "referee/sideways.py") for key, value in values.items()}
    generic = dict(zip(FOURIER_KEYS, GENERIC_FOURIER, strict=True)) | {"scale": 1e-6 * level}
    generic = {key: Quantity(value, "", "referee/sideways.py") for key, value in generic.items()}
    return Medium(
        name=name,
        title=name,
        density=given["density"],
        grain=Quantity(more["grain"], "m", "referee/sideways.py") if "grain" in more else None,
        default_law="rft3d_dynamic",
        constants={"rft3d": given, "rft2d": generic},
    )


def mesh(curvature: float, length: float, width: float, thickness: float) -> str:
    """Return the mesh of a leg that hangs down from its hip and bulges toward -x.

    Args:
        curvature: half the chord over the radius of the middle line: 1 for a semicircle, 0 for a
            straight leg, negative for a bulge toward +x.
        length: of the chord from hip to tip [m].
        width: along y [m].
        thickness: [m].
    """
    half = math.asin(abs(curvature))
    pieces = 16 if half else 1
    sides = []
    for side in (1.0, -1.0):  # outer, inner
        if not half:
            sides.append([(-side * thickness / 2, z) for z in (0.0, -length)])
            continue
        radius = length / 2 / abs(curvature)
        r = radius + side * thickness / 2
        middle = math.sqrt(max(radius**2 - length**2 / 4, 0.0))
        turn = np.linspace(half, -half, pieces + 1)
        sign = math.copysign(1.0, curvature)
        sides.append(
            [(-sign * (r * math.cos(t) - middle), -length / 2 + r * math.sin(t)) for t in turn]
        )
    outer, inner = sides
    count = len(outer)
    ring = np.array([*outer, *inner])
    vertices = np.array([(x, y, z) for y in (-width / 2, width / 2) for x, z in ring])
    quads = []
    n = 2 * count
    for i in range(count - 1):
        a, b, c, d = i, i + 1, count + i + 1, count + i
        quads += [(a, b, c, d), (n + a, n + d, n + c, n + b)]
        quads += [(a, n + a, n + b, b), (d, c, n + c, n + d)]
    for a, d in ((0, count), (count - 1, n - 1)):
        quads.append((a, d, n + d, n + a) if a == 0 else (a, n + a, n + d, d))
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    corners = vertices[faces]
    volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    if volume < 0:
        faces = faces[:, ::-1]
    return f'<mesh name="leg" vertex="{_text(vertices)}" face="{_text(faces)}"/>'


def _text(values: np.ndarray) -> str:
    return " ".join(f"{v:.9g}" for v in values.ravel())


def force_on(geom: str, medium: Medium, law: Choice, assets: str = "") -> Force:
    """Return the force on a free body that is led: of place, turn about y, velocity and spin."""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><asset>{assets}</asset><worldbody><body name="it"><freejoint/>'
        f'<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{geom}</body></worldbody></mujoco>'
    )
    sand = Sand(model, medium=medium, law=law, scheme=Explicit(prescribed=True))
    data = mujoco.MjData(model)

    def force(height: float, turn: float, velocity: Vector, spin: float) -> np.ndarray:
        data.qpos[:] = 0.0, 0.0, height, math.cos(turn / 2), 0.0, math.sin(turn / 2), 0.0
        data.qvel[:] = *velocity, 0.0, spin, 0.0
        return sand.report(data).bodies[0].force

    return force


def legs(law: Choice) -> dict[str, float]:
    """Root-mean-square of the error of the force over the greatest, by medium and leg."""
    glass = sand_of(
        *("glass0.3_CP", 2550 * 0.62, math.tan(math.radians(35)), 0.4), grain=0.00027, level=0.40e6
    )
    table = rows_of("li2013_legs.csv")
    found: dict[str, float] = {}
    for medium, sand in {"poppy_LP": get_medium("poppy_seed_loose"), "glass0.3_CP": glass}.items():
        for leg, curvature in {"c_leg": 1.0, "flat": 0.0, "reversed_c": -1.0}.items():
            rows = [r for r in table if r["medium"] == medium and r["leg"] == leg]
            force = force_on('<geom type="mesh" mesh="leg"/>', sand, law, mesh(curvature, **LEG))
            angles = np.radians([float(row["angle_deg"]) for row in rows])
            simulated = np.array([force(HIP, angle, STILL, RATE)[[0, 2]] for angle in angles])
            keys = ("Fx_measured_N", "Fz_measured_N")
            measured = np.array([[float(row[key]) for key in keys] for row in rows])
            error = np.sqrt(((simulated - measured) ** 2).sum(axis=1).mean())
            found[f"{medium} {leg}"] = float(error / np.linalg.norm(measured, axis=1).max())
    return found


BED = (1469.0, 0.45, 0.003)
"""Simulated grains: density [kg/m^3], friction of bodies, diameter [m]."""

PLATE = '<geom type="box" size="0.0025 0.01 0.01"/>'
ROD = '<geom type="capsule" size="0.005 0.015" euler="90 0 0"/>'
DRAWN = {
    "drag_flush_v0.1": (PLATE, 0.01, 0.1),
    "drag_flush_v0.3": (PLATE, 0.01, 0.3),
    "drag_buried_v0.3": (PLATE, 0.03, 0.3),
    "rod_d30_v0.5": (ROD, 0.03, 0.5),
    "roll_drag_flush_v0.3": (PLATE, 0.01, 0.3),
}
"""By name: geom, depth of its middle [m], speed [m/s]."""
LATE = 0.025  # of travel, beyond which forces are averaged [m]


def drawn(law: Choice) -> dict[str, tuple[float, float]]:
    """Resistance and lift of drawn bodies [N] over those in grains, by run."""
    found = {}
    for friction, roll, speed in ((0.35, "", 0.1), (0.65, "roll_", 0.2)):
        density, surface, grain = BED
        medium = sand_of("grains", density, friction, surface, grain=grain)
        table = numbers(f"grains_{roll}press_v{speed}.csv")
        table = table[table[:, 2] > 0]
        push = MeasuredRun(
            *("press", "intrude", Projectile(0.02, 0.005, 1000.0, "plate")),
            Motion(depth=table[:, 2], force=table[:, 4]),
            speed=speed,
        )
        made: Any = law_of(law, medium)
        force = simulate(push, medium, made).force
        assert force is not None
        made = replace(made, scale=made.scale * float((table[:, 4] @ force) / (force @ force)))
        print(f"scale {made.scale:.3f} at friction {friction}")
        for name, (geom, depth, v) in DRAWN.items():
            if name.startswith("roll_") == bool(roll):
                table = numbers(f"grains_{name}.csv")
                late = table[table[:, 1] > LATE]
                fx, _, fz = force_on(geom, medium, made)(-depth, 0.0, (v, 0.0, 0.0), 0.0)
                found[name] = fx / late[:, 3].mean(), fz / late[:, 4].mean()
    return found


def numbers(name: str) -> np.ndarray:
    """Return a file of measurements as numbers."""
    return np.array([[float(cell) for cell in row.values()] for row in rows_of(name)])


RADIUS, WIDTH = 0.058, 0.050  # of the wheel [m]


def wheel(law: Choice) -> dict[str, dict[str, float]]:
    """Forces of a wheel [N] at the measured sinkage and free to sink, and the sinkage [m]."""
    medium = sand_of("pavlov", 1330.0, math.tan(math.radians(29)), WHEEL_FRICTION)
    geom = f'<geom type="cylinder" size="{RADIUS} {WIDTH / 2}" euler="90 0 0"/>'
    force = force_on(geom, medium, law)
    found = {}
    for row in rows_of("pavlov_smooth_wheel.csv"):
        angle = math.radians(float(row["slip_angle_deg"]))
        v, rim = 1e-3 * float(row["carriage_mm_s"]), 1e-3 * float(row["rim_speed_mm_s"])
        velocity, spin = (v * math.cos(angle), v * math.sin(angle), 0.0), rim / RADIUS
        load, sinkage = -float(row["F_vertical_N"]), -1e-3 * float(row["sinkage_mm"])
        measured = np.array([float(row["F_longitudinal_N"]), float(row["F_lateral_N"])])
        settling = (velocity[0], velocity[1], -SETTLES * v)
        fx, fy, fz = force(RADIUS - sinkage, 0.0, settling, spin)

        free, deep = rolled(geom, medium, law, velocity, spin, load)
        name = f"slip {float(row['slip']):+.2f}, {float(row['slip_angle_deg']):.0f} deg"
        size = np.linalg.norm(measured)
        base = max(size, SMALL * load)
        found[name] = {
            "measured": size,
            "vertical": fz / load,
            "horizontal": float(np.hypot(fx, fy) / size),
            "error": float(np.linalg.norm(-np.array([fx, fy]) - measured) / base),
            "free force": float(np.linalg.norm(free) / size),
            "free error": float(np.linalg.norm(free - measured) / base),
            "free sinkage": deep / sinkage,
        }
    return found


SETTLES = 0.01  # sinking over travel where the sinkage is given: skin below leads; chosen
WHEEL_FRICTION = 0.4  # of the wheel; chosen, not measured
SMALL = 0.25  # forces below that part of the load are compared with that part of it; chosen


HEAVY = 1e4  # inertia of what keeps its speed [kg, kg m^2]; chosen
ROLLED, ROLL_STEP = 0.2, 1e-2  # travel [m] and step [s]; half of either changes 3 % at most


def rolled(
    geom: str, medium: Medium, law: Choice, velocity: Vector, spin: float, load: float
) -> tuple[np.ndarray, float]:
    """Return drag along x and y [N] and depth [m] of a wheel that is free to sink under a load."""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{ROLL_STEP}"/><worldbody><body name="it" pos="0 0 {RADIUS}">'
        f'<inertial pos="0 0 0" mass="{load / GRAVITY}" diaginertia="1e-3 1e-3 1e-3"/>'
        f'<joint type="slide" axis="0 0 1"/><joint type="slide" axis="1 0 0" armature="{HEAVY}"/>'
        f'<joint type="slide" axis="0 1 0" armature="{HEAVY}"/>'
        f'<joint axis="0 1 0" armature="{HEAVY}"/>{geom}</body></worldbody></mujoco>'
    )
    sand = Sand(model, medium=medium, law=law, scheme="implicit")
    data = mujoco.MjData(model)
    led = np.array([velocity[0], velocity[1], spin])
    steps = round(ROLLED / math.hypot(*velocity) / ROLL_STEP)
    lost = np.zeros((steps, 2))
    for step in range(steps):
        data.qvel[1:] = led
        sand.step(data)
        lost[step] = led[:2] - data.qvel[1:3]
    drag = HEAVY * lost[-steps // 5 :].mean(axis=0) / ROLL_STEP
    return drag, -float(data.qpos[0])


CHORD, ARC = 0.041, {"width": 0.01, "thickness": 0.003}
BODY = 0.01  # height of the body [m]; chosen, not measured
STEP, WARM, CYCLES = 1e-3, 2, 2


def robot(law: Choice) -> dict[str, tuple[float, float]]:
    """Speed of a hexapod with alternating tripods [m/s]: measured and simulated."""
    rows = rows_of("li2013_robot.csv")
    found = {}
    for curvature in sorted({float(row["curvature R/r"]) for row in rows}):
        walker = _Walker(curvature, law)
        for row in rows:
            if float(row["curvature R/r"]) == curvature:
                frequency = float(row["frequency_Hz"])
                name = f"{curvature:g}, {frequency:g} Hz"
                found[name] = 1e-2 * float(row["speed_cm_s"]), walker.speed(frequency)
    return found


class _Walker:
    """The robot, planar; heavy rotors keep the rate of its legs relative to its body."""

    def __init__(self, curvature: float, law: Choice) -> None:
        parts, geoms = [], ["belly"]
        for i, (x, side) in enumerate((x, side) for x in (-0.05, 0.0, 0.05) for side in (-1, 1)):
            parts.append(
                f'<body name="leg{i}" pos="{x} {side * 0.02} {-BODY / 2}">'
                f'<joint axis="0 1 0" armature="1e3"/><inertial pos="0 0 0" mass="1e-6" '
                f'diaginertia="1e-9 1e-9 1e-9"/><geom name="leg{i}" type="mesh" mesh="leg"/></body>'
            )
            geoms.append(f"leg{i}")
        model = mujoco.MjModel.from_xml_string(
            f'<mujoco><option timestep="{STEP}"/><asset>{mesh(curvature, CHORD, **ARC)}</asset>'
            f'<default><geom contype="0" conaffinity="0"/></default>'
            f'<worldbody><body name="body"><inertial pos="0 0 0" mass="0.15" '
            f'diaginertia="1e-4 2.08e-4 2.08e-4"/><joint type="slide" axis="1 0 0"/>'
            f'<joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/><geom name="belly" type="box" '
            f'size="0.065 0.01 {BODY / 2}"/>{"".join(parts)}</body></worldbody></mujoco>'
        )
        self._sand = Sand(model, medium="poppy_seed_loose", law=law, geoms=geoms)
        self._data = mujoco.MjData(model)

    def speed(self, frequency: float) -> float:
        """Mean over whole turns of the legs, once it is steady [m/s]."""
        data, sand = self._data, self._sand
        mujoco.mj_resetData(self._sand.model, data)
        data.qpos[1] = BODY / 2
        # Middle leg of one side with front and hind leg of the other.
        data.qpos[3:] = np.pi * np.array([0, 1, 1, 0, 0, 1])
        data.qvel[3:] = 2 * math.pi * frequency
        turn = round(1 / frequency / STEP)
        for _ in range(WARM * turn):
            sand.step(data)
        before = data.qpos[0]
        for _ in range(CYCLES * turn):
            sand.step(data)
        return float(data.qpos[0] - before) / (CYCLES * turn * STEP)


def score(law: Choice = "rft3d_dynamic") -> dict[str, Any]:
    """Return all scores of a law, in parts."""
    found: dict[str, Any] = {"legs": legs(law), "drawn": drawn(law), "wheel": wheel(law)}
    found["robot"] = robot(law)
    errors = {
        name: simulated / measured - 1 for name, (measured, simulated) in found["robot"].items()
    }
    cases = list(found["wheel"].values())
    pulls = [abs(x - 1) for x, _ in found["drawn"].values()]
    found["summary"] = {
        "legs": _mean(found["legs"].values()),
        "drawn": _mean(pulls),
        "drawn, worst": max(pulls),
        "robot": _mean(map(abs, errors.values())),
        "robot, bias": _mean(errors.values()),
        "wheel, |ln| of vertical": _mean(abs(math.log(case["vertical"])) for case in cases),
        "wheel, horizontal": _mean(case["error"] for case in cases),
        "wheel free, force": _mean(case["free error"] for case in cases),
        "wheel free, sinkage": _mean(abs(case["free sinkage"] - 1) for case in cases),
    }
    return found


def _mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


def main() -> None:
    """Prints all scores."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--law", default="rft3d_dynamic", help="with its constants, as for Sand")
    found = score(parser.parse_args().law)
    print("\nlegs: rms of the force over the greatest")
    for name, value in found["legs"].items():
        print(f"  {name:24} {value:6.1%}")
    print("\ndrawn through grains: law over grains, resistance and lift")
    for name, (pull, lift) in found["drawn"].items():
        print(f"  {name:24} {pull:6.2f} {lift:6.2f}")
    print("\nwheel: law over measured, at the measured sinkage and free to sink under its load")
    head = ("vertical", "horizontal", "error", "free force", "free error", "free sinkage")
    print(f"  {'':18} {'N':>6}" + "".join(f"{key:>13}" for key in head))
    for name, case in found["wheel"].items():
        line = "".join(f"{case[key]:13.2f}" for key in head)
        print(f"  {name:18} {case['measured']:6.1f}{line}")
    print("\nrobot: measured and simulated speed [cm/s]")
    for name, (measured, simulated) in found["robot"].items():
        error = simulated / measured - 1
        print(f"  {name:18} {100 * measured:6.1f} {100 * simulated:6.1f} {error:+7.1%}")
    print()
    for name, value in found["summary"].items():
        print(f"{name:24} {value:7.1%}")


if __name__ == "__main__":
    main()
