"""`mjgranular sweep`: many drops."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.table import Table
from rich.text import Text

from mjgranular.cli.console import err, out, print_json, progress_bar, show_error
from mjgranular.cli.options import LinkOptions
from mjgranular.errors import MissingExtraError
from mjgranular.experiment import Sweep, SweepResult, run_sweep
from mjgranular.experiment.folder import CONFIG, SUMMARY, ResultFolder
from mjgranular.experiment.unfinished import UNFINISHED, Unfinished

_CSV = "sweep.csv"
_FIGURE = "sweep.png"
_RANGE = {"speed": (1.0, 10.0, 19), "angle": (30.0, 60.0, 31)}  # as in the paper's Figs. 5 and 9


@dataclass(frozen=True)
class SweepCommand(LinkOptions):
    """Many drops over a range of speeds or angles, as in Figs. 5 and 9 of the paper.

    The drops are spread over the cores. Ctrl-C ends the sweep; with --out what is finished is kept,
    whatever ended it, and the same command goes on.
    """

    over: Literal["speed", "angle"] = "speed"
    """What differs from drop to drop."""
    first: Annotated[float | None, tyro.conf.arg(metavar="M/S|DEG")] = None
    """First value [m/s or degrees]. Default: 1 m/s, 30 degrees."""
    last: Annotated[float | None, tyro.conf.arg(metavar="M/S|DEG")] = None
    """Last value [m/s or degrees]. Default: 10 m/s, 60 degrees."""
    points: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Number of drops. Default: 19 speeds, 31 angles."""
    speed: Annotated[float | None, tyro.conf.arg(metavar="M/S")] = None
    """Speed of T in a sweep over the angle [m/s]. Default: 2."""
    angle: Annotated[float | None, tyro.conf.arg(metavar="DEG")] = None
    """Angle from the vertical in a sweep over the speed [degrees]. Default: 45."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Number of processes. Default: one a core."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the results; nothing is written without it."""
    overwrite: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Replace a result that the folder holds already."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print a JSON list instead of a table."""

    def run(self) -> int:
        """Runs the command."""
        sweep = self._sweep()
        if self.out is None:
            result = self._run(sweep, {}, None)
            self._show(result)
            return self._status(result, kept=None)
        names = (CONFIG, SUMMARY, _CSV, _FIGURE, UNFINISHED)
        unfinished = Unfinished(self.out, sweep)
        with ResultFolder(self.out, names).claimed(
            overwrite=self.overwrite, goes_on=lambda: unfinished.rows() is not None
        ) as folder:
            rows = unfinished.begin()
            if rows:
                err.print(f"{len(rows)} of {sweep.points} drops are finished", style="dim")
            result = self._run(sweep, rows, unfinished.keep)
            self._show(result)
            if result.rows:
                self._write(folder, result)
                if not self.json:
                    out.print(f"written to {self.out}", highlight=False, markup=False)
            return self._status(result, kept=self.out if result.rows else None)

    def _sweep(self) -> Sweep:
        first, last, points = _RANGE[self.over]
        first = first if self.first is None else self.first
        last = last if self.last is None else self.last
        if self.over == "angle":
            first, last = math.radians(first), math.radians(last)
        base = self.impact(
            speed=2.0 if self.speed is None else self.speed,
            angle_deg=45.0 if self.angle is None else self.angle,
        )
        return Sweep(
            over=self.over,
            first=first,
            last=last,
            points=points if self.points is None else self.points,
            impact=base,
        )

    def _run(
        self,
        sweep: Sweep,
        finished: dict[int, dict[str, Any]],
        keep: Callable[[int, dict[str, Any]], None] | None,
    ) -> SweepResult:
        with progress_bar("dropping links", sweep.points) as progress:
            return run_sweep(
                sweep, workers=self.workers, progress=progress, finished=finished, keep=keep
            )

    def _show(self, result: SweepResult) -> None:
        if self.json:
            print_json(result.rows)
            return
        key, name = {"speed": ("speed", "speed [m/s]"), "angle": ("angle_deg", "angle [deg]")}[
            self.over
        ]
        table = Table(title=f"Drops over the {self.over}", title_justify="left")
        for heading in (name, "stopping time [ms]", "depth of T [mm]"):
            table.add_column(Text(heading), justify="right")
        for row in result.rows:
            time = row["stopping_time"]
            table.add_row(
                f"{row[key]:.4g}",
                "not stopped" if time is None else f"{time * 1e3:.3f}",
                f"{row['depth'] * 1e3:.3f}",
            )
        out.print(table)

    def _write(self, folder: ResultFolder, result: SweepResult) -> None:
        from mjgranular.picture.figures import draw_sweep

        first = result.rows[0]
        fixed = f"{first['angle_deg']:g} deg" if self.over == "speed" else f"{first['speed']:g} m/s"
        title = f"{fixed}, {first['medium']}, {first['law']} law, {first['timestep']:g} s"
        with folder.published(keep=(UNFINISHED,) if result.interrupted else ()):
            asked = {**asdict(result.sweep), "interrupted": result.interrupted}
            folder.write_config("sweep", asked)
            folder.write(_CSV, lambda path: _write_csv(path, result))
            folder.write_json(SUMMARY, result.rows)
            try:
                folder.write(
                    _FIGURE, lambda path: draw_sweep(path, result.rows, over=self.over, title=title)
                )
            except MissingExtraError as error:
                err.print(f"no figure: {error}", highlight=False, markup=False)

    def _status(self, result: SweepResult, *, kept: Path | None) -> int:
        for value, reason in result.failures:
            show_error(f"{self.over} {value:g}: {reason}")
        if result.interrupted:
            where = f", kept in {kept}; the same command goes on" if kept else ""
            show_error(
                f"interrupted: {len(result.rows)} of {result.sweep.points} drops are "
                f"finished{where}"
            )
            return 2 if result.stopped_by is None else 128 + result.stopped_by
        return 2 if result.failures else 0


def _write_csv(path: Path, result: SweepResult) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(result.rows[0]))
        writer.writeheader()
        writer.writerows(result.rows)
