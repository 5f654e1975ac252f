"""Writes the sets of what moves sideways from the tables of those who measured it.

    python referee/measured.py FOLDER   # with li2013_legs.csv and its like; writes data/legs_*, ...

Bodies are MJCF files beside the data, with the joints that `mjgranular.referee.runs` names.
"""

from __future__ import annotations

import csv
import json
import math
import sys
from pathlib import Path

import numpy as np
from dem import write_thin
from published import DATA, GRAVITY

from mjgranular.medium.stiffness import FRICTION_CUBIC, LEVEL_PLATE

_LI = (
    "C. Li, T. Zhang, D. I. Goldman, Science 339, 1408 (2013), supplement; transcribed for this "
    "project"
)
_LATE = 0.025  # of travel, beyond which forces on drawn bodies are averaged [m]
_RADIUS = 0.058  # of the wheel [m]


def _table(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / name).open() as file:
        return list(csv.DictReader(file))


def _numbers(folder: Path, name: str) -> np.ndarray:
    return np.loadtxt(folder / name, delimiter=",", skiprows=1)


def _set(
    name: str, medium: str, runs: list[tuple[str, str]], **about: str | dict[str, str]
) -> None:
    """Write `runs.yaml` and `about.json`; all runs are seen unless `fitted` names one."""
    lines = [f"medium: {medium}", "runs:", *(f"  - {{name: {n}, {rest}}}" for n, rest in runs)]
    (DATA / name / "runs.yaml").write_text("\n".join(lines) + "\n")
    fitted = about.pop("fitted", "")
    marks = {n: "fitted to" if n == fitted else "seen" for n, _ in runs}
    content = {"title": about.pop("title"), "source": about.pop("source"), "marks": marks, **about}
    (DATA / name / "about.json").write_text(json.dumps(content, indent=2) + "\n")


def _body(file: Path, content: str, assets: str = "", more: str = "") -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    lines = ["<mujoco>", '<option integrator="implicitfast"/>', f"<asset>{assets}</asset>"]
    lines += ["<worldbody>", content, "</worldbody>", more, "</mujoco>"]
    file.write_text("\n".join(line for line in lines if line) + "\n")


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


_MASS = '<inertial pos="0 0 0" mass="2" diaginertia="2e-3 2e-3 2e-3"/>'


def _slides(axes: str) -> str:
    unit = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
    return "".join(f'<joint name="{a}" type="slide" axis="{unit[a]}"/>' for a in axes)


def legs(folder: Path) -> None:
    """Legs that turn: forces by angle, in two media."""
    rows = _table(folder, "li2013_legs.csv")
    density, friction, level = 2550 * 0.62, math.tan(math.radians(35)), 0.40e6
    scale = level / (LEVEL_PLATE * GRAVITY * density * float(FRICTION_CUBIC(friction)))
    glass = (
        f"{{density: {density:g}, internal_friction: {friction:.4f}, surface_friction: 0.4, "
        f"grain: 0.00027, scale: {scale:.4f}}}"
    )
    for name, medium, key, words in (
        ("legs_poppy", "{base: poppy_seed_loose}", "poppy_LP", "loose poppy seed"),
        ("legs_glass", glass, "glass0.3_CP", "closely packed glass beads of 0.27 mm"),
    ):
        runs = []
        for leg, curvature in (("c_leg", 1.0), ("flat", 0.0), ("reversed_c", -1.0)):
            _body(
                DATA / name / f"{leg}.xml",
                '<body pos="0 0 0.02"><joint name="turn" axis="0 1 0"/>'
                f'{_MASS}<geom type="mesh" mesh="leg"/></body>',
                mesh(curvature, 0.0762, 0.0254, 0.0064),
            )
            keys = ("angle_deg", "Fx_measured_N", "Fz_measured_N")
            found = [
                [float(r[k]) for k in keys] for r in rows if (r["medium"], r["leg"]) == (key, leg)
            ]
            titles = ["angle [deg]", "force [N]", "lift [N]"]
            write_thin(DATA / name / f"{leg}.csv", titles, np.array(found), [])
            runs.append(
                (leg, f"kind: turn, body: {{file: {leg}.xml}}, speed: 0.2, data: {leg}.csv")
            )
        _set(
            *(name, medium, runs),
            title=f"Legs that turn about a hip 2 cm above {words}",
            source=f"{_LI}: leg of 7.62 x 2.54 x 0.64 cm, 0.2 rad/s",
            doubts="of the glass: density from 2.5 to 2.6 g/cm^3 and packing 0.62, friction from "
            "its angle of repose (35 degrees), stiffness from the measured stress under a level "
            "plate (Table S3, 0.40 N/cm^3), friction of the leg chosen"
            if "glass" in name
            else "constants are those of the package",
        )


