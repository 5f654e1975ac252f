"""The folder of a run: what was asked for, checkpoints, the curve; one process at a time."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mjgranular.errors import InputError, OutputError, warn_user
from mjgranular.experiment.folder import CONFIG
from mjgranular.experiment.provenance import versions
from mjgranular.extras import need
from mjgranular.learn import durable
from mjgranular.learn.settings import Settings

CHECKPOINTS = "checkpoints"
TENSORBOARD = "tensorboard"
CURVE = "curve.csv"
POLICY = "policy.zip"
STATE = "state.json"
REPLAY = "replay.pkl"
CURVE_COLUMNS = ("steps", "seconds", "episodes", "mean_return", "mean_length")
_PACKAGES = ("gymnasium", "stable-baselines3", "torch")
_LOCK = ".lock"
_KEPT = 2  # checkpoints; the older one is for the case that the newer gets damaged


@dataclass(frozen=True)
class Run:
    """A training run on disk.

    Attributes:
        path: its folder.
        environment: Gymnasium's id.
        settings: resolved.
        seed: all random numbers follow from it.
        versions: of the packages that it was begun with.
    """

    path: Path
    environment: str
    settings: Settings
    seed: int
    versions: dict[str, Any]

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.environment} {self.settings.algorithm} seed {self.seed}"

    def config(self) -> dict[str, Any]:
        """What is in `config.json`."""
        return {
            "command": "train",
            "environment": self.environment,
            "seed": self.seed,
            "settings": self.settings.as_json(),
            "versions": self.versions,
        }

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keeps other processes out. The system lets go of the lock when this process ends.

        Raises:
            OutputError: another process is at work in the folder.
        """
        filelock = need("filelock", extra="train", purpose="Training a policy")
        try:
            with filelock.FileLock(self.path / _LOCK).acquire(timeout=0):
                yield
        except filelock.Timeout:
            raise OutputError(
                f"{self.path} is in use by another process: wait for it, or choose another folder "
                "with --out"
            ) from None

    def checkpoints(self) -> list[Path]:
        """Folders of the checkpoints, the newest first; unchecked."""
        return sorted((self.path / CHECKPOINTS).glob("step-*"), reverse=True)

    def newest_checkpoint(self) -> Path | None:
        """The newest checkpoint that is whole; a damaged one is skipped with a warning."""
        for folder in self.checkpoints():
            wrong = durable.fault(folder)
            if wrong is None:
                return folder
            warn_user(f"the checkpoint {folder} is damaged ({wrong}) and was skipped")
        return None

    def checkpoint_folder(self, steps: int) -> Path:
        """Where the checkpoint after so many steps goes."""
        return self.path / CHECKPOINTS / f"step-{steps:010d}"

    def remove_old_checkpoints(self) -> None:
        """Keeps the newest two."""
        for folder in self.checkpoints()[_KEPT:]:
            durable.remove_folder(folder)

    def extended(self, total_steps: int) -> Run:
        """The run with another number of steps to go to, noted in its folder."""
        longer = replace(self, settings=replace(self.settings, total_steps=total_steps))
        file = self.path / CONFIG
        content = json.loads(file.read_text(encoding="utf-8"))
        durable.write_text(file, json.dumps({**content, **longer.config()}, indent=2) + "\n")
        return longer

    def discard(self) -> None:
        """Removes the folder of a run that came to nothing: one without a checkpoint."""
        if not self.checkpoints():
            shutil.rmtree(self.path, ignore_errors=True)

    def steps(self) -> int:
        """Steps that the newest checkpoint has behind it; 0 without one."""
        folder = self.newest_checkpoint()
        return 0 if folder is None else int(read_state(folder)["steps"])


def begin_run(path: Path, environment: str, settings: Settings, *, seed: int) -> Run:
    """Makes the folder of a new run.

    Raises:
        OutputError: the folder has something in it, or cannot be written to.
    """
    if not 0 <= seed < 2**31:
        raise InputError(f"a seed is a whole number from 0 to {2**31 - 1}, not {seed}")
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            held = "a training run" if (path / CONFIG).exists() else "something"
            raise OutputError(
                f"{path} holds {held} already: choose another folder with --out, or go on with a "
                f"run by mjgranular train --resume {path}"
            )
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise OutputError(f"cannot write to {path}: {error.strerror or error}") from None
    run = Run(path, environment, settings, seed, current_versions())
    started = {"started": datetime.now(UTC).isoformat(timespec="seconds")}
    durable.write_text(path / CONFIG, json.dumps({**run.config(), **started}, indent=2) + "\n")
    return run


def current_versions() -> dict[str, Any]:
    """Versions of the packages that a training depends on."""
    return versions(*_PACKAGES)


def open_run(path: Path) -> Run:
    """The run whose `config.json` is in a folder: a run, one of its checkpoints, a policy.

    Raises:
        OutputError: the folder holds none.
    """
    try:
        content = json.loads((path / CONFIG).read_text(encoding="utf-8"))
        if content["command"] != "train":
            raise OutputError(
                f"{path} holds the result of mjgranular {content['command']}, not a training run"
            )
        settings = Settings.from_json(content["settings"])
        return Run(path, content["environment"], settings, content["seed"], content["versions"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        if isinstance(error, (OutputError, InputError)):
            raise
        raise OutputError(
            f"{path} holds no training run ({error}); make one with mjgranular train ENV --out "
            f"{path}"
        ) from None


def read_state(checkpoint: Path) -> dict[str, Any]:
    """Steps and seconds behind a checkpoint."""
    return json.loads((checkpoint / STATE).read_text(encoding="utf-8"))


def curve_text(rows: Sequence[Sequence[float]]) -> str:
    """A learning curve as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CURVE_COLUMNS)
    writer.writerows(rows)
    return text.getvalue()


def read_curve(file: Path) -> list[tuple[float, ...]]:
    """Reads a learning curve; rows of `CURVE_COLUMNS`."""
    with file.open(newline="", encoding="utf-8") as stream:
        return [tuple(float(value) for value in row) for row in list(csv.reader(stream))[1:]]
