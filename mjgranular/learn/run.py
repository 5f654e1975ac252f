"""The folder of a run: settings, checkpoints, the curve; one process at a time."""

from __future__ import annotations

import csv
import io
import json
import math
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mjgranular._util import files
from mjgranular._util.io import is_text, number, read_json, read_text
from mjgranular.errors import (
    GranularError,
    InputError,
    MissingExtraError,
    OutputError,
    warn_user,
)
from mjgranular.experiment.folder import CONFIG, TRAINING
from mjgranular.learn.sands import Sands, changes, read_sands, sands_made
from mjgranular.learn.settings import Settings
from mjgranular.learn.weights import NORMALIZER
from mjgranular.pool.versions import versions

CHECKPOINTS = "checkpoints"
TENSORBOARD = "tensorboard"
CURVE = "curve.csv"
POLICY = "policy.zip"
STATE = "state.json"
REPLAY = "replay.npz"
CURVE_COLUMNS = ("steps", "seconds", "episodes", "mean_return", "mean_length")
_PACKAGES = ("gymnasium", "stable-baselines3", "torch")
_IN_A_CHECKPOINT = (CONFIG, POLICY, NORMALIZER, CURVE, STATE)
_KEPT = 2  # checkpoints; the older one in case the newer is damaged


@dataclass(frozen=True)
class Run:
    """A training run on disk.

    Attributes:
        path: its folder.
        environment: Gymnasium's id.
        settings: resolved.
        seed: all random numbers follow from it.
        versions: versions of the packages that it was started with.
        sand: sand of its environment when the run started; None if unknown, as for environments
            without a MuJoCo model.
        trusted: whether the user trusts it, so that modules that it names may be imported.
        restored: arguments that give the environment the sand that it had when the run started.
    """

    path: Path
    environment: str
    settings: Settings
    seed: int
    versions: dict[str, Any]
    sand: Sands | None = None
    trusted: bool = False
    restored: Mapping[str, Any] = field(default_factory=dict)

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments of the environment in training."""
        return {**self.settings.environment, **self.restored}

    @property
    def name(self) -> str:
        """Display name."""
        return f"{self.environment} {self.settings.algorithm} seed {self.seed}"

    def config(self) -> dict[str, Any]:
        """Return the content of `config.json`."""
        return {
            "command": TRAINING,
            "environment": self.environment,
            "sand": self.sand,
            "seed": self.seed,
            "settings": self.settings.as_json(),
            "versions": self.versions,
        }

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes out. The system releases the lock when this process ends.

        Raises:
            OutputError: another process is using the folder.
        """
        with files.locked(self.path):
            yield

    def checkpoints(self) -> list[Path]:
        """Return the folders of the checkpoints, the newest first; unchecked."""
        return sorted((self.path / CHECKPOINTS).glob("step-*"), reverse=True)

    def newest_checkpoint(self) -> Path | None:
        """Return the newest complete checkpoint; a damaged one is skipped with a warning."""
        for folder in self.checkpoints():
            wrong = files.find_corruption(folder, _IN_A_CHECKPOINT)
            if wrong is None:
                return folder
            if folder.exists():  # else a running training has removed it: there is a newer one
                warn_user(f"the checkpoint {folder} is damaged ({wrong}) and was skipped")
        return None

    def checkpoint_folder(self, steps: int) -> Path:
        """Return the path of the checkpoint after `steps` steps."""
        return self.path / CHECKPOINTS / f"step-{steps:010d}"

    def remove_old_checkpoints(self, written: Path | None = None) -> None:
        """Keep the newest two complete checkpoints, and damaged ones among them for inspection.

        Args:
            written: a checkpoint that was just written, and need not be checked.
        """
        whole = 0
        for folder in self.checkpoints():
            if whole == _KEPT:
                files.remove_folder(folder)
            elif folder == written or files.find_corruption(folder, _IN_A_CHECKPOINT) is None:
                whole += 1

    def extended(self, total_steps: int) -> Run:
        """Return the run with another total of steps, and write that to its folder."""
        longer = replace(self, settings=replace(self.settings, total_steps=total_steps))
        file = self.path / CONFIG
        content = {**read_json(file), **longer.config()}
        files.write_text(file, json.dumps(content, indent=2) + "\n")
        return longer

    def discard(self) -> None:
        """Remove the folder of a run without a checkpoint."""
        if not self.checkpoints():
            shutil.rmtree(self.path, ignore_errors=True)

    def steps(self) -> int:
        """Return the number of steps of the newest checkpoint; 0 without one."""
        folder = self.newest_checkpoint()
        return 0 if folder is None else read_state(folder)[0]

    def other_sand(self, now: Sands | None, settled: Iterable[str] = ()) -> str | None:
        """Describe how sand differs from that of the run's start.

        Args:
            now: the sand of an environment; None if unknown.
            settled: names of arguments that the user has changed.

        Returns:
            The end of a sentence whose subject is the run; None if nothing differs or the sand is
            unknown.
        """
        if now is None or self.sand is None:
            return None
        found = changes(self.sand, now, settled)
        return f"was begun on other sand: {', '.join(found)}" if found else None

    def check_environment(self) -> None:
        """Check that no module is imported only because an untrusted file names it.

        An environment `module:Name-v0` executes its module. This is allowed if the user trusts the
        run, or has already imported the module.

        Raises:
            OutputError: it is not allowed.
        """
        module, colon, name = self.environment.rpartition(":")
        # These of Gymnasium's make an environment of any module that their arguments name.
        gate = name.startswith("GymV2")
        if self.trusted or not (colon or gate) or (module in sys.modules and not gate):
            return
        raise OutputError(
            f"{self.path / CONFIG} names an environment of the module "
            f"{module or 'in its arguments'}, which importing it would execute: if you know where "
            f"the run comes from, say --trust"
        )