def drawn(folder: Path) -> None:
    """Bodies drawn through simulated grains; strength from a push in the same bed."""
    plate = "body: {shape: plate, length: 0.02, diameter: 0.005}"
    for name, roll, friction, push, words in (
        ("drawn", "", 0.35, 0.1, "that roll freely"),
        ("drawn_rough", "roll_", 0.65, 0.2, "that resist rolling"),
    ):
        into = DATA / name
        _body(
            into / "rod.xml",
            f"<body>{_slides('xz')}{_MASS}"
            '<geom type="capsule" size="0.005 0.015" pos="0 0 0.005" euler="90 0 0"/></body>',
        )
        press = _numbers(folder, f"grains_{roll}press_v{push}.csv")
        press = press[press[:, 2] > 0][:, [2, 4]]
        write_thin(into / "press.csv", ["depth [m]", "force [N]"], press, ["force [N]"])
        runs = [("plate pushed", f"kind: intrude, {plate}, speed: {push}, data: press.csv")]
        for run, words_, files, body, depth in (
            ("plate at the surface", "flush", "drag_flush", f"{plate}, angle: 90", 0.02),
            ("plate buried", "buried", "drag_buried", f"{plate}, angle: 90", 0.04),
            ("rod", "rod", "rod_d30", "body: {file: rod.xml}", 0.035),
        ):
            found = []
            for file in sorted(folder.glob(f"grains_{roll}{files}_v*.csv")):
                speed = float(file.stem.rpartition("_v")[2])
                table = _numbers(folder, file.name)
                late = table[table[:, 1] > _LATE]
                fx, fz = late[:, 3], late[:, 4]
                found.append((speed, -fx.mean(), fz.mean(), fx.std()))
            if found:
                titles = ["speed [m/s]", "force [N]", "lift [N]", "spread [N]"]
                write_thin(into / f"{words_}.csv", titles, np.array(found), [])
                runs.append((run, f"kind: drag, {body}, depth: {depth}, data: {words_}.csv"))
        _set(
            name,
            f"{{density: 1469, internal_friction: {friction}, surface_friction: 0.45, "
            "grain: 0.003}",
            runs,
            title=f"DEM, bodies drawn through 30,765 grains of 3 mm {words}",
            source="LAMMPS, made for this project as by referee/dem.py: bed of 160 x 80 x 58 mm, "
            "one slab of grains frozen, forces averaged beyond 25 mm of travel; other speeds, "
            "depths and bodies are kept back",
            fitted="plate pushed",
            doubts="the bed is eight plates long: the heap may not be at its largest; forces vary "
            "by a tenth to a third (`spread`)",
        )


