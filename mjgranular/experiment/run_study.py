"""Running of a study, in processes or on Ray."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mjgranular._util.checks import check_kind
from mjgranular.errors import GranularError, InputError
from mjgranular.experiment.custom import Custom, digest
from mjgranular.experiment.drop import Drop, run_drop
from mjgranular.experiment.fall import run_impact
from mjgranular.experiment.impact import Impact
from mjgranular.experiment.intrusion import run_intrusion
from mjgranular.experiment.study import (
    Experiment,
    Study,
    Value,
    column_of,
    value_in_table,
    with_values,
)
from mjgranular.models import robot_path
from mjgranular.pool import Failure, Journal, Mapped, Workers, map_tasks

Row = dict[str, Any]
"""Result of one experiment: plain numbers and names."""


@dataclass(kw_only=True)
class StudyResult(Mapped):
    """Finished part of a study.

    Attributes:
        study: the study.
        journal: journal of the finished rows.
        failures: experiments without a row.
        stopped_by: the signal that interrupted the study before its end; None if none did.
    """

    study: Study

    @property
    def finished(self) -> int:
        """Number of rows."""
        return self.journal.count

    def rows(self) -> Iterator[Row]:
        """Yield the rows, in the order of the study, read from the disk one by one.

        The varied values come first, by `column_of` their names. Angles are in degrees if the name
        says so, everything else is in SI units.
        """
        return self.journal.results()

    def columns(self) -> list[str]:
        """Return the names of all columns of the rows."""
        names: dict[str, None] = {}
        for row in self.rows():
            names |= dict.fromkeys(row)
        return [*names]

    def write_csv(self, path: Path) -> None:
        """Write a CSV file with a line for each row; cells that a row lacks are empty."""
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self.columns())
            writer.writeheader()
            writer.writerows(self.rows())

    def describe(self, failure: Failure) -> str:
        """Return which experiment failed, with what values, and why."""
        table = {column_of(n): value_in_table(n, v) for n, v in self.study[failure.index].items()}
        values = (f"{n}={v:.6g}" if isinstance(v, float) else f"{n}={v}" for n, v in table.items())
        return f"number {failure.index} ({', '.join(values)}): {failure.reason}"


def run_study(
    study: Study,
    *,
    workers: Workers | int | None = None,
    journal: Journal | None = None,
    progress: Callable[[int], None] | None = None,
) -> StudyResult:
    """Run a study in processes that end with this one, or on Ray. Rows are bit-identical.

    Ctrl-C ends it early and keeps what is finished. A process that dies is replaced, and its
    experiments are repeated, for three attempts at most.

    Args:
        study: the experiments.
        workers: where they run, such as `pool.Workers("ray")`; or the number of processes of this
            machine, None for one per core. 1 is this process.
        journal: `journal_of` the study, opened; None for a temporary one.
        progress: called with the number of finished experiments.

    Raises:
        InputError: the first experiment cannot be set up, or the engine cannot be used.
    """
    check_kind(study, Study, "run_study", "Study(experiment, {'speed': [1.0, 2.0]})")
    if journal is not None:
        check_kind(journal, Journal, "run_study", "journal_of(study, folder), opened")
    custom = Custom.of(study)
    if journal is None:
        journal = journal_of(study, None)
        journal.begin()
    if journal.count < len(study):
        _try(study.at(0))
    mapped = map_tasks(
        _row,
        study,  # pyright: ignore[reportArgumentType] - it has what is used of a sequence
        shared=(_with_absolute_path(study.experiment), custom),
        on=Workers.of(workers),
        journal=journal,
        progress=progress,
    )
    return StudyResult(study=study, **vars(mapped))


def journal_of(study: Study, folder: Path | None) -> Journal:
    """Return the journal of a study in a folder; None for a temporary file."""
    check_kind(study, Study, "journal_of")
    # With the contents of files, since an edited model makes another study.
    asked = {**study.config(), "files": digest(study)}
    return Journal(folder, asked, len(study))


def run_experiment(experiment: Experiment) -> Row:
    """Run an experiment, and return its result as one row."""
    if isinstance(experiment, Impact):
        return run_impact(experiment).summary()
    if isinstance(experiment, Drop):
        return run_drop(experiment).row()
    return run_intrusion(experiment).row()


def _try(experiment: Experiment) -> None:
    """Set up the first experiment, and make a step.

    This reports what is wrong with all of them before workers start, and compiles missing machine
    code once, not in all of them.
    """
    short: dict[str, Any] = {"points": 2}
    if isinstance(experiment, Impact):
        short = {"duration": experiment.timestep}
    elif isinstance(experiment, Drop):
        short = {"duration": 1e-9}
    try:
        run_experiment(replace(experiment, **short))
    except GranularError as error:
        if isinstance(error, (InputError, KeyError)):
            raise


def _with_absolute_path(experiment: Experiment) -> Experiment:
    """Return the experiment with a path of its model for workers in other folders."""
    if isinstance(experiment, Impact) or experiment.model is None:
        return experiment
    return replace(experiment, model=robot_path(experiment.model).absolute())


def _row(shared: tuple[Experiment, Custom], values: Mapping[str, Value]) -> Row:
    """Return the row of one experiment, in any process; the varied values come first."""
    experiment, custom = shared
    custom.register()
    varied = {column_of(name): value_in_table(name, value) for name, value in values.items()}
    row = {**varied, **run_experiment(with_values(experiment, values)), **varied}
    # Tables have no infinities: the cell is empty.
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in row.items()
    }
