"""Holds every law against every set of measured motion, and writes what comes out.

    python referee/validate.py          # docs/validity.md, its figures, law/error_table.csv
    python referee/validate.py --report page.md --only seen

Run it after a law, a constant or a set has changed. Errors are those of whole trajectories
(`mjgranular.calibrate.compare`).
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from comparison import Candidate, Comparison
from findings import write_findings
from page import write_page
from pictures import draw

from mjgranular import (
    DepthVelocityLaw,
    DistributedLinkLaw,
    DynamicRft2dLaw,
    DynamicRft3dLaw,
    LinkLaw,
    Rft2dLaw,
    Rft3dLaw,
)
from mjgranular.calibrate import Run, RunSet, compare, read_runs, simulate
from mjgranular.errors import GranularError

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "referee" / "data"
SIDEWAYS = ("drawn", "drawn_rough", "legs_poppy", "legs_glass", "robot", "wheel")
"""Sets of bodies that are dragged, turn, roll or walk."""

SETS = (
    *(
        "seen",
        "small_bed",
        "wide_bed",
        "tilted",
        "katsuragi_durian",
        "plates",
        "quikrete",
        "paper_link",
    ),
    *SIDEWAYS,
)
"""Folders of data, in the order of the page."""

_JUDGED_SIDEWAYS = ("rft2d", "rft2d_dynamic", "rft3d", "rft3d_dynamic")

SIMULATED = ("seen", "small_bed", "wide_bed", "tilted")
"""Sets of simulated grains."""

KAPPA, ADDED_BY = 2.5, ("sphere 1 m/s", "sphere 3 m/s")
"""Constants of the added mass, and the runs of `seen` that they were fitted to."""


def candidates(runs: RunSet) -> list[Candidate]:
    """Return the laws with known constants, with and without the inertial term."""
    found: list[Candidate] = []
    stiffness, fitted = _slow_stiffness(runs)
    play_sand = "play sand's of the link paper; the density is that of the bed"
    if any(run.shape in ("link", "capsule") for run in runs.runs):
        own = runs.name == "paper_link"
        names = tuple(run.name for run in runs.runs) if own else ()
        for law in (LinkLaw, DistributedLinkLaw):
            text = "the paper's" if own else play_sand
            found.append(Candidate(law.name, law.from_medium("play_sand"), names, text))
    if runs.name in ("katsuragi_durian", *SIMULATED):
        own = runs.name == "katsuragi_durian"
        names = tuple(run.name for run in runs.runs) if own else ()
        text = "Katsuragi and Durian's, of glass beads and a steel sphere of 25.4 mm"
        law = DepthVelocityLaw.from_medium("glass_beads")
        found.append(Candidate("depth_velocity", law, names, text))
    for name, law, text, by in _resistive(runs, stiffness, fitted):
        found.append(Candidate(name, law, by, text))
        density = runs.medium.density.value
        changes = {"inertia": 1.1} if name == "rft3d" else {"inertia": 1.1, "density": density}
        found.append(
            Candidate(f"{name} inertia", replace(law, **changes), by, f"{text}, lambda = 1.1")
        )
        with_mass = replace(law, **changes, added=KAPPA)
        theirs = (*by, *ADDED_BY) if runs.name == "seen" else by
        text = f"{text}, lambda = 1.1, kappa = {KAPPA:g}"
        found.append(Candidate(f"{name} added", with_mass, theirs, text))
        found.append(_dynamic(runs, with_mass, by, theirs))
    if runs.name in SIDEWAYS:
        return [c for c in found if c.name in _JUDGED_SIDEWAYS]
    return found


def _dynamic(
    runs: RunSet, law: Rft2dLaw | Rft3dLaw, by: tuple[str, ...], theirs: tuple[str, ...]
) -> Candidate:
    """Return the dynamic law, its strength from the slowest push of a level plate, if any."""
    if isinstance(law, Rft3dLaw):
        made = DynamicRft3dLaw.from_medium(runs.medium)
    elif Rft2dLaw.name in runs.medium.constants:
        made = DynamicRft2dLaw.from_medium(runs.medium)
    else:
        own = {f.name: getattr(law, f.name) for f in fields(law) if f.name != "cone"}
        made = DynamicRft2dLaw(**own)
    push = _slow_push(runs)
    if runs.name == "plates":
        made = replace(made, scale=law.scale)
        return Candidate(made.name, made, by, "stiffness from K = 580 N/m")
    if push is None:
        return Candidate(made.name, made, by, "the medium's; nothing fitted")
    force = simulate(push, runs.medium, made).force
    measured = push.motion.force
    assert force is not None
    assert measured is not None
    scale = float((measured * force).sum() / (force * force).sum())
    made = replace(made, scale=scale * made.scale)
    text = f"scale {made.scale:.3g} from the slow plate push, all else as published"
    return Candidate(made.name, made, (*theirs, push.name), text)


def _resistive(
    runs: RunSet, stiffness: float | None, fitted: tuple[str, ...]
) -> list[tuple[str, Rft2dLaw | Rft3dLaw, str, tuple[str, ...]]]:
    """Return both laws of resistive force theory for a set: name, law, constants, fitted."""
    if runs.name == "plates":
        found = []
        for name, law in (
            ("rft2d", Rft2dLaw.generic(1.0)),
            ("rft3d", Rft3dLaw.from_medium(runs.medium)),
        ):
            scale = _scale_to_line(runs, law)
            text = "stiffness from K = 580 N/m"
            names = tuple(run.name for run in runs.runs)
            found.append((name, replace(law, scale=law.scale * scale), text, names))
        return found
    found = []
    if stiffness is not None:
        text = f"generic coefficients times {1e-6 * stiffness:.3g}, from the slow plate push"
        found.append(("rft2d", Rft2dLaw.generic(1e-6 * stiffness), text, fitted))
    elif "rft2d" in runs.medium.constants:
        law = Rft2dLaw.from_medium(runs.medium)
        found.append(("rft2d", law, f"{runs.medium.name}'s, times {law.scale:g}", ()))
    if "rft3d" in runs.medium.constants:
        law = Rft3dLaw.from_medium(runs.medium)
        text = f"the published formula for mu = {law.internal_friction:.3g}; nothing fitted"
        found.append(("rft3d", law, text, ()))
    return found


def _slow_push(runs: RunSet) -> Run | None:
    """Return the slowest push of a level plate, to fit constants to."""
    pushes = [r for r in runs.runs if r.kind == "intrude" and r.mark == "fitted to"]
    return min(pushes, key=lambda run: run.speed, default=None)


def _slow_stiffness(runs: RunSet) -> tuple[float | None, tuple[str, ...]]:
    """Return force over area and depth of the slowest level plate [N/m^3], and the run's name."""
    run = _slow_push(runs)
    if run is None:
        return None, ()
    assert run.motion.force is not None
    area = run.width**2
    depth, force = run.motion.depth, run.motion.force
    return float((force * depth).sum() / (depth**2).sum() / area), (run.name,)


