"""One trial of a search over settings: a training run, and what its policy is worth."""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from mjgranular import files
from mjgranular.errors import InputError, OutputError, UnstableError
from mjgranular.experiment.folder import CONFIG
from mjgranular.learn.episodes import run_episodes
from mjgranular.learn.evaluate import mean_of
from mjgranular.learn.policies import load_policy
from mjgranular.learn.run import Run, begin_run, open_run
from mjgranular.learn.sands import sands_made
from mjgranular.learn.settings import Settings
from mjgranular.learn.train import train
from mjgranular.signals import Stopped

FINISHED, STOPPED, FAILED = "finished", "stopped", "failed"
FIRST_SEED = 20_000
"""Of a trial's episodes; others than those of an evaluation, lest the best be the luckiest."""
SEEDS = 10
"""Episodes that a policy is judged by; chosen."""
_RUNGS = "rungs.json"

Rungs = list[tuple[int, float]]
"""Steps and mean return of the newest episodes then, where a trial was compared with others."""


class Task(NamedTuple):
    """A trial, as it is sent to whoever does it.

    Attributes:
        study: folder of the search, the same on all nodes.
        folder: of the trial, within it.
        environment: Gymnasium's id.
        settings: resolved.
        seed: of the training.
        rungs: steps at which it is compared with others; none where it never is.
        threads: of a batch of environments; None for one a core.
    """

    study: str
    folder: str
    environment: str
    settings: Settings
    seed: int
    rungs: tuple[int, ...] = ()
    threads: int | None = 1


def run_trial(task: Task, compared: Callable[[Rungs], None] | None = None) -> dict[str, Any]:
    """Trains, from the newest checkpoint if there is one, and evaluates the policy without noise.

    Args:
        task: the trial.
        compared: told what it reached at its rungs, as soon as there is another one; may end the
            training by whatever it raises. Is told of those of an earlier sitting at once.

    Returns:
        A row: `status` and what it came to, in plain values.

    Raises:
        InputError: the folder is not there.
        OutputError: it has another run in it.
        Stopped: this process was told to end; what was learned is kept.
    """
    run = _run(task)
    begun = Path(task.study) / task.folder / _RUNGS
    rungs = _known(begun)
    with run.locked():
        for count in range(1, len(rungs) + 1):
            if compared is not None:
                compared(rungs[:count])

        def report(steps: int, newest: float | None) -> None:
            reached = len(rungs) < len(task.rungs) and steps >= task.rungs[len(rungs)]
            if reached and newest is not None and compared is not None:
                rungs.append((steps, newest))
                files.write_text(begun, json.dumps(rungs) + "\n")
                compared(list(rungs))

        try:
            training = train(run, report=report, threads=task.threads)
        except UnstableError as error:
            return {**_row(FAILED, rungs), "steps": run.steps(), "reason": str(error)}
        if training.stopped_by is not None:
            raise Stopped(training.stopped_by)  # what was learned is kept
    curve, done = training.progress.curve, training.progress
    row = _row(FINISHED, rungs)
    row |= {"steps": done.steps, "seconds": round(done.seconds, 3)}
    row["training_return"] = _plain(curve[-1][3]) if curve else None
    episodes = run_episodes(
        task.environment,
        task.settings.environment,
        lambda env: load_policy(run.path).checked(task.environment, env),
        range(FIRST_SEED, FIRST_SEED + SEEDS),
        threads=task.threads,
    )
    mean = mean_of(episodes.returns)
    return row | {name: _plain(getattr(mean, at)) for name, at in _MEAN.items()}


_MEAN = {"return": "mean", "low": "low", "high": "high"}


def stopped_row(rungs: Rungs) -> dict[str, Any]:
    """The row of a trial that others were better than."""
    steps, returned = rungs[-1]
    return {**_row(STOPPED, rungs), "steps": steps, "training_return": _plain(returned)}


def is_row(row: Any) -> bool:
    """Tells whether something that was read can be a row."""
    if row.get("status") not in (FINISHED, STOPPED, FAILED):
        return False
    numbers = [row.get(name, "") for name in ("steps", "seconds", "training_return", *_MEAN)]
    rungs = row.get("rungs")
    return (
        all(value is None or _is_number(value) for value in numbers)
        and isinstance(row.get("reason"), str)
        and isinstance(rungs, list)
        and all(isinstance(r, list) and len(r) == 2 and all(map(_is_number, r)) for r in rungs)
    )


def _run(task: Task) -> Run:
    study = Path(task.study)
    if not (study / CONFIG).exists():
        raise InputError(
            f"the folder of the search, {study}, is not on {socket.gethostname()}: all nodes must "
            "have it at the same path"
        )
    path = study / task.folder
    if not (path / CONFIG).exists():
        return begin_run(path, task.environment, task.settings, seed=task.seed)
    run = open_run(path)
    asked = (task.environment, task.seed, task.settings.as_json())
    if (run.environment, run.seed, run.settings.as_json()) != asked:
        raise OutputError(f"{path} holds a run with other settings: move it away")
    other = run.other_sand(sands_made(run.environment, run.arguments))
    if other is not None:
        raise OutputError(f"{path} {other}; move it away")
    return replace(run, trusted=True)


def _known(file: Path) -> Rungs:
    """What was reached in an earlier sitting."""
    if not file.exists():
        return []
    try:
        return [(int(steps), float(value)) for steps, value in json.loads(file.read_text())]
    except (ValueError, TypeError):
        raise OutputError(f"{file} is damaged: remove it, and its rungs are tried anew") from None


def _row(status: str, rungs: Rungs) -> dict[str, Any]:
    nothing: dict[str, Any] = dict.fromkeys(("seconds", "training_return", *_MEAN))
    return {"status": status, "steps": None, **nothing, "rungs": rungs, "reason": ""}


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
