"""A study, run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mjgranular._util.checks import check_kind
from mjgranular.errors import GranularError, InputError
from mjgranular.experiment.baggage import Baggage, pack, unpack
from mjgranular.experiment.drop import Drop, run_drop
from mjgranular.experiment.fall import run_impact
from mjgranular.experiment.impact import Impact
from mjgranular.experiment.intrusion import run_intrusion
from mjgranular.experiment.rows import Row, row_of
from mjgranular.experiment.study import Experiment, Study, Value, column_of, value_in_table
from mjgranular.pool import Failure, Journal, Workers, map_tasks


@dataclass(frozen=True)
class StudyResult:
    """Finished part of a study.

    Attributes:
        study: what was asked for.
        journal: with the rows that are finished, on disk.
        failures: experiments without a row; the first 1000 of them.
        failed: how many there are.
        lost: how many of these were lost with the processes that they ran in.
        interrupted: whether it was broken off before its end.
        stopped_by: the signal that did so; None if none did.
    """

    study: Study
    journal: Journal
    failures: list[Failure]
    failed: int
    lost: int
    interrupted: bool
    stopped_by: int | None = None

    @property
    def finished(self) -> int:
        """How many rows there are."""
        return self.journal.count

    def rows(self) -> Iterator[Row]:
        """The rows, in the order of the study, read from the disk one by one.

        The values that were varied come first, by `column_of` their names; angles in degrees where
        the name says so, all else SI.
        """
        return self.journal.results()

    def columns(self) -> list[str]:
        """Names of all columns that rows have."""
        names: dict[str, None] = {}
        for row in self.rows():
            names |= dict.fromkeys(row)
        return [*names]

    def told(self, failure: Failure) -> str:
        """A failure in words: which experiment, with what values, and why."""
        values = (
            f"{column_of(name)}={_short(value_in_table(name, value))}"
            for name, value in self.study[failure.index].items()
        )
        return f"number {failure.index} ({', '.join(values)}): {failure.reason}"


def run_study(
    study: Study,
    *,
    workers: Workers | int | None = None,
    journal: Journal | None = None,
    progress: Callable[[int], None] | None = None,
) -> StudyResult:
    """Runs a study in processes that end with this one, or on Ray. Rows are the same to the bit.

    Ctrl-C ends it early and keeps what is finished. A process that dies is replaced, and its chunk
    done again, three times at most.

    Args:
        study: the experiments.
        workers: where they run, such as `pool.Workers("ray")`; or how many processes of this
            machine at once, None for one a core. 1 is this process.
        journal: `journal_of` the study, begun; None for one that is gone with the result.
        progress: called with the number of experiments done.

    Raises:
        InputError: the first experiment cannot be set up, or the engine cannot be used.
    """
    check_kind(study, Study, "run_study", "Study(experiment, {'speed': [1.0, 2.0]})")
    if journal is not None:
        check_kind(journal, Journal, "run_study", "journal_of(study, folder), begun")
    baggage = pack(study)
    if journal is None:
        journal = journal_of(study, None)
        journal.begin()
    if journal.count < len(study):
        _try(study.at(0))
    found = map_tasks(
        _row,
        study,  # pyright: ignore[reportArgumentType] - what is asked of a sequence, it has
        shared=(study.experiment, baggage),
        on=Workers.of(workers),
        journal=journal,
        progress=progress,
    )
    return StudyResult(
        study,
        journal,
        found.failures,
        found.failed,
        found.lost,
        found.interrupted,
        found.stopped_by,
    )


def journal_of(study: Study, folder: Path | None) -> Journal:
    """The rows of a study that a folder keeps; None for a file that is soon gone."""
    check_kind(study, Study, "journal_of")
    # The contents, so that an edited model is another study.
    asked = {**study.config(), "files": pack(study).digest()}
    return Journal(folder, asked, len(study), _is_row)


def _try(experiment: Experiment) -> None:
    """Sets the first experiment up and makes a step.

    What is wrong with all of them is reported before workers start, and machine code that is not
    there yet is compiled once, not by all of them.

    Raises:
        InputError: it cannot be set up.
    """
    try:
        if isinstance(experiment, Impact):
            run_impact(replace(experiment, duration=experiment.timestep))
        elif isinstance(experiment, Drop):
            run_drop(replace(experiment, duration=1e-9))
        else:
            run_intrusion(replace(experiment, points=2))
    except GranularError as error:
        if isinstance(error, (InputError, KeyError)):
            raise


_here: dict[tuple[str, int, str], Experiment] = {}  # what this process has unpacked


def _row(shared: tuple[Experiment, Baggage], values: Mapping[str, Value]) -> Row:
    """One row, in whatever process."""
    experiment, baggage = shared
    key = (*baggage.origin, baggage.name)
    if key not in _here:
        _here.clear()
        _here[key] = unpack(baggage, experiment)
    return _finite_row(row_of(_here[key], values))


def _finite_row(row: Row) -> Row:
    return {name: _finite(value) for name, value in row.items()}


def _finite(value: Any) -> Any:
    """Tables have no infinities: there the cell is empty."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _is_row(row: Mapping[str, Any]) -> bool:
    return all(
        value is None or (isinstance(value, (str, bool, int, float)) and len(str(value)) < 10_000)
        for value in row.values()
    )


def _short(value: Value) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