def begin_run(path: Path | str, environment: str, settings: Settings, *, seed: int) -> Run:
    """Make the folder of a new run. If two processes try at once, one of them fails.

    The environment is made once, to record its sand.

    Args:
        path: the folder.
        environment: Gymnasium's id.
        settings: resolved.
        seed: all random numbers follow from it.

    Raises:
        OutputError: the folder is not empty, or cannot be written to.
        GranularError: the environment cannot be made; says why.
    """
    path = Path(path)
    if not 0 <= seed < 2**31:
        raise InputError(f"a seed is a whole number from 0 to {2**31 - 1}, not {seed}")
    if not is_text(environment):
        raise InputError(f"an environment has a name that can be printed, not {environment!r}")
    started = {"started": datetime.now(UTC).isoformat(timespec="seconds")}
    if path.exists() and not path.is_dir():
        raise OutputError(f"cannot write to {path}: it is not a folder")
    if (path / CONFIG).exists():  # a running one is locked, and is reported as a run too
        raise _held(path)
    sand = sands_made(environment, settings.environment)
    run = Run(path, environment, settings, seed, current_versions(), sand, trusted=True)
    with files.locked(path):
        files.remove_leftovers(path, (CONFIG,))
        if any(file.name != files.LOCK for file in path.iterdir()):
            raise _held(path)
        files.write_text(path / CONFIG, json.dumps({**run.config(), **started}, indent=2) + "\n")
    return run


def _held(path: Path) -> OutputError:
    held = "a training run" if (path / CONFIG).exists() else "something"
    return OutputError(
        f"{path} holds {held} already: choose another folder with --out, or go on with a "
        f"run by mjgranular train --resume {path}"
    )


def current_versions() -> dict[str, Any]:
    """Return the versions of the packages that a training depends on."""
    return versions(*_PACKAGES)


def open_run(path: Path, *, trust: bool = False) -> Run:
    """Return the run whose `config.json` is in a folder: a run, one of its checkpoints, a policy.

    Nothing in it is executed.

    Args:
        path: the folder.
        trust: whether the user trusts the run; see `Run.trusted`.

    Raises:
        OutputError: the folder holds no run.
    """
    try:
        content = read_json(path / CONFIG)
        command, environment = content.get("command"), content.get("environment")
        if command != TRAINING and is_text(command):
            raise OutputError(f"it is the result of mjgranular {command}")
        if not is_text(environment):
            raise OutputError(f"{CONFIG} names no environment")
        seed, made_with = content.get("seed"), content.get("versions")
        if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < 2**31:
            raise OutputError(f"{CONFIG}: seed must be a whole number from 0 to {2**31 - 1}")
        if not isinstance(made_with, dict) or not all(
            is_text(name) and (version is None or is_text(version))
            for name, version in made_with.items()
        ):
            raise OutputError(f"{CONFIG}: versions must name packages and their versions")
        settings = Settings.from_json(content.get("settings"))
        sand = read_sands(content.get("sand"), CONFIG)
    except MissingExtraError:
        raise
    except GranularError as error:
        raise OutputError(
            f"{path} holds no training run ({error}); make one with mjgranular train ENV --out "
            f"{path}"
        ) from None
    return Run(path, str(environment), settings, seed, made_with, sand, trust)


def read_state(checkpoint: Path) -> tuple[int, float]:
    """Return the steps and the seconds up to a checkpoint.

    Raises:
        OutputError: its file is damaged.
    """
    file = checkpoint / STATE
    content = read_json(file)
    steps, seconds = (number(content, name, file) for name in ("steps", "seconds"))
    if steps is None or seconds is None or steps < 0 or steps != int(steps):
        raise OutputError(f"{file} is damaged: steps and seconds must be numbers")
    return int(steps), seconds


def curve_text(rows: Sequence[Sequence[float]]) -> str:
    """Return a learning curve as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CURVE_COLUMNS)
    writer.writerows(rows)
    return text.getvalue()


def read_curve(file: Path) -> list[tuple[float, ...]]:
    """Read a learning curve; rows of `CURVE_COLUMNS`.

    Raises:
        OutputError: it cannot be read, or is not a curve.
    """
    text = read_text(file)
    try:
        rows = [tuple(map(float, row)) for row in list(csv.reader(io.StringIO(text)))[1:]]
    except (ValueError, csv.Error):
        raise OutputError(f"{file} is damaged: a learning curve consists of numbers") from None
    if not all(len(row) == len(CURVE_COLUMNS) and all(map(math.isfinite, row)) for row in rows):
        raise OutputError(f"{file} is damaged: a row is {', '.join(CURVE_COLUMNS)}")
    return rows
