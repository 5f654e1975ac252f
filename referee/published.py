"""Write the published sets: formulas and tables of papers, as runs.

    python referee/published.py        # writes data/katsuragi_durian, paper_link, plates, quikrete

These are results of the papers' laws with their published constants, not raw measurements, which
they show only in figures. Drops are integrated here, with separate code for rods and spheres,
without mjgranular.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from dem import write_thin

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "referee" / "data"
GRAVITY = 9.81


def solve(
    slope: Callable[[np.ndarray], np.ndarray], state: np.ndarray, step: float, moving: int
) -> np.ndarray:
    """Integrate with fourth-order Runge-Kutta until the velocity `moving` is no longer positive.

    Returns:
        Rows of time and state; the last step is shortened so that it ends at the stop.
    """
    rows, time = [np.concatenate([[0.0], state])], 0.0
    while True:
        h = step
        after = _step(slope, state, h)
        if after[moving] <= 0:
            for _ in range(60):  # bisection of the step
                h = h / 2 if after[moving] <= 0 else h
                after = _step(slope, state, h)
                if after[moving] > 0:
                    state, time = after, time + h
                if h < 1e-12:
                    break
            rows.append(np.concatenate([[time], state]))
            return np.array(rows)
        state, time = after, time + h
        rows.append(np.concatenate([[time], state]))


def _step(slope: Callable[[np.ndarray], np.ndarray], y: np.ndarray, h: float) -> np.ndarray:
    a = slope(y)
    b = slope(y + h / 2 * a)
    c = slope(y + h / 2 * b)
    return y + h / 6 * (a + 2 * b + 2 * c + slope(y + h * c))


def _set(name: str, medium: str, runs: list[str], about: dict[str, object]) -> Path:
    folder = DATA / name
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f"medium: {medium}", "runs:", *(f"  - {{{run}}}" for run in runs)]
    (folder / "runs.yaml").write_text("\n".join(lines) + "\n")
    (folder / "about.json").write_text(json.dumps(about, indent=2) + "\n")
    return folder


def katsuragi_durian() -> None:
    """Write drops of a sphere into glass beads: m z'' = m g - k z - m z'^2 / d1."""
    given = json.loads((ROOT / "tests" / "data" / "katsuragi_durian.json").read_text())
    k, d1 = given["stiffness_over_mass"], given["drag_length"]
    mass, diameter = given["mass"], given["diameter"]
    speeds = (0.25, 1.0, 2.0, 4.0)
    body = f"{{shape: sphere, diameter: {diameter}, mass: {mass}}}"
    folder = _set(
        "katsuragi_durian",
        "{base: glass_beads}",
        [
            f"name: sphere {v:g} m/s, kind: drop, body: {body}, speed: {v}, data: v{v:g}.csv"
            for v in speeds
        ],
        {
            "title": "Steel sphere into glass beads: the law that was fitted to the measurements",
            "source": "H. Katsuragi, D. J. Durian, Nature Physics 3, 420 (2007): F = k z + m v^2/d1"
            " with k/m = 1040 +- 10 1/s^2, d1 = 0.087 +- 0.007 m",
            "marks": dict.fromkeys((f"sphere {v:g} m/s" for v in speeds), "seen"),
            "doubts": "a fit to the measurements, not the measurements",
        },
    )
    for v in speeds:

        def slope(y: np.ndarray) -> np.ndarray:
            return np.array([y[1], GRAVITY - k * y[0] - y[1] * abs(y[1]) / d1])

        rows = solve(slope, np.array([0.0, v]), 1e-5, 1)
        force = mass * (k * rows[:, 1] + rows[:, 2] ** 2 / d1)
        table = np.column_stack([rows, force])
        names = ["time [s]", "depth [m]", "speed [m/s]", "force [N]"]
        write_thin(folder / f"v{v:g}.csv", names, table, ["force [N]"])


def paper_link() -> None:
    """Write drops of the paper's link: equations (2), (5) to (11), to the stop of T."""
    given = json.loads((ROOT / "tests" / "data" / "paper.json").read_text())
    c = given["constants"]
    length, d, rho, eta = c["length"], c["diameter"], c["sand_density"], c["eta_d"]
    mass = c["link_density"] * math.pi * d * d / 4 * length
    inertia = mass * length**2 / 12
    runs, marks = [], {}
    folder = DATA / "paper_link"
    folder.mkdir(parents=True, exist_ok=True)
    for case in given["cases"]:
        speed, angle = case["speed"], case["angle"]

        def slope(y: np.ndarray) -> np.ndarray:
            # x and depth of C, angle; their velocities. y_T = y_C + L/2 cos q.
            _, deep, q, vx, vy, w = y
            s, k = math.sin(q), math.cos(q)
            tip = max(deep + length / 2 * k, 0.0)
            immersed = min(tip / k, length)
            arm = length / 2 - immersed / 2
            ex, ey = vx + w * arm * k, vy - w * arm * s
            v, course = math.hypot(ex, ey), math.atan2(ex, ey)
            area = d * immersed * abs(math.sin(q - course))
            fx = -eta * rho * area * v * ex
            fy = -eta * rho * area * v * ey
            fx -= math.tanh(ex / 1e-6) * c["eta_h"] * GRAVITY * rho * tip**2 * d
            lift = (tip / d) ** c["lambda"] * GRAVITY * rho * math.pi * d * d / 4 * immersed
            fy -= math.tanh(ey / 1e-6) * c["eta_v"] * lift
            turn = arm * (k * fx - s * fy) / inertia
            return np.array([vx, vy, w, fx / mass, GRAVITY + fy / mass, turn])

        q = math.radians(angle)
        start = np.array([0.0, -length / 2 * math.cos(q), q, 0.0, speed, 0.0])
        rows = _until_tip_stops(slope, start, length)
        depth = rows[:, 2] + length / 2 * np.cos(rows[:, 3])
        force = np.concatenate(
            [[0.0], mass * (GRAVITY - np.diff(rows[:, 5]) / np.diff(rows[:, 0]))]
        )
        table = np.column_stack([rows[:, 0], depth, force, np.degrees(rows[:, 3])])
        assert abs(rows[-1, 0] - case["solved_time"]) < 2e-6, (case, rows[-1, 0])
        assert abs(depth[-1] - case["solved_depth"]) < 2e-6, (case, depth[-1])
        file, name = f"v{speed}_q{angle}.csv", f"link {speed} m/s {angle} deg"
        names = ["time [s]", "depth [m]", "force [N]", "pitch [deg]"]
        write_thin(folder / file, names, table, ["force [N]"])
        body = f"{{shape: link, length: {length}, diameter: {d}, mass: {mass:.9g}}}"
        runs.append(
            f"name: {name}, kind: drop, body: {body}, speed: {speed}, angle: {angle}, data: {file}"
        )
        marks[name] = "fitted to"
    about = {
        "title": "The link paper's six drops: its own equations, to the stop of the lower end",
        "source": given["source"],
        "marks": marks,
        "to_the_stop": list(marks),
        "doubts": "simulations of the law itself; the paper has no measurement of them",
    }
    _set("paper_link", "{base: play_sand}", runs, about)


