"""`mjgranular reproduce`: the paper's table and figures."""

from __future__ import annotations

import math
import signal
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.table import Table
from rich.text import Text

from mjgranular._util.signals import Stopped
from mjgranular.cli.console import out, print_json, progress_bar, show_error
from mjgranular.cli.impact import release_to_stop, title
from mjgranular.cli.options import law_named
from mjgranular.errors import InputError, MissingExtraError
from mjgranular.experiment import CASES, Impact, ImpactResult, Sweep, reproduce, run_sweep
from mjgranular.experiment.folder import CONFIG, SUMMARY, ResultFolder
from mjgranular.experiment.paper import PaperCase, comparison
from mjgranular.pool import Workers

_SWEEPS = {
    5: Sweep("speed", 1.0, 10.0, 19, Impact(angle=math.radians(45))),
    9: Sweep("angle", math.radians(30), math.radians(60), 31, Impact(speed=2.0)),
}


@dataclass(frozen=True)
class ReproduceCommand:
    """The six drops of the paper's table beside its printed values; with --out, its figures."""

    timestep: Annotated[float, tyro.conf.arg(metavar="S")] = 1e-6
    """Time step of the six drops [s]."""
    scheme: Annotated[str, tyro.conf.arg(metavar="NAME")] = "explicit"
    """How forces become a step."""
    law: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """The force law. Default: the paper's, link."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the table and figures in the kind of Figs. 2-9; nothing is written without it."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Number of processes for Figs. 5 and 9. Default: one a core."""
    overwrite: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Replace a result that the folder holds already."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print a JSON list instead of a table."""

    def run(self) -> int:
        """Runs the command."""
        Workers(count=self.workers)  # which checks itself
        if self.workers is not None and self.out is None:
            raise InputError("--workers is for Figs. 5 and 9 in the folder of --out: add --out DIR")
        base = Impact(timestep=self.timestep, scheme=self.scheme, law=law_named(self.law))
        if self.out is None:
            self._show(self._reproduce(base))
            return 0
        figures = [f"figure_{number}.png" for number in range(2, 10)]
        names = (CONFIG, SUMMARY, *figures)
        with ResultFolder(self.out, names).claimed(overwrite=self.overwrite) as folder:
            results = self._reproduce(base)
            with folder.published():
                folder.write_config("reproduce", asdict(base))
                folder.write_json(SUMMARY, [comparison(*pair) for pair in results])
            self._show(results)
            try:
                self._draw(folder, results, base)
            except MissingExtraError as error:
                show_error(f"{error} (the numbers are in {self.out})")
                return 2
        if not self.json:
            out.print(f"written to {self.out}", highlight=False, markup=False)
        return 0

    def _reproduce(self, base: Impact) -> list[tuple[PaperCase, ImpactResult]]:
        with progress_bar("dropping the paper's links", len(CASES)) as progress:
            return reproduce(base, progress=progress)

    def _draw(
        self, folder: ResultFolder, results: list[tuple[PaperCase, ImpactResult]], base: Impact
    ) -> None:
        from mjgranular.picture.figures import draw_motion, draw_sweep

        for case, result in results:
            summary = result.summary()

            def draw(path: Path, result: ImpactResult = result, summary: Any = summary) -> None:
                stop = release_to_stop(summary)
                draw_motion(path, result.trajectory, stop=stop, title=title(summary))

            folder.write(f"figure_{case.figure}.png", draw)
        for figure, sweep in _SWEEPS.items():
            # The trend needs no last digit: ten times the step, still 0.1 % true.
            impact = replace(
                sweep.impact, timestep=10 * base.timestep, scheme=base.scheme, law=base.law
            )
            sweep = replace(sweep, impact=impact)
            with progress_bar(f"sweeping over the {sweep.over}", sweep.points) as progress:
                swept = run_sweep(sweep, workers=self.workers, progress=progress)
            if swept.interrupted:  # a figure of a part would be taken for that of the whole
                raise Stopped(swept.stopped_by or signal.SIGTERM)
            rows = swept.rows
            common = f"{impact.medium}, {impact.timestep:g} s"

            def draw_rows(
                path: Path, rows: Any = rows, sweep: Sweep = sweep, common: str = common
            ) -> None:
                draw_sweep(path, rows, over=sweep.over, title=common)

            folder.write(f"figure_{figure}.png", draw_rows)

    def _show(self, results: list[tuple[PaperCase, ImpactResult]]) -> None:
        rows = [comparison(*pair) for pair in results]
        if self.json:
            print_json(rows)
            return
        table = Table(
            title=f"The paper's six drops, time step {self.timestep:g} s", title_justify="left"
        )
        headings = (
            "speed\n[m/s]",
            "angle\n[deg]",
            "stopping\ntime [ms]",
            "paper\n[ms]",
            "diff.\n[us]",
            "depth\n[mm]",
            "paper\n[mm]",
            "diff.\n[um]",
        )
        for heading in headings:
            table.add_column(Text(heading), justify="right", no_wrap=True)
        for row in rows:
            time, depth = row["stopping_time"], row["depth"]
            late = None if time is None else time - row["paper_stopping_time"]
            table.add_row(
                f"{row['speed']:g}",
                f"{row['angle_deg']:g}",
                "not stopped" if time is None else f"{time * 1e3:.3f}",
                f"{row['paper_stopping_time'] * 1e3:.3f}",
                "" if late is None else f"{late * 1e6:+.1f}",
                f"{depth * 1e3:.3f}",
                f"{row['paper_depth'] * 1e3:.3f}",
                f"{(depth - row['paper_depth']) * 1e6:+.1f}",
            )
        out.print(table)
