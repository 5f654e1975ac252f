"""`mjgranular sweep`: an experiment many times, with any of its fields varied."""

import itertools
import json
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from mjgranular._util.parse import parse_number, split_words
from mjgranular._util.result_folder import CONFIG, SUMMARY, ResultFolder
from mjgranular.cli.console import note, out, progress_bar, show_error, table
from mjgranular.cli.drop import DropCommand
from mjgranular.cli.impact import ImpactCommand
from mjgranular.cli.intrude import IntrudeCommand
from mjgranular.cli.options import (
    FilmOptions,
    OutputOptions,
    given_options,
    law_named,
    option,
    parse_command,
    parse_integer,
)
from mjgranular.errors import InputError, MissingExtraError, UnknownNameError, shown
from mjgranular.experiment import Study, StudyResult, journal_of, run_study
from mjgranular.experiment.study import ANGLES, Experiment, Value, column_of
from mjgranular.picture.figures import OUTCOMES, axis_of, draw_study
from mjgranular.pool import UNFINISHED, Journal, Workers

_COMMANDS = {"impact": ImpactCommand, "drop": DropCommand, "intrude": IntrudeCommand}
_MOST_VALUES = 10**6  # of one field; chosen, as are the next three
_ROWS_SHOWN = 40
_FAILURES_SHOWN = 10
_MOST_AXES = 2  # fields in a figure


@dataclass(frozen=True)
class SweepCommand(OutputOptions):
    """Run an experiment many times, with any of its fields varied; by default as in Fig. 5.

    The runs are spread over the cores, or with --engine ray over a cluster. Ctrl-C ends the sweep;
    with --out finished runs are saved, and the same command resumes it.
    """

    vary: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUES ...")] = ("speed=1:10:19",)
    """Values of each varied field; all combinations are run. speed=1:10:19 has 19 values,
    angle=30,45,60 three. Fields of the experiment, law.NAME or medium.density; degrees."""
    of: Annotated[str, tyro.conf.arg(metavar="COMMAND")] = "impact"
    """The experiment: a command in quotes, such as "impact --speed 2 --law rft2d", "drop MODEL.xml
    --slope 15" or "intrude --intruder sphere"."""
    engine: Literal["local", "ray"] = "local"
    """Processes of this machine, or Ray: on this machine, or with --address on a cluster."""
    address: Annotated[str | None, tyro.conf.arg(metavar="auto|HOST:PORT")] = None
    """Head of a Ray cluster; auto for the one that this machine belongs to."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Number of processes. Default: one per core."""

    def run(self) -> int:
        workers = Workers(self.engine, self.workers, self.address)
        varied = read_vary(self.vary)
        study = Study(read_experiment(self.of, varied), varied)
        journal = journal_of(study, self.out)
        names = (CONFIG, SUMMARY, "sweep.csv", "sweep.png")
        with self._resumable(journal, *names) as folder:
            with progress_bar("running", len(study)) as progress:
                result = run_study(study, workers=workers, journal=journal, progress=progress)
            if self.json:
                _print_rows(result)
            else:
                _show(result)
            if folder is not None and result.finished:
                self._write(folder, result)
                self.finish()
        return self._status(result)

    @contextmanager
    def _resumable(self, journal: Journal, *names: str) -> Iterator[ResultFolder | None]:
        """Claim the folder of `--out`, and open the journal of what is finished in it."""
        with closing(journal):
            if self.out is None:
                journal.begin()
                yield None
                return
            fault = journal.fault()
            if fault is not None and (self.out / UNFINISHED).exists():
                note(f"the unfinished sweep in {self.out} cannot be resumed: {fault}")
            claim = ResultFolder(self.out, (*names, UNFINISHED))
            options = {"overwrite": self.overwrite, "goes_on": lambda: journal.fault() is None}
            with claim.claimed(**options) as folder:
                try:
                    journal.begin()
                    if journal.count:
                        note(f"{journal.count} of {len(journal)} are finished")
                    yield folder
                finally:
                    journal.close()
                    if not journal.count:
                        (self.out / UNFINISHED).unlink(missing_ok=True)

    def _write(self, folder: ResultFolder, result: StudyResult) -> None:
        study, unfinished = result.study, result.interrupted or result.lost > 0
        summary = {
            "runs": len(study),
            "finished": result.finished,
            "failed": result.failed,
            "lost": result.lost,
            "interrupted": result.interrupted,
            "failures": [result.describe(failure) for failure in result.failures],
        }
        config = {**study.config(), "interrupted": result.interrupted}
        keep = (UNFINISHED,) if unfinished else ()
        with folder.published("sweep", config, summary, keep=keep):
            folder.write("sweep.csv", result.write_csv)
            try:
                _draw(folder, result)
            except MissingExtraError as error:
                note(f"no figure: {error}")

    def _status(self, result: StudyResult) -> int:
        for failure in result.failures[:_FAILURES_SHOWN]:
            show_error(result.describe(failure))
        if result.failed > _FAILURES_SHOWN:
            where = f"; {SUMMARY} lists them" if self.out else ""
            show_error(f"and {result.failed - _FAILURES_SHOWN} more have no result{where}")
        if result.interrupted:
            saved = f", saved in {self.out}; the same command resumes it" if self.out else ""
            saved = saved if result.finished else ""
            show_error(f"interrupted: {result.finished} of {len(result.study)} are finished{saved}")
            return 128 + (result.stopped_by or 0)
        if result.lost:
            again = "; the same command tries them again" if self.out and result.finished else ""
            show_error(f"{result.lost} runs were lost with their processes{again}")
        return 2 if result.failed else 0