def _until_tip_stops(
    slope: Callable[[np.ndarray], np.ndarray], state: np.ndarray, length: float
) -> np.ndarray:
    def down(y: np.ndarray) -> float:
        return y[4] - y[5] * length / 2 * math.sin(y[2])

    h, time = 1e-6, 0.0
    rows = [np.concatenate([[0.0], state])]
    while True:
        after = _step(slope, state, h)
        if down(after) <= 0:
            part = down(state) / (down(state) - down(after))
            state, time = _step(slope, state, part * h), time + part * h
            rows.append(np.concatenate([[time], state]))
            return np.array(rows)
        state, time = after, time + h
        if len(rows) < time / 2e-5:
            rows.append(np.concatenate([[time], state]))


def plates() -> None:
    """Write drags of an upright plate, per meter of width: F = K |z| + lambda rho h v^2."""
    given = json.loads((ROOT / "tests" / "data" / "resistive_force_theory.json").read_text())
    given = given["inertial"]
    height = given["plate"]
    runs, marks = [], {}
    speeds = np.linspace(given["speeds"][0], given["speeds"][-1], 13)
    folder = DATA / "plates"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "plate.xml").write_text(
        "<mujoco>\n<worldbody>\n"
        '<body><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide"/>'
        f'<geom type="box" size="0.0005 0.5 {height / 2}" pos="0 0 {height / 2}"/></body>\n'
        "</worldbody>\n</mujoco>\n"
    )
    for middle in given["depths"]:
        name, file = f"plate at {1e3 * middle:.0f} mm", f"z{1e3 * middle:.0f}.csv"
        force = given["K"] * middle + given["lambda"] * given["density"] * height * speeds**2
        write_thin(
            folder / file, ["speed [m/s]", "force [N]"], np.column_stack([speeds, force]), []
        )
        runs.append(
            f"name: {name}, kind: drag, body: {{file: plate.xml}}, depth: {middle + height / 2}, "
            f"data: {file}"
        )
        marks[name] = "fitted to"
    about = {
        "title": "Upright plate, 16 mm high, drawn along its normal in plane strain, 0.04 to "
        "0.64 m/s",
        "source": f"{given['source']}; K = 580 N/m, lambda = 1.1; forces on a meter of width",
        "marks": marks,
        "doubts": "the line through simulations of a continuum in plane strain, not measurements; "
        "the friction of the sand is not printed with it, so the stiffness is taken from the line",
    }
    medium = "{density: 900, internal_friction: 0.6, surface_friction: 0.4}"
    _set("plates", medium, runs, about)


def quikrete() -> None:
    """Write a push of a level plate straight down: the published stiffness, 2.02 N/cm^3."""
    given = json.loads((ROOT / "tests" / "data" / "resistive_force_theory.json").read_text())
    given = given["spatial"]["flat_plate"]
    side, name = 0.04, "plate pushed down"
    depth = np.linspace(0.002, 0.04, 20)
    force = given["measured"] * 1e6 * side**2 * depth
    folder = _set(
        "quikrete",
        "{base: quikrete_medium}",
        [
            f"name: {name}, kind: intrude, body: {{shape: plate, length: {side}, diameter: 0.004}}"
            ", speed: 0.01, data: plate.csv"
        ],
        {
            "title": "Level plate pushed into Quikrete medium sand",
            "source": "S. Agarwal, D. I. Goldman, K. Kamrin, PNAS 120 (2023), "
            "doi 10.1073/pnas.2214017120: 2.02 N/cm^3 measured",
            "marks": {name: "blind"},
            "doubts": "a stiffness for area and depth: the side of the plate is chosen here",
        },
    )
    write_thin(
        folder / "plate.csv", ["depth [m]", "force [N]"], np.column_stack([depth, force]), []
    )


if __name__ == "__main__":
    katsuragi_durian()
    paper_link()
    plates()
    quikrete()
