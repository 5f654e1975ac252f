"""A search over settings: many short trainings, a table of what came of each, the best as a file.

A search is a folder: what is asked for, a training run for each trial, and the table. What is
finished is kept as soon as it is there, so that an interrupted search goes on, on either engine.
"""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

from mjgranular import files
from mjgranular.errors import GranularError, InputError, OutputError, UnknownNameError
from mjgranular.experiment.folder import CONFIG, SEARCH
from mjgranular.extras import need
from mjgranular.learn.run import CHECKPOINTS, Run, current_versions
from mjgranular.learn.settings import Settings, change
from mjgranular.learn.space import Point, Space, at_ends, points_of, read_space
from mjgranular.learn.toml import settings_text, toml_text
from mjgranular.learn.train import environments_of, new_model
from mjgranular.learn.trial import FINISHED, Task, is_row
from mjgranular.pool import UNFINISHED, Journal, Workers
from mjgranular.saved import is_text, read_json

TABLE, BEST = "trials.csv", "best.toml"
_COLUMNS = ("status", "steps", "seconds", "training_return", "return", "low", "high", "reason")

Scheduler = Literal["none", "asha"]
# Asynchronous successive halving (Li et al., MLSys 2020): of the trials at a rung the better third
# goes on, from a ninth of the budget to a third, to the whole. Three is the authors' common choice;
# so many rungs are chosen.
REDUCTION = 3
_RUNGS = 2
_MADE = 10  # policies that are made beforehand, to see whether they can be; chosen


