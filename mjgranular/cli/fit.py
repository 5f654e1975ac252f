"""`mjgranular fit`: a medium from measurements."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.table import Table
from rich.text import Text

from mjgranular._util import files
from mjgranular.calibrate import Errors, Fit, FitResult, read_fit, run_fit
from mjgranular.calibrate.medium import fitted_medium, medium_text
from mjgranular.cli.console import out, print_json, progress_bar, show_error, table
from mjgranular.cli.options import law_named
from mjgranular.errors import InputError, MissingExtraError, OutputError
from mjgranular.pool.versions import versions

_ROUNDS = 12  # of a fit, as a guess for the progress bar


@dataclass(frozen=True)
class FitCommand:
    """A medium from your own measurements: drops, pushes and drags, fitted by a law's constants.

    Prints values with 95 % intervals, which constants the data tell apart and which further test
    would, and the errors of each run. With --out FILE.yaml, writes a medium that --medium takes,
    with a figure of the curves and the whole result beside it.
    """

    runs: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUNS.yaml")]
    """What is known of the medium, and the runs, with their CSV files (docs/calibration.md)."""
    law: Annotated[str | None, tyro.conf.arg(metavar="LAW")] = None
    """The force law; see `mjgranular list laws`. Default: that of the medium's base."""
    free: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Constants that are looked for: strength, a factor on static resistance, or any number that
    the law has, such as inertia."""
    hold_out: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Runs that are not fitted to, but predicted."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE.yaml")] = None
    """File for the medium; nothing is written without it."""
    overwrite: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Replace a medium that is there already, and what lies beside it."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print one JSON object instead of tables."""

    def run(self) -> int:
        """Runs the command."""
        fit = read_fit(self.runs, law=law_named(self.law), free=self.free, hold_out=self.hold_out)
        if self.out is None:
            self._show(self._run(fit))
            return 0
        names = _names(self.out)
        with files.locked(self.out.parent, f".{self.out.name}{files.LOCK}"):
            if not self.overwrite:
                _refuse_present(self.out.parent, names)
            result = self._run(fit)
            problem = self._write(fit, result, self.out.parent, names)
        self._show(result)
        if not self.json:
            out.print(f"written to {self.out}", highlight=False, markup=False)
        if problem:
            show_error(f"{problem} (the medium is in {self.out})")
        return 2 if problem else 0

    def _run(self, fit: Fit) -> FitResult:
        guess = len(fit.runs) * (1 + 2 * len(fit.free)) * _ROUNDS
        with ExitStack() as stack:
            bars: list[Callable[[float, str], None]] = []

            def progress(done: int, what: str) -> None:
                if not bars:  # the data are read and good
                    bars.append(stack.enter_context(progress_bar(what, guess)))
                bars[0](min(done, 0.95 * guess), what)

            return run_fit(fit, progress=progress)

    def _write(self, fit: Fit, result: FitResult, folder: Path, names: Sequence[str]) -> str | None:
        """Writes the medium last: where it is, all is. Returns what could not be drawn."""
        medium_file, details, figure = names
        fitted = [run.name for run in fit.runs if run.name not in fit.hold_out]
        medium = fitted_medium(
            result, Path(medium_file).stem, source=f"{self.runs.name} ({', '.join(fitted)})"
        )
        problem = None
        try:
            from mjgranular.picture.fits import draw_fit

            draw_fit(folder / figure, result)
        except MissingExtraError as error:
            problem = str(error)
        content = {
            "command": "fit",
            "config": {**fit.config(), "file": str(self.runs)},
            "result": result.summary(),
            "versions": versions("scipy"),
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        text = json.dumps(content, indent=2, allow_nan=False) + "\n"
        files.write_text(folder / details, text)
        files.write_text(folder / medium_file, medium_text(medium))
        return problem

    def _show(self, result: FitResult) -> None:
        if self.json:
            print_json(result.summary())
            return
        out.print(_constants(result))
        for line in sentences(result):
            out.print(line, highlight=False)
        for title, errors in (("Fitted", result.runs), ("Predicted", result.held_out)):
            if errors:
                out.print(_errors(title, errors))


def sentences(result: FitResult) -> list[str]:
    """What the data say and do not say, for people."""
    found = []
    for valley in result.valleys:
        moves = ", ".join(
            f"{name} by {10 * change:+.0f} %" for name, change in valley.change.items()
        )
        together = "change together" if len(valley.change) > 1 else "changes"
        found.append(
            f"These data do not tell apart: {moves} {together} the curves by "
            f"{100 * valley.effect:.2g} %."
        )
        if valley.one_speed:
            found.append(
                "All runs are of one speed: the intervals hold only if the law is right to "
                "the last, and say nothing on other speeds."
            )
    wide = [name for name, good in result.identifiable.items() if not good]
    if wide and not result.valleys:
        found.append(f"These data say little of {', '.join(wide)}: the interval is wide.")
    if result.further:
        found.append("What a further test would leave, by this law:")
    for test in result.further:
        widths = ", ".join(f"{name} {_percent(width)}" for name, width in test.intervals.items())
        enough = "" if test.identifiable else ", which is not enough"
        found.append(f"- {test.what}: {widths}{enough}")
    for name in result.at_bound:
        found.append(f"{name} ended on a bound of the law: another law may be needed.")
    if result.residual > 0.05:
        found.append(
            f"The law misses the curves by {100 * result.residual:.0f} % on average: intervals are "
            "those of the best constants of this law, not of constants of the sand."
        )
    return found


def _percent(width: float) -> str:
    return f"+-{100 * width:.2g} %" if width < 10 else "not at all"


def _constants(result: FitResult) -> Table:
    made = Table(title=f"Constants of {result.material.law.name}", title_justify="left")
    for heading in ("constant", "value", "95 % interval", "unit", "determined"):
        justify = "right" if heading in ("value", "95 % interval") else "left"
        made.add_column(Text(heading), justify=justify)
    for name, value in result.values.items():
        low, high = ("..." if end is None else f"{end:.4g}" for end in result.intervals[name])
        determined = "yes" if result.identifiable[name] else "no"
        unit = "" if name == "strength" else result.material.unit(name)
        made.add_row(name, f"{value:.4g}", f"{low} to {high}", unit, determined)
    return made


def _errors(title: str, errors: dict[str, Errors] | Any) -> Table:
    cells = [
        (
            name,
            *(
                "" if cell is None else f"{100 * cell:+.1f}"
                for cell in (error.depth, error.stopping_time, error.force)
            ),
            f"{100 * error.trajectory:.1f}",
        )
        for name, error in errors.items()
    ]
    headings = ("run", "depth", "stopping time", "force", "whole curve")
    return table(f"{title}: errors [%]", headings, cells)


def _names(path: Path) -> tuple[str, str, str]:
    """Names of the medium's file, of the result and of the figure."""
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(
            f"a medium's file ends in .yaml, not {path.name!r}: --medium knows it by that"
        )
    if not path.parent.is_dir():
        raise InputError(f"there is no folder {path.parent} to write {path.name} to: make it first")
    return path.name, f"{path.stem}.fit.json", f"{path.stem}.fit.png"


def _refuse_present(folder: Path, names: Sequence[str]) -> None:
    present = [name for name in names if (folder / name).exists()]
    if present:
        raise OutputError(
            f"{folder / present[0]} is there already: choose another name, or say --overwrite"
        )
