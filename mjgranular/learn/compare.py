"""Does sand matter? Policies trained on one ground each, evaluated on all of them."""

from __future__ import annotations

import signal
import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular.errors import InputError, OutputError, UnknownNameError
from mjgranular.experiment.folder import CONFIG
from mjgranular.learn.blocks import Actor, Evaluation, Job, run_evaluation
from mjgranular.learn.evaluate import FIRST_SEED, Mean, Score, check_seeds, mean_of
from mjgranular.learn.policies import load_policy
from mjgranular.learn.run import Run, begin_run, open_run
from mjgranular.learn.sands import sands_made
from mjgranular.learn.settings import change, find_settings
from mjgranular.learn.train import train
from mjgranular.pool import Mapped, Workers, map_tasks


@dataclass(frozen=True)
class Ground:
    """Ground that a robot stands on.

    Attributes:
        environment: Gymnasium's id.
        arguments: of the environment.
    """

    environment: str
    arguments: Mapping[str, Any]


# Chosen: a factor of two either way, about what separates loose from close packing (the two sets of
# poppy seed of Li, Zhang and Goldman, Science 339 (2013)), and slopes of a beach.
_RANGES = {"strength": [0.5, 2.0], "density": [0.5, 2.0], "slope": [-0.1, 0.1]}

GROUNDS: dict[str, dict[str, Ground]] = {
    "Hopper": {
        "rigid": Ground("Hopper-v5", {}),
        "sand": Ground("mjgranular/Hopper-v0", {}),
        "randomised sand": Ground("mjgranular/Hopper-v0", {"randomise": _RANGES}),
    },
    "Hexapod": {
        # A hundred times as strong, sand yields a hundredth of the way.
        "rigid": Ground("mjgranular/Hexapod-v0", {"randomise": {"strength": [100.0, 100.0]}}),
        "sand": Ground("mjgranular/Hexapod-v0", {}),
        "randomised sand": Ground("mjgranular/Hexapod-v0", {"randomise": _RANGES}),
    },
}
"""For each robot the grounds that are compared; policies of one go with all the others."""


@dataclass(frozen=True)
class Cell:
    """Comparison of policies on grounds that they were not trained on.

    Attributes:
        trained_on: the one.
        on: the other.
        returned: mean return over all policies and seeds; the interval is that of the policies'
            means where there are several, else that of the seeds.
    """

    trained_on: str
    on: str
    returned: Mean

    def as_json(self) -> dict[str, Any]:
        """As plain values."""
        mean = self.returned
        return {
            "trained_on": self.trained_on,
            "on": self.on,
            "mean": mean.mean,
            "low": mean.low,
            "high": mean.high,
            "values": list(mean.values),
        }


Report = Callable[[str, float], None]
"""Told what is being done, and the share of it that is done."""


def compare(
    robot: str,
    folder: Path,
    *,
    policies: int = 3,
    seeds: int = 10,
    total_steps: int | None = None,
    changes: Sequence[str] = (),
    on: Workers | None = None,
    report: Report | None = None,
) -> list[Cell] | int:
    """Trains what is not trained yet, and evaluates everything on everything.

    The folder must be locked by the caller. Numbers are the same wherever the work is done.

    Args:
        robot: one of `GROUNDS`.
        folder: for the runs; what is there already is gone on with.
        policies: how many for each ground, with the seeds 0, 1, ...
        seeds: episodes for each policy and ground.
        total_steps: of each training; None for that of the settings.
        changes: of the settings, as for `settings.change`; the same for all grounds.
        on: where runs are trained and evaluated; None for this process, on all cores. All nodes of
            a cluster must have the folder at the same path.
        report: told what is being done.

    Returns:
        A cell for each pair of grounds; or the signal that stopped the training, after which the
        same call goes on.

    Raises:
        UnknownNameError: no such robot.
        OutputError: a run in the folder was begun with other settings, or on other sand.
    """
    if robot not in GROUNDS:
        raise UnknownNameError("robot to compare grounds with", robot, GROUNDS)
    check_seeds(seeds, FIRST_SEED)
    grounds = GROUNDS[robot]
    runs: dict[str, list[Run]] = {name: [] for name in grounds}
    for seed in range(policies):
        for name, ground in grounds.items():
            path = folder / f"{name.replace(' ', '-')}-{seed}"
            runs[name].append(_run(path, robot, ground, seed, total_steps, changes))
    on = on or Workers(count=1)
    in_turn = [run for some in zip(*runs.values(), strict=True) for run in some]
    stopped_by = _train_all(in_turn, on, report)
    if stopped_by is not None:
        return stopped_by
    # Each policy in the order of the table: trained on, evaluated on.
    pairs = [(name, other) for name in grounds for other in grounds]
    jobs = [
        Job(
            Actor(
                run.name,
                grounds[other].environment,
                runs[other][0].settings.environment,
                load_policy(run.path),
            )
        )
        for name, other in pairs
        for run in runs[name]
    ]
    total = len(jobs) * seeds
    scores = run_evaluation(
        Evaluation(jobs, seeds),
        on=on,
        progress=None if report is None else lambda done: report("evaluating", done / total),
    )
    if isinstance(scores, Mapped):
        return scores.stopped_by or signal.SIGINT
    return [
        Cell(name, other, _mean([score.episodes.returns for score in some]))
        for (name, other), some in zip(pairs, _groups(scores, policies), strict=True)
    ]


