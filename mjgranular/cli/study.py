"""`mjgranular sweep --vary`: an experiment with any of its fields varied."""

from __future__ import annotations

import itertools
import json
import sys
from contextlib import nullcontext
from pathlib import Path

from mjgranular.cli.console import err, out, progress_bar, show_error, table
from mjgranular.cli.engines import check_resumed
from mjgranular.errors import InputError, MissingExtraError
from mjgranular.experiment import Impact, Study, StudyResult, journal_of, run_study
from mjgranular.experiment.folder import CONFIG, SUMMARY, ResultFolder
from mjgranular.experiment.study import column_of
from mjgranular.experiment.table import need_parquet, write_csv, write_parquet
from mjgranular.pool import UNFINISHED, Journal, Workers

CSV, PARQUET, FIGURE = "sweep.csv", "sweep.parquet", "sweep.png"
_SHOWN = 40  # rows of the table for people; chosen, as are these
_TOLD = 10  # failures
_DRAWN = 2  # fields that a figure has room for


def run(
    study: Study,
    on: Workers,
    *,
    place: Path | None,
    overwrite: bool,
    resume: bool,
    as_json: bool,
    parquet: bool,
) -> int:
    """Runs a study, shows it and writes it.

    Args:
        study: the runs.
        on: where they are done.
        place: folder for the result; None for none.
        overwrite: whether a result there is replaced.
        resume: whether there has to be an unfinished one there.
        as_json: whether rows are shown as JSON.
        parquet: whether the table is a Parquet file.
    """
    if parquet:
        if place is None:
            raise InputError("--table is of the folder of --out")
        need_parquet()
    journal = journal_of(study, place)
    names = (CONFIG, SUMMARY, CSV, PARQUET, FIGURE, UNFINISHED)
    folder = None if place is None else ResultFolder(place, names)
    claimed = nullcontext()
    if folder is not None:
        if resume:
            check_resumed(journal, place)
        claimed = folder.claimed(overwrite=overwrite, goes_on=journal.goes_on)
    with claimed:
        try:
            journal.begin()
            if journal.count:
                err.print(f"{journal.count} of {len(study)} runs are finished", style="dim")
            with progress_bar("running", len(study)) as progress:
                result = run_study(
                    study,
                    workers=on,
                    journal=journal,
                    progress=progress,
                )
            _show(result, as_json=as_json)
            if folder is not None and result.finished:
                _write(folder, result, parquet=parquet)
                if not as_json:
                    out.print(f"written to {place}", highlight=False, markup=False)
        finally:
            journal.close()
            _remove_empty(journal, place)
    return _status(result, place)


def _remove_empty(journal: Journal, folder: Path | None) -> None:
    """Leaves no file behind of a run of which nothing is finished."""
    if folder is not None and not journal.count:
        (folder / UNFINISHED).unlink(missing_ok=True)


def _show(result: StudyResult, *, as_json: bool) -> None:
    if as_json:
        _print_rows(result)
        return
    from mjgranular.picture.studies import OUTCOMES, axis_of

    study = result.study
    axes = [axis_of(column_of(name)) for name in study.vary]
    axes += OUTCOMES[type(study.experiment).__name__.lower()]
    title = f"{result.finished} runs of {_title(study)}"
    cells = [
        [_cell(row.get(axis.column), axis.scale) for axis in axes]
        for row in itertools.islice(result.rows(), _SHOWN)
    ]
    out.print(table(title, [axis.label for axis in axes], cells, words=0))
    if result.finished > _SHOWN:
        out.print(f"and {result.finished - _SHOWN} more", highlight=False)


def _print_rows(result: StudyResult) -> None:
    """A JSON list, row by row."""
    between = "["
    for row in result.rows():
        sys.stdout.write(f"{between}\n  {json.dumps(row, allow_nan=False)}")
        between = ","
    sys.stdout.write("[]\n" if between == "[" else "\n]\n")


def _cell(value: object, scale: float) -> str:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return f"{value * scale:.5g}"
    return "" if value is None else str(value)


def _title(study: Study) -> str:
    base = study.experiment
    if isinstance(base, Impact):
        return base.body
    return getattr(base, "title", None) or (base.model.name if base.model else base.intruder)  # pyright: ignore


def _write(folder: ResultFolder, result: StudyResult, *, parquet: bool) -> None:
    columns = result.columns()
    goes_on = result.interrupted or result.lost > 0
    study = result.study
    summary = {
        "runs": len(study),
        "finished": result.finished,
        "failed": result.failed,
        "lost": result.lost,
        "interrupted": result.interrupted,
        "failures": [result.told(failure) for failure in result.failures],
    }
    with folder.published(keep=(UNFINISHED,) if goes_on else ()):
        folder.write_config("sweep", {**study.config(), "interrupted": result.interrupted})
        folder.write_json(SUMMARY, summary)
        name, write = (PARQUET, write_parquet) if parquet else (CSV, write_csv)
        folder.write(name, lambda path: write(path, columns, result.rows))
        try:
            _draw(folder, result)
        except MissingExtraError as error:
            err.print(f"no figure: {error}", highlight=False, markup=False)


def _draw(folder: ResultFolder, result: StudyResult) -> None:
    """Draws the figure, if so few fields are varied that there is one."""
    from mjgranular.picture.studies import OUTCOMES, draw_study

    study = result.study
    varied = [column_of(name) for name in study.vary]
    if len(varied) > _DRAWN:
        return
    outcomes = OUTCOMES[type(study.experiment).__name__.lower()]
    wanted = [*varied, *(axis.column for axis in outcomes)]
    columns: dict[str, list[object]] = {name: [] for name in wanted}
    for row in result.rows():
        for name in wanted:
            columns[name].append(row.get(name))
    first = next(result.rows())
    title = f"{_title(study)}, {first['medium']}, {first['law']} law"
    title = title if "law" not in study.vary and "medium" not in study.vary else _title(study)
    folder.write(
        FIGURE,
        lambda path: draw_study(
            path, columns, varied, outcomes, joined=study.sample is None, title=title
        ),
    )


def _status(result: StudyResult, folder: Path | None) -> int:
    for failure in result.failures[:_TOLD]:
        show_error(result.told(failure))
    if result.failed > _TOLD:
        where = f"; {SUMMARY} has them" if folder else ""
        show_error(f"and {result.failed - _TOLD} more have no result{where}")
    kept = folder is not None and result.finished > 0
    where = f", kept in {folder}; the same command goes on" if kept else ""
    of = f"{result.finished} of {len(result.study)} runs are finished{where}"
    if result.interrupted:
        show_error(f"interrupted: {of}")
        return 2 if result.stopped_by is None else 128 + result.stopped_by
    if result.lost:
        show_error(f"{result.lost} runs were lost with their processes: {of}")
    return 2 if result.failed else 0