def _print_rows(result: StudyResult) -> None:
    """Print a JSON list row by row: it may not fit into memory."""
    separator = "["
    for row in result.rows():
        sys.stdout.write(f"{separator}\n  {json.dumps(row, allow_nan=False)}")
        separator = ","
    sys.stdout.write("[]\n" if separator == "[" else "\n]\n")


def _show(result: StudyResult) -> None:
    study = result.study
    axes = [axis_of(column_of(name)) for name in study.vary]
    axes += OUTCOMES[type(study.experiment).__name__.lower()]
    cells = (
        [_cell(row.get(axis.column), axis.scale) for axis in axes]
        for row in itertools.islice(result.rows(), _ROWS_SHOWN)
    )
    title = f"{result.finished} runs of {study.experiment.title}"
    out.print(table(title, [axis.label for axis in axes], cells, words=0))
    if result.finished > _ROWS_SHOWN:
        out.print(f"and {result.finished - _ROWS_SHOWN} more")


def _cell(value: object, scale: float) -> str:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return f"{value * scale:.5g}"
    return "" if value is None else str(value)


def _draw(folder: ResultFolder, result: StudyResult) -> None:
    """Draw the outcomes if at most two fields are varied."""
    study = result.study
    varied = [column_of(name) for name in study.vary]
    if len(varied) > _MOST_AXES:
        return
    outcomes = OUTCOMES[type(study.experiment).__name__.lower()]
    names = [*varied, *(axis.column for axis in outcomes)]
    columns: dict[str, list[object]] = {name: [] for name in names}
    for row in result.rows():  # all of them may not fit into memory
        for name in names:
            columns[name].append(row.get(name))
    first = next(result.rows())
    fixed = {"medium": f"{first['medium']}", "law": f"{first['law']} law"}
    words = [text for name, text in fixed.items() if name not in study.vary]
    title = ", ".join([study.experiment.title, *words])
    folder.write("sweep.png", lambda path: draw_study(path, columns, varied, outcomes, title=title))


def read_vary(words: Sequence[str]) -> dict[str, Sequence[Value]]:
    """Read fields and their values from `speed=1:10:19 angle=30,45 law.eta_v=18,26`.

    `FIRST:LAST:COUNT` is evenly spaced, both ends included.
    """
    found: dict[str, Sequence[Value]] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not (equals and name and text):
            raise InputError(
                f"--vary takes NAME=FIRST:LAST:COUNT or NAME=VALUE,VALUE,..., got {shown(word)}"
            )
        if name in found:
            raise InputError(f"{name} is varied twice")
        found[name] = _values(name, text)
    return found


def _values(name: str, text: str) -> Sequence[Value]:
    scale = math.radians(1) if name in ANGLES else 1.0
    parts = text.split(":")
    ends = [parse_number(part) for part in parts[:2]]
    if len(parts) == 1 or name == "law" or None in ends:  # my_laws:Mud is a name
        return [_value(name, part.strip()) for part in text.split(",")]
    low, high = (scale * (end or 0.0) for end in ends)
    if len(parts) != 3:
        raise InputError(f"{name} varies from FIRST:LAST:COUNT, got {shown(text)}")
    try:
        count = parse_integer(parts[2])
    except ValueError as error:
        raise InputError(f"{name}={text}: the number of values {error}") from None
    if not 2 <= count <= _MOST_VALUES:
        raise InputError(f"{name}={text}: there must be 2 to {_MOST_VALUES} values, got {count}")
    if low == high or not (math.isfinite(low) and math.isfinite(high)):
        raise InputError(f"{name}={text}: both ends must be finite, and differ")
    return np.linspace(low, high, count).tolist()


def _value(name: str, text: str) -> Value:
    if not text:
        raise InputError(f"{name} has an empty value: write NAME=VALUE,VALUE,...")
    if name == "law":
        return str(law_named(text))
    number = parse_number(text)
    if number is None:
        return text
    return math.radians(number) if name in ANGLES else number


def read_experiment(text: str, varied: Iterable[str] = ()) -> Experiment:
    """Read the experiment of a command, such as "drop block.xml --slope 15"."""
    words = split_words(text)
    if not words or words[0] not in _COMMANDS:
        raise UnknownNameError("experiment to sweep", (words or [""])[0], _COMMANDS)
    command: Any = parse_command(_COMMANDS, words, program="mjgranular sweep --of")
    for name in given_options(command, *(each.name for each in fields(FilmOptions))):
        raise InputError(f"--{name} is an option of the sweep, not of its runs: omit it in --of")
    for name in given_options(command, *varied):
        raise InputError(
            f"{name} is varied, and {option(name)} {shown(getattr(command, name))} fixes it: omit "
            "one of the two"
        )
    return command.experiment()
