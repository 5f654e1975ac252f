"""A search over settings on Ray Tune, which places trials, begins them again, and compares them."""

from __future__ import annotations

import io
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from types import SimpleNamespace
from typing import Any

from ray import tune
from ray.tune.schedulers import ASHAScheduler

from mjgranular.errors import GranularError, InputError, one_line
from mjgranular.learn.on_ray import told
from mjgranular.learn.train import collected_signals
from mjgranular.learn.trial import Rungs, Task, run_trial, stopped_row
from mjgranular.learn.tuning import REDUCTION, Outcome, Study
from mjgranular.pool import Workers
from mjgranular.pool.on_ray import begin_ray
from mjgranular.pool.tasks import TRIES
from mjgranular.pool.versions import mismatch, versions

_STEPS, _RETURN = "steps", "mean_return"
# Tune reads these as a run begins: nothing of its own is written, and signals are ours.
_QUIET = {
    "TUNE_DISABLE_AUTO_CALLBACK_LOGGERS": "1",
    "TUNE_DISABLE_AUTO_CALLBACK_SYNCER": "1",
    "TUNE_DISABLE_SIGINT_HANDLER": "1",
    "TUNE_DISABLE_STRICT_METRIC_CHECKING": "1",  # the last report of a trial is its row
    "RAY_TRAIN_ENABLE_V2_MIGRATION_WARNINGS": "0",
}


def run_on_tune(study: Study, on: Workers, kept: Callable[[], None]) -> Outcome:
    """Does the trials that are not done yet, each by one actor of Ray's on one core.

    Args:
        study: opened.
        on: a cluster of Ray, or one of our own; at most as many trials at once as its count says.
        kept: called as soon as there is another row.

    Raises:
        InputError: Ray cannot be used, or a worker has other versions.
    """
    missing = list(study.journal.missing())
    if not missing:
        return Outcome(None, {})
    ray, mine = begin_ray(on)
    try:
        with collected_signals() as received, tempfile.TemporaryDirectory() as place, _quiet():
            return _run(study, on, _Watch(study, kept, received), missing, place)
    finally:
        if mine:
            ray.shutdown()


class _Watch:
    """What this process knows of a search while it goes on. Tune copies it nowhere."""

    def __init__(self, study: Study, kept: Callable[[], None], received: list[int]) -> None:
        self.study, self.kept, self.received = study, kept, received
        self.failures: dict[int, str] = {}
        self.refused: str | None = None

    def keep(self, number: int, row: dict[str, Any]) -> None:
        self.study.journal.keep([(number, row)])
        self.kept()

    def ends(self) -> bool:
        """Whether this process was told to end, or no worker can do anything."""
        return bool(self.received) or self.refused is not None

    def __deepcopy__(self, _memo: object) -> _Watch:
        return self

    def __reduce__(self) -> tuple[Any, ...]:  # Tune writes all that it was given to a file
        return SimpleNamespace, ()


class _Keeper(tune.Callback):
    """Keeps what comes of trials."""

    def __init__(self, watch: _Watch) -> None:
        self._watch = watch

    def on_trial_result(
        self, iteration: int, trials: list[Any], trial: Any, result: dict[str, Any], **_: Any
    ) -> None:
        number = trial.config["trial"]
        if result.get("refused"):
            self._watch.refused = result["refused"]
        elif result.get("failure"):
            self._watch.failures[number] = result["failure"]
        elif result.get("row"):
            self._watch.keep(number, result["row"])

    def on_trial_complete(self, iteration: int, trials: list[Any], trial: Any, **_: Any) -> None:
        watch, number = self._watch, trial.config["trial"]
        rungs = (trial.last_result or {}).get("rungs")
        known = number in watch.study.journal or number in watch.failures
        if rungs and not known and not watch.ends():
            watch.keep(number, stopped_row(rungs))

    def on_trial_error(self, iteration: int, trials: list[Any], trial: Any, **_: Any) -> None:
        self._watch.failures[trial.config["trial"]] = (
            f"its process died, {TRIES} times: perhaps for lack of memory"
        )


class _Ending(tune.Stopper):
    """Ends all trials where there is no going on."""

    def __init__(self, watch: _Watch) -> None:
        self._watch = watch

    def __call__(self, trial_id: str, result: dict[str, Any]) -> bool:
        return False

    def stop_all(self) -> bool:
        return self._watch.ends()


def _run(study: Study, on: Workers, watch: _Watch, missing: list[int], place: str) -> Outcome:
    given = {"tasks": study.tasks(), "versions": versions()}
    tuner = tune.Tuner(
        tune.with_resources(tune.with_parameters(_trial, given=given), {"cpu": 1}),
        param_space={"trial": tune.grid_search(missing)},
        tune_config=tune.TuneConfig(
            scheduler=_scheduler(study), max_concurrent_trials=on.count, reuse_actors=True
        ),
        run_config=tune.RunConfig(
            name="search",
            storage_path=place,
            verbose=0,
            callbacks=[_Keeper(watch)],
            stop=_Ending(watch),
            failure_config=tune.FailureConfig(max_failures=TRIES - 1),
        ),
    )
    try:
        tuner.fit()
    except GranularError:
        raise
    except Exception as error:  # of Ray, of a cluster that has gone
        raise InputError(f"Ray Tune cannot go on: {told(error)}") from None
    if watch.refused is not None:
        raise InputError(watch.refused)
    unfinished = study.journal.count < len(study.tuning)
    stopped = watch.received[0] if watch.received and unfinished else None
    return Outcome(stopped, dict(sorted(watch.failures.items())))


def _scheduler(study: Study) -> Any:
    """What ends poor trials early, knowing those of earlier sittings; None for nothing."""
    tuning = study.tuning
    if not tuning.rungs:
        return None
    scheduler: Any = ASHAScheduler(
        time_attr=_STEPS,
        metric=_RETURN,
        mode="max",
        max_t=tuning.settings.total_steps,
        grace_period=tuning.rungs[0],
        reduction_factor=REDUCTION,
    )
    for row in study.rows():
        ended = SimpleNamespace(trial_id=f"ended-{row['trial']}")
        scheduler.on_trial_add(None, ended)
        for steps, returned in row["rungs"]:
            scheduler.on_trial_result(None, ended, {_STEPS: steps, _RETURN: returned})
    return scheduler


def _trial(config: dict[str, Any], given: dict[str, Any]) -> None:
    """One trial, in a process of Ray's."""
    different = mismatch(given["versions"], versions())
    if different is not None:
        said = f"a worker has other versions: {different}; install the same on all nodes"
        tune.report({"refused": said})
        return
    task: Task = given["tasks"][config["trial"]]

    def compared(rungs: Rungs) -> None:
        steps, returned = rungs[-1]
        tune.report({_STEPS: steps, _RETURN: returned, "rungs": rungs})

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of as many as there are trials
            row = run_trial(task, compared)
    except GranularError as error:
        tune.report({"failure": str(error)})
    except Exception as error:  # anybody's environment
        tune.report({"failure": one_line(f"{type(error).__name__}: {error}")[:500]})
    else:
        tune.report({"row": row})


@contextmanager
def _quiet() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in _QUIET}
    os.environ.update(_QUIET)
    try:
        with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")  # of Tune's, on its own ways
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