def _scale_to_line(runs: RunSet, law: Rft2dLaw | Rft3dLaw) -> float:
    """Return the factor by which a law at rest gives the published line K z of dragged plates."""
    run = runs.runs[0]
    still = replace(run, motion=replace(run.motion, speed=np.full_like(run.motion.depth, 1e-6)))
    force = simulate(still, runs.medium, law).force
    assert force is not None
    assert run.depth is not None
    return float(580.0 * (run.depth - run.width / 2) / force[0])


def hold(runs: RunSet) -> list[Comparison]:
    """Compare every law with every run of a set."""
    found = []
    for run in runs.runs:
        for candidate in candidates(runs):
            motion = errors = None
            if not _foreign(run, candidate):
                try:
                    motion = simulate(run, runs.medium, candidate.law)
                    errors = compare(run.motion, motion)
                except GranularError as error:
                    print(f"{run.name}, {candidate.name}: {error}", file=sys.stderr)
            found.append(Comparison(runs, run, candidate, motion, errors))
    return found


def _foreign(run: Run, candidate: Candidate) -> bool:
    """Return True if the law is for other bodies: rods, or the one sphere that it was fitted to."""
    if candidate.name in ("link", "link_distributed"):
        return run.shape not in ("link", "capsule")
    if candidate.name == "depth_velocity":
        return run.shape != "sphere" or abs(run.width - 0.0254) > 1e-4
    return False


def main(words: list[str] | None = None) -> None:
    """Compare, and write page, figures and error table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--report", type=Path, default=ROOT / "docs" / "validity.md")
    parser.add_argument(
        "--only", nargs="+", default=None, choices=SETS, help="sets; all if not said"
    )
    options = parser.parse_args(words)
    names = options.only or [name for name in SETS if (DATA / name).exists()]
    found = [hold(read_runs(DATA / name)) for name in names]

    folder = options.report.parent / "figures"
    figures = {c[0].runs.name: draw(c, folder) for c in found}
    write_page(options.report, found, figures)
    print(f"wrote {options.report}")
    if options.only is None and options.report == ROOT / "docs" / "validity.md":
        write_findings(ROOT / "mjgranular" / "law" / "error_table.csv", found)


if __name__ == "__main__":
    main()