def _run(
    path: Path,
    robot: str,
    ground: Ground,
    seed: int,
    total_steps: int | None,
    changes: Sequence[str],
) -> Run:
    # The settings are those of the sand for every ground: only the ground differs.
    settings = change(find_settings(GROUNDS[robot]["sand"].environment), changes)
    settings = replace(settings, environment={**settings.environment, **ground.arguments})
    if total_steps is not None:
        settings = replace(settings, total_steps=total_steps)
    if not (path / CONFIG).exists():
        return begin_run(path, ground.environment, settings, seed=seed)
    run = open_run(path)
    if (run.settings.as_json(), run.environment) != (settings.as_json(), ground.environment):
        raise OutputError(
            f"{path} holds a run with other settings: choose another folder with --out"
        )
    other = run.other_sand(sands_made(run.environment, run.arguments))
    if other is not None:
        raise OutputError(f"{path} {other}; choose another folder with --out")
    return run


def _train_all(runs: Sequence[Run], on: Workers, report: Report | None) -> int | None:
    """Trains runs that are not finished yet. Returns the signal that stopped it, if one did."""
    if on.engine == "local" and on.count == 1:
        for run in runs:
            stopped_by = _train(run, f"training {run.path.name}", report)
            if stopped_by is not None:
                return stopped_by
        return None
    found = map_tasks(
        _train_there,
        [str(run.path.resolve()) for run in runs],
        on=replace(on, chunk=1),
        progress=None if report is None else lambda done: report("training", done / len(runs)),
    )
    if found.interrupted:
        return found.stopped_by or signal.SIGINT
    if found.failures:
        failure = found.failures[0]
        raise InputError(f"{runs[failure.index].path}: {failure.reason}")
    return None


def _train_there(_shared: None, path: str) -> bool:
    """Trains a run, in whatever process.

    Raises:
        InputError: its folder is not there.
    """
    folder = Path(path)
    if not (folder / CONFIG).exists():
        raise InputError(
            f"it is not on {socket.gethostname()}: compare trains in the folder of --out, which "
            "all nodes must have at the same path"
        )
    run = replace(open_run(folder), trusted=True)
    with run.locked():
        if train(run, threads=1).stopped_by is not None:
            raise InputError("its training was stopped from outside; the same command goes on")
    return True


def _train(run: Run, title: str, report: Report | None) -> int | None:
    with run.locked():

        def tell(steps: int, _newest: float | None) -> None:
            if report is not None:
                report(title, steps / run.settings.total_steps)

        return train(run, report=tell).stopped_by


def _groups(scores: Sequence[Score], size: int) -> list[Sequence[Score]]:
    return [scores[first : first + size] for first in range(0, len(scores), size)]


def _mean(returns: Sequence[np.ndarray]) -> Mean:
    means = [float(np.mean(values)) for values in returns]
    return mean_of(means) if len(means) > 1 else mean_of(returns[0])
