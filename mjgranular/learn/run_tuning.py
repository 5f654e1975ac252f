"""A search over settings, done: on processes of this machine, or on Ray."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from mjgranular.learn.trial import Task, run_trial
from mjgranular.learn.tuning import Outcome, Study, check_place
from mjgranular.pool import Mapped, Workers, map_tasks


def run_study(study: Study, on: Workers, progress: Callable[[int], None] | None = None) -> Outcome:
    """Does the trials that are not done yet. The study must be opened by the caller.

    Numbers are the same wherever that is, unless a scheduler ends trials early: that depends on
    which came first.

    Args:
        study: with its folder, which all nodes of a cluster must have at the same path.
        on: where; each trial takes a core.
        progress: told the number of trials that are done, as soon as there is another one.

    Raises:
        InputError: Ray or its workers cannot do it.
    """
    check_place(study.tuning, on)

    def kept(_number: int = 0, _row: Any = None) -> None:
        study.write()
        if progress is not None:
            progress(study.journal.count)

    if study.journal.count:
        kept()
    if on.engine == "ray":
        from mjgranular.learn.on_tune import run_on_tune

        return run_on_tune(study, on, kept)
    alone = on.count == 1
    found = map_tasks(
        _run_there,
        study.tasks(None if alone else 1),
        on=replace(on, chunk=1),
        journal=study.journal,
        answered=kept,
    )
    return _outcome(found)


def _run_there(_shared: None, task: Task) -> dict[str, Any]:
    return run_trial(task)


def _outcome(found: Mapped) -> Outcome:
    stopped = found.stopped_by if found.interrupted else None
    return Outcome(stopped, {one.index: one.reason for one in found.failures})
