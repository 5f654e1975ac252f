"""`mjgranular fit`: a medium from measurements."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from mjgranular._util.result_folder import ResultFolder
from mjgranular.calibrate import Errors, Fit, FitResult, read_fit, run_fit
from mjgranular.calibrate.medium import fitted_medium, medium_text
from mjgranular.cli.console import out, print_json, progress_bar, show_error, table
from mjgranular.cli.options import Flag, collected, law_named
from mjgranular.errors import InputError
from mjgranular.picture.figures import draw_fit

_ROUNDS = 12  # of a fit, as a guess for the progress bar


@dataclass(frozen=True)
class FitCommand:
    """Fit a medium to your own measurements of drops, pushes and drags.

    Prints the constants of a law with 95 % intervals, which of them the data separate, and the
    errors of each run. With --out FILE.yaml, writes a medium that --medium takes, with a figure
    of the curves next to it.
    """

    runs: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUNS.yaml")]
    """Properties of the medium, and the runs, with their CSV files (docs/calibration.md)."""
    law: Annotated[str | None, tyro.conf.arg(metavar="LAW")] = None
    """The force law; see `mjgranular list laws`. Default: that of the medium's base."""
    free: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Constants to fit: strength, a factor on static resistance, or any number of the law, such as
    inertia."""
    hold_out: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Runs that are not fitted to, but predicted."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE.yaml")] = None
    """File for the medium; nothing is written without it."""
    overwrite: Flag = False
    """Replace a medium that exists, and the figure next to it."""
    json: Flag = False
    """Print one JSON object instead of tables."""

    def run(self) -> int:
        fit = read_fit(self.runs, law=law_named(self.law), free=self.free, hold_out=self.hold_out)
        if self.out is None:
            self._show(_run(fit))
            return 0
        if self.out.suffix not in (".yaml", ".yml"):
            raise InputError(f"--out must be a file that ends in .yaml, got {str(self.out)!r}")
        if self.out.resolve() == self.runs.resolve():
            raise InputError(f"--out must not be the file of the runs, {self.out}")
        if not self.out.parent.is_dir():
            raise InputError(f"there is no folder {self.out.parent} for {self.out.name}: make it")
        figure, problems = self.out.with_suffix(".fit.png").name, []
        folder = ResultFolder(self.out.parent, (self.out.name, figure))
        with folder.claimed(overwrite=self.overwrite):
            result = _run(fit)
            with collected(problems):
                folder.write(figure, lambda path: draw_fit(path, result))
            fitted = ", ".join(run.name for run in fit.runs if run.name not in fit.hold_out)
            source = f"{self.runs.name} ({fitted})"
            text = medium_text(fitted_medium(result, self.out.stem, source=source))
            # Last: if it exists, all files do.
            folder.write(self.out.name, lambda path: path.write_text(text, encoding="utf-8"))
        self._show(result)
        if not self.json:
            out.print(f"written to {self.out}")
        for problem in problems:
            show_error(f"{problem} (the medium is in {self.out})")
        return 2 if problems else 0

    def _show(self, result: FitResult) -> None:
        if self.json:
            print_json(result.summary())
            return
        out.print(_constants(result))
        for line in sentences(result):
            out.print(line)
        for title, errors in (("Fitted", result.runs), ("Predicted", result.held_out)):
            if errors:
                out.print(_errors(title, errors))


def _run(fit: Fit) -> FitResult:
    guess = len(fit.runs) * (1 + 2 * len(fit.free)) * _ROUNDS
    with progress_bar("fitting", guess) as show:
        return run_fit(fit, progress=lambda done: show(min(done, 0.95 * guess)))


def sentences(result: FitResult) -> Iterator[str]:
    """Yield what the data determine and what they do not."""
    for valley in result.valleys:
        moves = ", ".join(f"{name} by {10 * part:+.0f} %" for name, part in valley.change.items())
        together = "change together" if len(valley.change) > 1 else "changes"
        yield (
            f"These data do not tell apart: {moves} {together} the curves by "
            f"{100 * valley.effect:.2g} %."
        )
        if valley.one_speed:
            yield (
                "All runs have one speed: the intervals hold only if the law is exact, and say "
                "nothing about other speeds."
            )
    wide = [name for name, good in result.identifiable.items() if not good]
    if wide and not result.valleys:
        yield f"These data say little about {', '.join(wide)}: the interval is wide."
    for name in result.at_bound:
        yield f"{name} ended on a bound of the law: another law may be needed."
    if result.residual > 0.05:
        yield (
            f"The law misses the curves by {100 * result.residual:.0f} % on average: intervals are "
            "those of the best constants of this law, not of constants of the sand."
        )


def _constants(result: FitResult) -> Table:
    rows = []
    for name, value in result.values.items():
        low, high = ("..." if end is None else f"{end:.4g}" for end in result.intervals[name])
        determined = "yes" if result.identifiable[name] else "no"
        rows.append((name, f"{value:.4g}", f"{low} to {high}", determined))
    headings = ("constant", "value", "95 % interval", "determined")
    return table(f"Constants of {result.material.law.name}", headings, rows)


def _errors(title: str, errors: Mapping[str, Errors]) -> Table:
    rows = []
    for name, error in errors.items():
        numbers = (error.depth, error.stopping_time, error.force)
        signed = ["" if number is None else f"{100 * number:+.1f}" for number in numbers]
        rows.append((name, *signed, f"{100 * error.trajectory:.1f}"))
    headings = ("run", "depth", "stopping time", "force", "whole curve")
    return table(f"{title}: errors [%]", headings, rows)
