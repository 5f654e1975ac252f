"""Makes drops, pushes and drags in simulated grains with LAMMPS, and keeps them as data.

    python referee/dem.py bed  FOLDER --size 0.09 0.06 0.072
    python referee/dem.py drop FOLDER NAME --shape sphere --diameter 0.024 --mass 0.0362 --speed 1
    python referee/dem.py push FOLDER NAME --shape plate --length 0.02 --diameter 0.005 --speed 0.1
    python referee/dem.py push FOLDER NAME --shape plate --course 18
    python referee/dem.py drag FOLDER NAME --shape plate --length 0.016 --speed 0.3 1
    python referee/dem.py tandem FOLDER NAME --length 0.016 --diameter 0.004 --gaps 0.25 0.5 1

FOLDER is where the bed and LAMMPS's files lie (large; not for the repository). `--into` names the
folder of data: `NAME.csv`, thinned, and `NAME.json`, where it comes from. README.md has more.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from grains import GRAVITY, HEAD, Bed, Grains, lammps_version, make_bed, read_bed, run_lammps, world
from intruders import Intruder, capsule, plate, sphere

_ROWS = 100  # largest number of rows of a data file
_LATE = 0.025  # travel after which a drag is averaged: its heap grows until then [m]
_RAMP = 0.005  # travel within which a dragged body reaches its speed [m]; chosen
_SLAB = 2.0  # thickness of the frozen slab of grains [diameters]; chosen
_EVERY = 5  # steps between two samples of the force in the average of a row


def main(words: list[str] | None = None) -> None:
    """Run the command."""
    options = _parser().parse_args(words)
    grains = Grains(options.grain, density=options.grain_density, friction=options.friction)
    folder = Path(options.folder)
    if options.what == "bed":
        make_bed(
            folder,
            grains,
            size=tuple(options.size),
            stiffnesses=tuple(options.stiffness),
            seed=options.seed,
            shaken=options.shaken,
        )
        for stiffness in options.stiffness:
            print(json.dumps(_of_bed(read_bed(folder, grains, stiffness))))
        return
    bed = read_bed(folder, grains, options.stiffness)
    into = Path(options.into)
    into.mkdir(parents=True, exist_ok=True)
    table = into / f"{options.name}.csv"
    if table.exists():
        raise SystemExit(f"{table} is there already: name the run differently, or take it away")
    begin = time.time()
    if options.what == "tandem":
        intruder, rows = _tandem(bed, options)
        write_thin(table, _TANDEM, np.array(rows), [])
        _keep(table.with_suffix(".json"), bed, intruder, options, len(rows), time.time() - begin)
        return
    intruder = _intruder(options)
    if options.what == "drag":
        rows = [_drag(bed, intruder, options, speed) for speed in options.speed]
        write_thin(
            table, ["speed [m/s]", "force [N]", "lift [N]", "spread [N]"], np.array(rows), []
        )
    else:
        (speed,) = options.speed
        found = _run(bed, intruder, options, speed, options.name)
        rows = found
        names = ["time [s]", "depth [m]", "speed [m/s]", "force [N]"]
        if intruder.body["shape"] == "capsule":
            names.append("pitch [deg]")
        columns = [0, 1, 2, 3, 5][: len(names)]
        if options.course != 90.0:
            names, columns = [*names, "drag [N]"], [*columns, 4]
            found[:, 4] *= -1
        write_thin(table, names, found[:, columns], averaged=["force [N]", "drag [N]"])
    _keep(table.with_suffix(".json"), bed, intruder, options, len(rows), time.time() - begin)


def _drag(
    bed: Bed, intruder: Intruder, options: argparse.Namespace, speed: float
) -> tuple[float, float, float, float]:
    """Return speed, mean force against the motion and lift beyond `_LATE` of travel, and spread.

    Raises:
        SystemExit: the path ends before that, or beyond the bed.
    """
    free = 0.75 * bed.lengths[0] - intruder.sides[0] - _SLAB * bed.grains.diameter
    if not _LATE < options.distance < free:
        raise SystemExit(
            f"--distance must be between {_LATE} m, where averaging begins, and {free:.3f} m, "
            f"where this bed ends; got {options.distance}"
        )
    found = _run(bed, intruder, options, speed, f"{options.name}_{speed:g}")
    late = found[speed * found[:, 0] > _LATE + _RAMP]
    return speed, -late[:, 4].mean(), late[:, 3].mean(), late[:, 4].std()


_TANDEM = [
    "plates",
    "gap over length",
    "aside",
    "force [N]",
    "force over one plate's",
    "leading plate's over one plate's",
    "last plate's over one plate's",
    "spread over one plate's",
]


def _tandem(bed: Bed, options: argparse.Namespace) -> tuple[Intruder, list[tuple[float, ...]]]:
    """Drag one plate, then rows of plates that start at the same place, and average the forces.

    The spread is half the difference between the two halves of the averaging window.
    """
    rows: list[tuple[float, ...]] = []
    (speed,) = options.speed
    length, thickness = options.length, options.diameter
    intruder = plate(length, thickness, upright=True)
    for aside in options.aside:
        one = 0.0
        for count, gap in ((1, 0.0), *((options.plates, gap) for gap in options.gaps)):
            intruder = plate(length, thickness, upright=True, count=count, gap=gap * length)
            found = _run(bed, intruder, options, speed, _name(options, count, gap, aside), aside)
            late = -found[int(options.skip * len(found)) :]
            early, later = (half[:, 4].mean() for half in np.array_split(late, 2))
            force = late[:, 4].mean()
            one = one or force
            ratios = np.array(
                [force, late[:, 6].mean(), late[:, -1].mean(), abs(later - early) / 2]
            )
            rows.append((count, gap, aside, force, *(ratios / one)))
            print(json.dumps(dict(zip(_TANDEM, map(float, rows[-1]), strict=True))), flush=True)
    return intruder, rows


def _name(options: argparse.Namespace, count: int, gap: float, aside: float) -> str:
    """Return the name of the LAMMPS files for a row of plates."""
    return f"{options.name}_{count}_{gap:g}_{aside:g}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parts = parser.add_subparsers(dest="what", required=True)
    for what in ("bed", "drop", "push", "drag", "tandem"):
        part = parts.add_parser(what)
        part.add_argument("folder", help="of the bed and of LAMMPS's files")
        part.add_argument("--grain", type=float, default=0.003, help="mean diameter [m]")
        part.add_argument("--grain-density", type=float, default=2500.0, help="[kg/m^3]")
        part.add_argument("--friction", type=float, default=0.45, help="of all contacts")
        if what == "bed":
            part.add_argument("--size", type=float, nargs=3, default=[0.09, 0.06, 0.072])
            part.add_argument("--stiffness", type=float, nargs="+", default=[1e4, 4e4, 8e4])
            part.add_argument("--seed", type=int, default=7)
            part.add_argument(
                "--shaken", type=float, default=0.0, help="settle so long without friction [s]"
            )
            continue
        part.add_argument("name", help="of the run")
        part.add_argument("--stiffness", type=float, default=1e4 if what == "push" else 4e4)
        part.add_argument("--into", default="referee/data/small_bed", help="folder of data")
        part.add_argument("--shape", default="sphere", choices=("sphere", "capsule", "plate"))
        part.add_argument("--diameter", type=float, default=0.024, help="of a plate: thickness [m]")
        part.add_argument("--length", type=float, default=0.02, help="of a plate: side [m]")
        part.add_argument("--mass", type=float, default=0.0, help="of what is dropped [kg]")
        part.add_argument("--speed", type=float, nargs="+", default=[1.0], help="[m/s]")
        part.add_argument(
            "--angle",
            type=float,
            default=0.0,
            help="of a rod or a plate's normal [deg]",
        )
        part.add_argument(
            "--course", type=float, default=90.0, help="of a push, below the horizontal [deg]"
        )
        part.add_argument("--duration", type=float, default=0.12, help="of a drop, at most [s]")
        part.add_argument("--depth", type=float, default=0.03, help="of a push; of a drag [m]")
        part.add_argument("--distance", type=float, default=0.05, help="of a drag [m]")
        if what == "tandem":
            part.add_argument("--plates", type=int, default=2, help="one behind another")
            part.add_argument("--gaps", type=float, nargs="*", default=[1.0], help="over --length")
            part.add_argument(
                "--aside", type=float, nargs="+", default=[0.5], help="over y's width"
            )
            part.add_argument("--skip", type=float, default=0.5, help="part of the way")
    return parser


def _intruder(options: argparse.Namespace) -> Intruder:
    if options.shape == "sphere":
        return sphere(options.diameter)
    if options.shape == "capsule":
        return capsule(options.length, options.diameter, math.radians(options.angle))
    upright, tilt = options.what == "drag", math.radians(options.angle)
    return plate(options.length, options.diameter, upright=upright, tilt=tilt)


def _run(
    bed: Bed,
    intruder: Intruder,
    options: argparse.Namespace,
    speed: float,
    name: str,
    aside: float = 0.5,
) -> np.ndarray:
    """Run LAMMPS; return rows of time, depth, speed down, force up, force along x, pitch [deg].

    The forces of each plate along x follow.
    """
    start = intruder.start_over(bed)
    drawn = _is_drawn(options)
    if drawn:
        raise_to = bed.surface - options.depth - intruder.lowest
        # The leading plate of a row leaves space behind it: LAMMPS makes no spheres outside the
        # box.
        ahead = 0.6 if options.what == "tandem" else 0.25
        start = np.array([ahead * bed.lengths[0], aside * bed.lengths[1], raise_to])
    script = _script(bed, intruder, options, start, speed, name)
    run_lammps(bed.folder, script, name)
    state = np.loadtxt(bed.folder / f"{name}.state", ndmin=2)
    force = np.loadtxt(bed.folder / f"{name}.force", ndmin=2)
    # Each row of forces is the mean over the window that ends at its step.
    at = {int(step): row for step, *row in force}
    step = bed.grains.timestep(options.stiffness)
    first = int(state[0, 0])
    rows = []
    for count, low, high, high_x, low_x, vz in state:
        mean = at.get(int(count), [0.0] * (2 + len(intruder.places)))
        lowest = min(low, high) - intruder.diameters[0] / 2
        if intruder.sides:
            lowest = low + intruder.lowest
        pitch = math.degrees(math.atan2(high_x - low_x, high - low)) if high != low else 0.0
        rows.append(
            (
                (count - first) * step,
                bed.surface - lowest,
                -vz,
                mean[0],
                mean[1],
                pitch,
                *mean[2:],
            )
        )
    return np.array(rows)


def _is_drawn(options: argparse.Namespace) -> bool:
    """Return True if the body is dragged along x, not pushed down or dropped."""
    return options.what in ("drag", "tandem")


def _script(
    bed: Bed,
    intruder: Intruder,
    options: argparse.Namespace,
    start: np.ndarray,
    speed: float,
    name: str,
) -> str:
    """Return the input script of a run."""
    count, free = len(bed.centers), options.what == "drop"
    single = len(intruder.centers) == 1
    step = bed.grains.timestep(options.stiffness)
    drawn = _is_drawn(options)
    course = math.radians(options.course)
    down, ahead = speed * math.sin(course), speed * math.cos(course)
    travel = options.distance + _RAMP if drawn else (options.depth + 0.004) * speed / down
    duration = options.duration if free else travel / speed
    steps = round(duration / step)
    every = _EVERY * max(1, steps // (_EVERY * 4 * _ROWS))
    parts = [
        HEAD.format(skin=0.15 * bed.grains.diameter),
        f"read_data {bed.file.name}",
        "group grains type 1",
        *(
            f"create_atoms 2 single {' '.join(f'{c:.9g}' for c in start + center)}"
            for center in intruder.centers
        ),
        "group intruder type 2",
    ]
    mass = options.mass or 1.0
    sizes = np.unique(intruder.diameters)
    assert len(sizes) == 1
    parts.append(f"set group intruder diameter {sizes[0]:.9g}")
    if single:
        parts.append(f"set group intruder density {mass / (math.pi / 6 * sizes[0] ** 3):.9g}")
    else:
        parts.append(f"set group intruder mass {mass / len(intruder.centers):.9g}")
        parts.append("neigh_modify exclude group intruder intruder")
    if drawn:
        # Delete the grains at the places of the plates; the others keep their numbers.
        reach = np.array(intruder.sides) / 2
        for i, place in enumerate(start + np.array(intruder.places)):
            low, high = place - reach - 1.5e-3, place + reach + 1.5e-3
            box_ = " ".join(f"{a:.6g} {b:.6g}" for a, b in zip(low, high, strict=True))
            parts += [f"region hole{i} block {box_}", f"group hole{i} region hole{i}"]
            parts += [
                f"group out{i} intersect hole{i} grains",
                f"delete_atoms group out{i} compress no",
            ]
        # One slab of grains is frozen, or the body would carry the periodic bed along.
        parts += [
            f"region slab block 0 {_SLAB * bed.grains.diameter:g} INF INF INF INF",
            "group slab region slab",
            "group frozen intersect slab grains",
            "velocity frozen set 0 0 0",
            "group loose subtract grains frozen",
        ]
    parts.append(world(bed.grains, options.stiffness))
    parts += [
        "thermo 2000",
        "thermo_modify lost ignore",
        f"fix move {'loose' if drawn else 'grains'} nve/sphere",
        f"fix drag grains viscous {30 * bed.grains.mass:.6g}",
        "fix hold intruder setforce 0 0 0",
        f"run {round((0.03 if drawn else 0.004) / step)}",
        "unfix drag",
        "unfix hold",
        "reset_timestep 0",
    ]
    v = speed
    if free and single:
        parts += ["fix fall intruder nve/sphere", f"velocity intruder set 0 0 {-v:g}"]
    elif free:
        guided = bool(intruder.sides)
        only = " force 1 off off on torque 1 off off off" if guided else ""
        six = " ".join(f"{mass * i:.9g}" for i in intruder.inertia)
        place = " ".join(f"{c:.9g}" for c in start)
        line = f"1 {mass:.9g} {place} {six} 0 0 {-v:g} 0 0 0 0 0 0"
        (bed.folder / f"{name}.body").write_text(f"1\n{line}\n")
        parts.append(f"fix fall intruder rigid single infile {name}.body{only}")
    elif drawn:
        ramp = 2 * _RAMP / v  # [s]: the speed grows linearly
        parts += [
            f"variable t equal step*{step:.9g}",
            f"variable speed equal {v:g}*((v_t<{ramp:.9g})*v_t/{ramp:.9g}+(v_t>={ramp:.9g}))",
            f"variable way equal {v:g}*((v_t<{ramp:.9g})*v_t*v_t/{2 * ramp:.9g}"
            f"+(v_t>={ramp:.9g})*(v_t-{ramp / 2:.9g}))",
            "variable none equal 0",
            "fix fall intruder move variable v_way v_none v_none v_speed v_none v_none",
        ]
    else:
        parts.append(f"fix fall intruder move linear {ahead:g} 0 {-down:g}")
        # Set the speed of moved bodies as well as their position: friction and damping read it.
    low, high = count + 1, count + len(intruder.centers)
    each = len(intruder.centers) // len(intruder.places)
    for i in range(len(intruder.places)):
        parts += [
            f"group plate{i} id {low + i * each}:{low + (i + 1) * each - 1}",
            f"variable f{i} equal fcm(plate{i},x)",
        ]
    forces = " ".join(f"v_f{i}" for i in range(len(intruder.places)))
    parts += [
        f"group low id {low}",
        f"group high id {high}",
        "variable n equal step",
        "variable low equal xcm(low,z)",
        "variable high equal xcm(high,z)",
        "variable lowx equal xcm(low,x)",
        "variable highx equal xcm(high,x)",
        "variable vz equal vcm(intruder,z)",
        f"variable fz equal fcm(intruder,z)+{mass * GRAVITY:.9g}",
        "variable fx equal fcm(intruder,x)",
        f"fix force intruder ave/time {_EVERY} {every // _EVERY} {every} v_fz v_fx {forces}"
        f" file {name}.force format ' %.8g'",
        f'fix state intruder print {every} "$n ${{low}} ${{high}} ${{highx}} ${{lowx}} ${{vz}}"'
        f" file {name}.state screen no",
    ]
    if intruder.sides:
        # The leading plate's center, not that of its first sphere.
        parts.insert(-6, "variable low equal xcm(plate0,z)")
        parts.insert(-6, "variable high equal xcm(plate0,z)")
    if free and intruder.body["shape"] != "capsule":
        parts += [
            "variable down equal -vcm(intruder,z)",
            f"fix stop all halt {every} v_down < {0.005 * v:g} error continue",
            f"run {steps}",
            "unfix stop",
            f"run {round(0.005 / step)}",
        ]
    else:
        parts.append(f"run {steps}")
    return "\n".join(parts) + "\n"


def _keep(
    file: Path,
    bed: Bed,
    intruder: Intruder,
    options: argparse.Namespace,
    rows: int,
    seconds: float,
) -> None:
    """Write the provenance of a run."""
    last = options.name
    if options.what == "drag":
        last = f"{options.name}_{options.speed[-1]:g}"
    elif options.what == "tandem":
        last = _name(options, 1, 0.0, options.aside[-1])
    about = {
        "made_by": "referee/dem.py " + " ".join(_words()),
        "program": lammps_version(bed.folder, last),
        "bed": _of_bed(bed),
        "grains": asdict(bed.grains),
        "stiffness": options.stiffness,
        "timestep": bed.grains.timestep(options.stiffness),
        "body": {**intruder.body, "mass": options.mass or None},
        "spheres_of_the_body": len(intruder.centers),
        "speed": options.speed,
        "angle": math.degrees(intruder.angle),
        "rows_before_thinning": rows,
        "force": "of the contacts on the body, up, mean since the row before; of a drag against "
        f"the motion and up, mean beyond {_LATE} m of travel, with its standard deviation",
        "seconds_it_took": round(seconds),
    }
    file.write_text(json.dumps(about, indent=2) + "\n")
    print(f"{file.with_suffix('.csv')}: {rows} rows before thinning, {seconds:.0f} s")


def write_thin(path: Path, names: list[str], rows: np.ndarray, averaged: list[str]) -> None:
    """Write at most `_ROWS` rows; the columns in `averaged` are means over the omitted rows."""
    picks = np.unique(np.linspace(0, len(rows) - 1, min(_ROWS, len(rows))).round().astype(int))
    thin = rows[picks].copy()
    for name in set(averaged) & set(names):
        k = names.index(name)
        for i, (begin, end) in enumerate(pairwise(picks), start=1):
            thin[i, k] = rows[begin + 1 : end + 1, k].mean()
    lines = [",".join(names), *(",".join(f"{v:.6g}" for v in row) for row in thin)]
    path.write_text("\n".join(lines) + "\n")


def _of_bed(bed: Bed) -> dict[str, Any]:
    return {
        "grains": len(bed.centers),
        "plan": list(bed.lengths),
        "surface": round(bed.surface, 6),
        "packing": round(bed.packing, 4),
        "density": round(bed.density, 1),
        "stiffness": bed.stiffness,
    }


def _words() -> list[str]:
    """Return the command line without the folders, which are specific to one machine."""
    words = sys.argv[1:]
    words = [w for i, w in enumerate(words) if i != 1]
    if "--into" in words:
        i = words.index("--into")
        words = words[:i] + words[i + 2 :]
    return words


if __name__ == "__main__":
    main()