@dataclass(frozen=True)
class Tuning:
    """A search over settings.

    Attributes:
        environment: Gymnasium's id.
        settings: of all trials, but for what is searched over; their `total_steps` is the budget
            of each.
        search: what is searched over, as in `read_space`: ("gamma=0.95,0.99",).
        trials: how many points are drawn; None for a grid.
        scheduler: "none", every trial to its end; or "asha", which ends poor ones early, on Ray.
        seed: of the points and of all trainings.

    Raises:
        InputError: a setting or a value that is none, a trial that is refused; says which.
        UnknownNameError: no such setting, or no such scheduler.
    """

    environment: str
    settings: Settings
    search: tuple[str, ...]
    trials: int | None = None
    scheduler: Scheduler = "none"
    seed: int = 0

    def __post_init__(self) -> None:
        if self.scheduler not in get_args(Scheduler):
            raise UnknownNameError("scheduler", self.scheduler, get_args(Scheduler))
        if not 0 <= self.seed < 2**31:
            raise InputError(f"a seed is a whole number from 0 to {2**31 - 1}, not {self.seed}")
        _ = self.all_settings

    def __len__(self) -> int:
        """How many trials there are."""
        return len(self.points)

    @cached_property
    def space(self) -> Space:
        """Values and ranges."""
        return read_space(self.search, self.settings)

    @cached_property
    def points(self) -> list[Point]:
        """What is tried, trial by trial."""
        return points_of(self.space, self.trials, self.seed)

    @cached_property
    def all_settings(self) -> list[Settings]:
        """Settings of all trials."""
        found = []
        for number, point in enumerate(self.points):
            words = [f"{name}={toml_text(value)}" for name, value in point.items()]
            try:
                found.append(change(self.settings, words))
            except GranularError as error:
                raise InputError(
                    f"trial {number} of the search ({', '.join(words)}): {error}"
                ) from None
        return found

    @property
    def rungs(self) -> tuple[int, ...]:
        """Steps at which trials are compared."""
        if self.scheduler == "none":
            return ()
        total = self.settings.total_steps
        return tuple(max(1, total // REDUCTION**k) for k in range(_RUNGS, 0, -1))

    def folder_of(self, number: int) -> str:
        """Name of the folder of a trial."""
        return f"trial-{number:0{len(str(len(self) - 1))}d}"

    def config(self) -> dict[str, Any]:
        """The search in plain values."""
        return {
            "environment": self.environment,
            "settings": self.settings.as_json(),
            "search": list(self.search),
            "trials": self.trials,
            "scheduler": self.scheduler,
            "seed": self.seed,
        }


class Study:
    """A search with its folder, and what is known of it.

    Args:
        path: the folder.
        tuning: what is searched.
    """

    def __init__(self, path: Path, tuning: Tuning) -> None:
        self.path, self.tuning = path, tuning
        self.journal = Journal(path, tuning.config(), len(tuning), is_row)

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Keeps other processes out, and reads what is finished.

        Raises:
            OutputError: another process is at work in the folder, or other versions were.
        """
        with files.locked(self.path):
            fault = self.journal.fault() if self._is_begun() else None
            if fault is not None:
                raise OutputError(f"the search in {self.path} cannot go on: {fault}")
            self.journal.begin()
            try:
                yield
            finally:
                self.journal.close()
                if self.journal.count in (0, len(self.tuning)):
                    (self.path / UNFINISHED).unlink(missing_ok=True)

    def discard(self) -> None:
        """Removes the folder of a search that came to nothing: one without a checkpoint."""
        if not any(self.path.glob(f"trial-*/{CHECKPOINTS}/*")) and self.journal.count == 0:
            shutil.rmtree(self.path, ignore_errors=True)

    def is_finished(self) -> bool:
        """Tells whether there is nothing left to do."""
        return (self.path / TABLE).exists() and not (self.path / UNFINISHED).exists()

    def _is_begun(self) -> bool:
        file = self.path / UNFINISHED
        return file.exists() and file.stat().st_size > 0

    def tasks(self, threads: int | None = 1) -> list[Task]:
        """All trials."""
        tuning = self.tuning
        place = str(self.path.resolve())
        return [
            Task(
                place,
                tuning.folder_of(number),
                tuning.environment,
                settings,
                tuning.seed,
                tuning.rungs,
                threads,
            )
            for number, settings in enumerate(tuning.all_settings)
        ]

    def rows(self) -> list[dict[str, Any]]:
        """What there is, in the order of the trials: number, values, and what came of it."""
        return [
            {"trial": number, **self.tuning.points[number], **self.journal[number]}
            for number in range(len(self.tuning))
            if number in self.journal
        ]

    def best(self) -> dict[str, Any] | None:
        """The row of the greatest return; None before a trial is finished."""
        done = [r for r in self.rows() if r["status"] == FINISHED and r["return"] is not None]
        return max(done, key=lambda row: row["return"], default=None)

    def at_ends(self) -> list[str]:
        """Names of settings whose best value is an end of what was searched."""
        best = self.best()
        if best is None:
            return []
        return at_ends(self.tuning.space, self.tuning.points[best["trial"]])

    def write(self) -> None:
        """Writes the table, and the best settings, as they are now."""
        text = io.StringIO()
        names = ("trial", *self.tuning.space, *_COLUMNS)
        table = csv.DictWriter(text, names, lineterminator="\n", extrasaction="ignore")
        table.writeheader()
        for row in self.rows():
            shown = {name: value_text(row[name]) for name in self.tuning.space}
            table.writerow({**row, **shown})
        files.write_text(self.path / TABLE, text.getvalue())
        best = self.best()
        if best is None:
            return
        number = best["trial"]
        comment = (
            f"trial {number} of {len(self.tuning)}, return {best['return']:.4g} from "
            f"{best['low']:.4g} to {best['high']:.4g}; settings for {self.tuning.environment}"
        )
        files.write_text(self.path / BEST, settings_text(self.tuning.all_settings[number], comment))


def value_text(value: Any) -> str:
    """A value as tables show it."""
    return value if isinstance(value, str) else toml_text(value)


def check_place(tuning: Tuning, on: Workers) -> None:
    """Refuses a search that cannot be where it is to be.

    Raises:
        InputError: a scheduler of Ray's on processes of this machine.
        MissingExtraError: Ray Tune is not installed.
    """
    if on.engine == "ray":
        need("ray.tune", extra="ray", purpose="A search with the engine ray")
    elif tuning.scheduler != "none":
        raise InputError(
            f"{tuning.scheduler} is a scheduler of Ray Tune: say --engine ray too, or leave "
            "--scheduler away"
        )


def check_models(tuning: Tuning) -> None:
    """Refuses settings of policies that their class does not take, which only that one knows.

    Raises:
        InputError: says which trial, and why.
    """
    seen: set[str] = set()
    for number, settings in enumerate(tuning.all_settings):
        policy = toml_text(settings.policy)
        if policy in seen or len(seen) >= _MADE:
            continue
        seen.add(policy)
        # Of one environment: what a policy takes is no matter of their number.
        alone = replace(settings, num_envs=1, processes=False, arguments={})
        run = Run(Path(), tuning.environment, alone, tuning.seed, {}, trusted=True)
        env = environments_of(run, threads=1)
        try:
            new_model(run, env)
        except InputError as error:
            raise InputError(f"trial {number} of the search: {error}") from None
        finally:
            env.close()


def begin_study(path: Path, tuning: Tuning) -> Study:
    """Makes the folder of a new search.

    Raises:
        OutputError: the folder has something in it, or cannot be written to.
    """
    if path.exists() and not path.is_dir():
        raise OutputError(f"cannot write to {path}: it is not a folder")
    with files.locked(path):
        files.remove_leftovers(path, (CONFIG,))
        if any(file.name != files.LOCK for file in path.iterdir()):
            held = "a search" if is_study(path) else "something"
            go_on = f", or go on with mjgranular train --resume {path}" if is_study(path) else ""
            raise OutputError(
                f"{path} holds {held} already: choose another folder with --out{go_on}"
            )
        content = {
            "command": SEARCH,
            **tuning.config(),
            "versions": current_versions(),
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        files.write_text(path / CONFIG, json.dumps(content, indent=2) + "\n")
    return Study(path, tuning)


def is_study(path: Path) -> bool:
    """Tells whether a folder holds a search."""
    try:
        return read_json(path / CONFIG).get("command") == SEARCH
    except OutputError:
        return False


def open_study(path: Path) -> Study:
    """The search whose folder it is.

    Raises:
        OutputError: the folder holds none, or its file is damaged.
    """
    content = read_json(path / CONFIG)
    try:
        search, trials, seed = (content.get(name) for name in ("search", "trials", "seed"))
        if not is_text(content.get("environment")):
            raise OutputError("it names no environment")
        if not isinstance(search, list) or not all(map(is_text, search)):
            raise OutputError("search must be a list of texts")
        for name, value in (("trials", trials), ("seed", seed)):
            if not (isinstance(value, int) or (value is None and name == "trials")):
                raise OutputError(f"{name} must be a whole number")
        tuning = Tuning(
            str(content["environment"]),
            Settings.from_json(content.get("settings")),
            tuple(search),
            trials,
            content.get("scheduler", "none"),
            seed,  # pyright: ignore[reportArgumentType] - None was refused
        )
    except GranularError as error:
        raise OutputError(f"{path / CONFIG} is damaged: {error}") from None
    return Study(path, tuning)


@dataclass(frozen=True)
class Outcome:
    """How a search ended.

    Attributes:
        stopped_by: the signal that ended it early; None if none did.
        failures: reasons, by the numbers of trials that nothing is known of; `--resume` tries them
            again.
    """

    stopped_by: int | None
    failures: Mapping[int, str]
