"""`mjgranular sweep`: many drops."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mjgranular.cli import study
from mjgranular.cli.console import err, out, print_json, progress_bar, show_error, table
from mjgranular.cli.engines import EngineOptions, check_resumed
from mjgranular.cli.options import LinkOptions, given_options, option
from mjgranular.cli.vary import read_experiment, read_vary, refuse_fixed
from mjgranular.errors import InputError, MissingExtraError
from mjgranular.experiment import Impact, Study, Sweep, SweepResult, run_sweep
from mjgranular.experiment.folder import CONFIG, SUMMARY, ResultFolder
from mjgranular.experiment.table import write_csv
from mjgranular.pool import UNFINISHED, Journal

_CSV = "sweep.csv"
_FIGURE = "sweep.png"
_RANGE = {"speed": (1.0, 10.0, 19), "angle": (30.0, 60.0, 31)}  # as in the paper's Figs. 5 and 9


@dataclass(frozen=True)
class SweepCommand(LinkOptions, EngineOptions):
    """Many drops over a range of speeds or angles, as in Figs. 5 and 9 of the paper, or any others.

    --vary names what differs: fields of the experiment, law.NAME, medium.density. The runs are
    spread over the cores, or with --engine ray over a cluster. Ctrl-C ends the sweep; with --out
    what is finished is kept, whatever ended it, and the same command goes on.
    """

    over: Literal["speed", "angle"] = "speed"
    """What differs from drop to drop, without --vary."""
    first: Annotated[float | None, tyro.conf.arg(metavar="M/S|DEG")] = None
    """First value [m/s or degrees]. Default: 1 m/s, 30 degrees."""
    last: Annotated[float | None, tyro.conf.arg(metavar="M/S|DEG")] = None
    """Last value [m/s or degrees]. Default: 10 m/s, 60 degrees."""
    points: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Number of drops. Default: 19 speeds, 31 angles."""
    vary: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUES ...")] = ()
    """What differs from run to run, every value with every other: speed=1:10:19 has 19 values,
    angle=30,45,60 three, law.eta_v=18:26:5 five. Angles in degrees."""
    sample: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Draw N points from ranges such as --vary speed=1:10 in place of a grid."""
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Of --sample."""
    method: Literal["latin", "sobol"] = "latin"
    """Of --sample: a Latin hypercube or a Sobol sequence."""
    of: Annotated[str | None, tyro.conf.arg(metavar="COMMAND")] = None
    """What is run, in place of a drop of the link: a command in quotes, "drop MODEL.xml --slope 15"
    or "intrude --intruder sphere" or "impact --body sphere". With --vary."""
    table: Literal["csv", "parquet"] = "csv"
    """Form of the table in the folder of --out, with --vary."""
    speed: Annotated[float | None, tyro.conf.arg(metavar="M/S")] = None
    """Speed of T where it is not varied [m/s]. Default: 2."""
    angle: Annotated[float | None, tyro.conf.arg(metavar="DEG")] = None
    """Angle from the vertical where it is not varied [degrees]. Default: 45."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the results; nothing is written without it."""
    overwrite: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Replace a result that the folder holds already."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print a JSON list instead of a table."""

    def run(self) -> int:
        """Runs the command."""
        _ = self.where  # which checks itself
        if self.resume and (self.out is None or self.overwrite):
            raise InputError("--resume goes on with the folder of --out, and overwrites nothing")
        if self.vary:
            return study.run(
                self._study(),
                self.where,
                place=self.out,
                overwrite=self.overwrite,
                resume=self.resume,
                as_json=self.json,
                parquet=self.table == "parquet",
            )
        self._only("of", "sample", "seed", "method", "table", wants="is for --vary")
        other = "angle" if self.over == "speed" else "speed"
        self._only(
            self.over,
            wants=f"is fixed, and this sweep goes over the {self.over}, from --first to --last: "
            f"leave it away, or say --over {other}",
        )
        sweep = self._sweep()
        journal = sweep.journal(self.out)
        if self.out is None:
            result = self._run(sweep, journal)
            self._show(result)
            return self._status(result, kept=None)
        names = (CONFIG, SUMMARY, _CSV, _FIGURE, UNFINISHED)
        if self.resume:
            check_resumed(journal, self.out)
        with ResultFolder(self.out, names).claimed(
            overwrite=self.overwrite, goes_on=journal.goes_on
        ) as folder:
            try:
                result = self._run(sweep, journal)
                self._show(result)
                if result.rows:
                    self._write(folder, result)
                    if not self.json:
                        out.print(f"written to {self.out}", highlight=False, markup=False)
            finally:
                journal.close()
                if not journal.count:
                    (self.out / UNFINISHED).unlink(missing_ok=True)
            return self._status(result, kept=self.out if result.rows else None)

    def _only(self, *names: str, wants: str) -> None:
        """Refuses options that would do nothing.

        Raises:
            InputError: one of them is given; says what it wants beside it.
        """
        for name in given_options(self, *names):
            raise InputError(f"{option(name)} {wants}")

    def _study(self) -> Study:
        self._only("over", "first", "last", "points", wants="is for a sweep without --vary")
        if self.sample is None:
            self._only("seed", "method", wants="is for --sample")
        varied = read_vary(self.vary)
        if self.of is not None:
            inside = (*(field.name for field in fields(LinkOptions)), "speed", "angle")
            self._only(*inside, wants="belongs inside the quotes of --of, with its command")
            experiment = read_experiment(self.of, varied)
        else:
            refuse_fixed(self, varied)
            experiment = self._impact()
        return Study(experiment, varied, sample=self.sample, seed=self.seed, method=self.method)

    def _impact(self) -> Impact:
        return self.impact(
            speed=2.0 if self.speed is None else self.speed,
            angle_deg=45.0 if self.angle is None else self.angle,
        )

    def _sweep(self) -> Sweep:
        first, last, points = _RANGE[self.over]
        first = first if self.first is None else self.first
        last = last if self.last is None else self.last
        if self.over == "angle":
            first, last = math.radians(first), math.radians(last)
        return Sweep(
            over=self.over,
            first=first,
            last=last,
            points=points if self.points is None else self.points,
            impact=self._impact(),
        )

    def _run(self, sweep: Sweep, journal: Journal) -> SweepResult:
        journal.begin()
        if journal.count:
            err.print(f"{journal.count} of {sweep.points} drops are finished", style="dim")
        with progress_bar("dropping links", sweep.points) as progress:
            return run_sweep(
                sweep,
                workers=self.where,
                progress=progress,
                journal=journal,
            )

    def _show(self, result: SweepResult) -> None:
        if self.json:
            print_json(result.rows)
            return
        key, name = {"speed": ("speed", "speed [m/s]"), "angle": ("angle_deg", "angle [deg]")}[
            self.over
        ]
        cells = [
            (
                f"{row[key]:.4g}",
                "not stopped" if time is None else f"{time * 1e3:.3f}",
                f"{row['depth'] * 1e3:.3f}",
            )
            for row in result.rows
            for time in [row["stopping_time"]]
        ]
        headings = (name, "stopping time [ms]", "depth of T [mm]")
        out.print(table(f"Drops over the {self.over}", headings, cells, words=0))

    def _write(self, folder: ResultFolder, result: SweepResult) -> None:
        from mjgranular.picture.figures import draw_sweep

        first = result.rows[0]
        fixed = f"{first['angle_deg']:g} deg" if self.over == "speed" else f"{first['speed']:g} m/s"
        title = f"{fixed}, {first['medium']}, {first['law']} law, {first['timestep']:g} s"
        goes_on = result.interrupted or result.lost > 0
        with folder.published(keep=(UNFINISHED,) if goes_on else ()):
            asked = {**asdict(result.sweep), "interrupted": result.interrupted}
            folder.write_config("sweep", asked)
            columns = list(result.rows[0])
            folder.write(_CSV, lambda path: write_csv(path, columns, lambda: iter(result.rows)))
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