def wheel(folder: Path) -> None:
    """A smooth wheel, driven, braked and dragged at slip angles."""
    into = DATA / "wheel"
    _body(
        into / "wheel.xml",
        f'<body pos="0 0 {_RADIUS}">{_slides("xyz")}<joint name="turn" axis="0 1 0"/>'
        f'{_MASS}<geom type="cylinder" size="{_RADIUS} 0.025" euler="90 0 0"/></body>',
    )
    keys = ("F_longitudinal_N", "F_lateral_N", "F_vertical_N")
    runs = []
    for angle in (0, 45, 90):
        table = []
        for row in _table(folder, "pavlov_smooth_wheel.csv"):
            if float(row["slip_angle_deg"]) == angle:
                along, aside, up = (float(row[key]) for key in keys)
                speed, rim = (1e-3 * float(row[k]) for k in ("carriage_mm_s", "rim_speed_mm_s"))
                depth = -1e-3 * float(row["sinkage_mm"])
                table.append((speed, angle, rim / _RADIUS, depth, along, aside, -up))
        titles = ["speed [m/s]", "angle [deg]", "spin [rad/s]", "depth [m]"]
        titles += ["force [N]", "side force [N]", "lift [N]"]
        write_thin(into / f"angle{angle}.csv", titles, np.array(table), [])
        for kind, words in (("roll", "with its sinkage"), ("sink", "free to sink")):
            rest = f"kind: {kind}, body: {{file: wheel.xml}}, data: angle{angle}.csv"
            runs.append((f"slip angle {angle} deg {words}", rest))
    friction = math.tan(math.radians(29))
    _set(
        "wheel",
        f"{{density: 1330, internal_friction: {friction:.4f}, surface_friction: 0.4}}",
        runs,
        title="A smooth wheel of 58 x 50 mm, locked to slip 0.9, at three slip angles",
        source="C. Pavlov, Carnegie Mellon University, robomechanics/3d-terramechanics (MIT): "
        "means of 3 runs; sand of 1330 kg/m^3 and 29 degrees; wheels with grousers and other "
        "angles are kept back",
        doubts="friction of the wheel and its travel (0.2 m) are chosen; the load is the measured "
        "vertical force, which differs from run to run",
    )


def robot(folder: Path) -> None:
    """The robot of Li 2013 by curvature of its legs."""
    rows = _table(folder, "li2013_robot.csv")
    runs = []
    for curvature in sorted({float(row["curvature R/r"]) for row in rows}):
        legs_ = "".join(
            f'\n<body pos="{x} {0.02 * side} -0.005"><joint axis="0 1 0"/>'
            '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>'
            '<geom type="mesh" mesh="leg" contype="2" conaffinity="0"/></body>'
            for x in (-0.05, 0.0, 0.05)
            for side in (-1, 1)
        )
        name = f"curvature {curvature:g}"
        file = name.replace(" ", "_")
        _body(
            DATA / "robot" / f"{file}.xml",
            f'<body pos="0 0 0.005">{_slides("xz")}<joint name="pitch" axis="0 1 0"/>'
            '<inertial pos="0 0 0" mass="0.15" diaginertia="1e-4 2.08e-4 2.08e-4"/>'
            '<geom type="box" size="0.065 0.01 0.005" contype="2" conaffinity="0"/>'
            f"{legs_}</body>",
            mesh(curvature, 0.041, 0.01, 0.003),
            # The middle leg of one side with the front and hind legs of the other.
            '<keyframe><key qpos="0 0 0 0 3.14159265 3.14159265 0 0 3.14159265"/></keyframe>',
        )
        table = [
            (float(r["frequency_Hz"]), 1e-2 * float(r["speed_cm_s"]), 1e-2 * float(r["sd_cm_s"]))
            for r in rows
            if float(r["curvature R/r"]) == curvature
        ]
        titles = ["rate [Hz]", "speed [m/s]", "spread [m/s]"]
        write_thin(DATA / "robot" / f"{file}.csv", titles, np.array(table), [])
        runs.append((name, f"kind: walk, body: {{file: {file}.xml}}, data: {file}.csv"))
    _set(
        *("robot", "{base: poppy_seed_loose}", runs),
        title="A robot of six legs on loose poppy seed: speed by rate and curvature of the legs",
        source=f"{_LI}: 13 cm, 150 g, alternating tripod, mean of 3 trials; four more curvatures "
        "are kept back",
        doubts="not printed: places of the hips (assumed at -5, 0 and 5 cm, at the height of the "
        "belly; 5 mm change the mean error by 1 to 3 points), height of the body (1 cm chosen)",
    )


if __name__ == "__main__":
    for write in (legs, drawn, wheel, robot):
        write(Path(sys.argv[1]))
