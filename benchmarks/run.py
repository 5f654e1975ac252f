"""Cost of sand: all benchmarks, as tables, JSON and a page of the documentation.

    python benchmarks/run.py                                   all, about a quarter of an hour
    python benchmarks/run.py --only interfaces elements --quick  two families, to see that they work
    python benchmarks/run.py --save now.json --compare then.json
    python benchmarks/run.py --report benchmarks/figures.md

Cases of a group take turns after one turn that is not counted; what is quoted is the median over
the turns, with its quartiles, and the ratio to the first case of the group. Close what else runs.
"""

from __future__ import annotations

import datetime
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

# The families are next to this file; add its folder for interpreters that do not search it.
sys.path.insert(0, str(Path(__file__).resolve().parent))

import batches
import elements
import interfaces
import measure
import report
import robots
import start
import tyro
from rich.console import Console
from rich.progress import Progress

from mjgranular._util.result_folder import versions

FAMILIES = {
    "interfaces": interfaces.GROUPS,
    "elements": elements.GROUPS,
    "batches": batches.GROUPS,
    "robots": robots.GROUPS,
    "start": start.GROUPS,
}
NEEDS = {"batches": "a MuJoCo that has mujoco.batch", "robots": "gymnasium"}
"""Requirements of families that have no groups here."""

Family = Literal["interfaces", "elements", "batches", "robots", "start"]


@dataclass(frozen=True)
class Options:
    """Cost of sand beside a bare `mj_step`, MuJoCo's own fluid and a rigid floor."""

    only: Annotated[tuple[Family, ...], tyro.conf.arg(metavar="FAMILY ...")] = ()
    """Families that are measured. Default: all."""
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Two short turns: to see that everything runs; the figures mean little."""
    save: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Write the figures to this JSON file."""
    compare: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Print the ratios beside those of this file."""
    report: Annotated[Path | None, tyro.conf.arg(metavar="PAGE.md")] = None
    """Write the figures into this page, in place of those in it."""


def facts(effort: measure.Effort) -> dict[str, Any]:
    """Return machine and versions of a measurement."""
    return {
        "processor": measure.machine(),
        "cores": os.cpu_count(),
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "turns": effort.turns,
        **versions(),
    }


def main(options: Options) -> None:
    """Measure, print, save, compare and report."""
    console = Console()
    effort = measure.QUICK if options.quick else measure.FULL
    machine = facts(effort)
    before = report.read(options.compare) if options.compare else {}
    around = report.around_figures(options.report) if options.report else None
    groups = [group for name in options.only or FAMILIES for group in FAMILIES[name]]
    console.print(
        f"{machine['processor']}, {machine['cores']} cores, MuJoCo {machine['mujoco']}, "
        f"mjgranular {machine['mjgranular']}",
        highlight=False,
    )
    for name in options.only or FAMILIES:
        if not FAMILIES[name]:
            console.print(f"{name}: left out, needs {NEEDS[name]}", highlight=False)
    found = []
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("", total=effort.turns * len(groups))
        for group in groups:
            progress.update(task, description=group.title)
            figures = measure.measure(group, effort, progress=lambda: progress.advance(task))
            found.append((group, figures))
            report.show(console, group, figures, before.get(group.title))
    if options.save:
        report.save(options.save, machine, {group.title: figures for group, figures in found})
    if options.report and around:
        page = report.page_of(report.markdown(machine, found), *around)
        options.report.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__, config=(tyro.conf.OmitArgPrefixes,)))
