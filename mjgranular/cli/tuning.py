"""`mjgranular train --search`: which settings an environment is best trained with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.table import Table
from rich.text import Text

from mjgranular.cli.console import err, out, print_json, progress_bar, show_error
from mjgranular.errors import InputError
from mjgranular.learn.run import Run
from mjgranular.learn.run_tuning import run_study
from mjgranular.learn.settings import Settings
from mjgranular.learn.trial import FAILED
from mjgranular.learn.tuning import (
    BEST,
    TABLE,
    Outcome,
    Study,
    Tuning,
    begin_study,
    check_models,
    check_place,
    is_study,
    open_study,
    value_text,
)
from mjgranular.pool import Workers

_SHOWN = 20  # trials of the table for people; chosen
_ALONE = ("trials", "scheduler", "workers")


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """Options of a search over settings."""

    search: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME=VALUES ...")] = None
    """Try settings, each point a training of --total-steps, and write the best to a file: a grid of
    gamma=0.95,0.99 batch_size=64,128 learning_rate=1e-4:1e-2:5:log, or with --trials drawn from
    ranges such as learning_rate=1e-4:1e-2:log. --resume DIR goes on with it."""
    trials: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """With --search: draw N points from its ranges and lists, in place of the grid."""
    scheduler: Annotated[Literal["none", "asha"], tyro.conf.arg(metavar="none|asha")] = "none"
    """With --search and --engine ray: asha trains the better third on after a ninth of the budget,
    and again after a third. Cheaper; which trials end early depends on which came first."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """With --search: trials at once, one a core. Default: as many as there are cores."""


def is_search(options: SearchOptions, resume: Path | None) -> bool:
    """Whether a search is begun or gone on with.

    Raises:
        InputError: options of a search are given to a single training.
    """
    if options.search is not None or (resume is not None and is_study(resume)):
        return True
    defaults = SearchOptions()
    for name in _ALONE:
        if getattr(options, name) != getattr(defaults, name):
            instead = "; --env-runners shares one training's environments"
            raise InputError(f"--{name} is for --search{instead if name == 'workers' else ''}")
    return False


def search_anew(
    options: SearchOptions,
    environment: str,
    settings: Settings,
    *,
    seed: int,
    path: Path,
    changed: tuple[str, ...],
    on: Workers,
    as_json: bool,
) -> int:
    """Begins a search, and does it.

    Args:
        options: of the search.
        environment: Gymnasium's id.
        settings: of all trials.
        seed: of all of them.
        path: of the folder.
        changed: what --set says.
        on: where trials are trained.
        as_json: whether JSON is printed.
    """
    tuning = Tuning(
        environment,
        settings,
        tuple(options.search or ()),
        options.trials,
        options.scheduler,
        seed,
    )
    for word in changed:
        name = word.partition("=")[0].strip()
        if name in tuning.space:
            raise InputError(
                f"{name} is searched over, and --set {word} fixes it: leave one of the two away"
            )
    check_place(tuning, on)
    check_models(tuning)
    study = begin_study(path, tuning)
    try:
        return _done(study, on, as_json)
    except InputError:
        study.discard()
        raise


def search_on(path: Path, on: Workers, *, trust: bool, as_json: bool) -> int:
    """Goes on with the search in a folder."""
    study = open_study(path)
    tuning = study.tuning
    run = Run(path, tuning.environment, tuning.settings, tuning.seed, {}, trusted=trust)
    run.check_environment()
    check_place(study.tuning, on)
    if study.is_finished():
        err.print(
            f"nothing to do: all {len(study.tuning)} trials are in {path / TABLE}", highlight=False
        )
        return 0
    return _done(study, on, as_json)


def _done(study: Study, on: Workers, as_json: bool) -> int:
    with study.opened():
        total = len(study.tuning)
        if study.journal.count:
            err.print(f"{study.journal.count} of {total} trials are finished", style="dim")
        with progress_bar("trials", total, remaining=True) as show:

            def progress(done: int) -> None:
                best = study.best()
                reached = "" if best is None else f", best return {best['return']:.4g}"
                show(done, f"{done} of {total} trials{reached}")

            outcome = run_study(study, on, progress)
        _tell(study, outcome, as_json)
        return _status(study, outcome)


def _tell(study: Study, outcome: Outcome, as_json: bool) -> None:
    rows, best = study.rows(), study.best()
    if as_json:
        print_json(
            {
                **study.tuning.config(),
                "folder": str(study.path),
                "finished": len(rows) == len(study.tuning),
                "best": None if best is None else best["trial"],
                "rows": rows,
            }
        )
        return
    if not rows:
        return
    out.print(_table(study, rows))
    if best is None:
        return
    for name in study.at_ends():
        out.print(
            f"The best {name} is at an end of what was searched: better ones may lie beyond.",
            highlight=False,
        )
    out.print(
        f"best settings in {study.path / BEST}: mjgranular train {study.tuning.environment} "
        f"--settings {study.path / BEST}",
        highlight=False,
        soft_wrap=True,
    )


def _table(study: Study, rows: list[dict[str, object]]) -> Table:
    ordered = sorted(rows, key=_worth, reverse=True)
    title = f"{len(rows)} of {len(study.tuning)} trials of {study.tuning.environment}"
    if len(rows) > _SHOWN:
        title += f", the best {_SHOWN}"
    table = Table(title=title, title_justify="left")
    space = study.tuning.space
    for name in ("trial", *space, "steps", "return", "95 % interval", ""):
        table.add_column(Text(name), justify="right")
    for row in ordered[:_SHOWN]:
        interval = "" if row["low"] is None else f"{row['low']:.4g} to {row['high']:.4g}"
        table.add_row(
            str(row["trial"]),
            *(value_text(row[name]) for name in space),
            "" if row["steps"] is None else str(row["steps"]),
            "" if row["return"] is None else f"{row['return']:.4g}",
            interval,
            "" if row["status"] == "finished" else str(row["status"]),
        )
    return table


def _worth(row: dict[str, object]) -> tuple[bool, float]:
    """The return; after all that have one, those that ended early by what they had in training."""
    value = row["return"] if row["return"] is not None else row["training_return"]
    return row["return"] is not None, float("-inf") if value is None else float(value)  # pyright: ignore[reportArgumentType]


def _status(study: Study, outcome: Outcome) -> int:
    for row in study.rows():
        if row["status"] == FAILED:
            show_error(f"trial {row['trial']}: {row['reason']}")
    for number, reason in outcome.failures.items():
        show_error(f"trial {number}: {reason}")
    done, total = study.journal.count, len(study.tuning)
    if outcome.failures and not done:
        raise InputError("no trial came to an end")
    kept = f"{done} of {total} trials are finished, kept in {study.path}"
    go_on = f"mjgranular train --resume {study.path} goes on"
    if outcome.stopped_by is not None:
        show_error(f"interrupted: {kept}; {go_on}")
        return 128 + outcome.stopped_by
    if outcome.failures:
        show_error(f"{kept}; {go_on} with those that failed")
        return 2
    return 0 if study.best() is not None else 2
