"""The folder of a run: settings, checkpoints, the curve; one process at a time."""

import csv
import io
import json
import math
import shutil
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

from mjgranular._util import files
from mjgranular._util.io import fits, is_text, read_json, read_text
from mjgranular._util.result_folder import CONFIG, TRAINING, versions
from mjgranular.errors import GranularError, InputError, OutputError, shown, warn_user
from mjgranular.learn.sands import Sands, changes, is_sands, sands_made
from mjgranular.learn.settings import Settings, algorithm_class

CHECKPOINTS = "checkpoints"
TENSORBOARD = "tensorboard"
CURVE = "curve.csv"
POLICY = "policy.zip"
NORMALIZER = "normalizer.json"
STATE = "state.json"
CURVE_COLUMNS = ("steps", "seconds", "episodes", "mean_return", "mean_length")
PACKAGES = ("gymnasium", "stable-baselines3", "torch")
"""Packages that a training depends on; their versions are recorded."""
_LARGEST_SEED = 2**31 - 1
_IN_A_CHECKPOINT = (CONFIG, POLICY, NORMALIZER, CURVE, STATE)


@dataclass(frozen=True)
class Run:
    """A training run on disk."""

    path: Path  # its folder
    environment: str  # Gymnasium's id
    settings: Settings  # resolved
    seed: int  # all random numbers follow from it
    versions: dict[str, Any]  # versions of the packages that it was started with
    sand: Sands | None = None  # of its environment when it started, as of `sands_of`
    trusted: bool = False  # whether modules that it names may be imported

    @property
    def arguments(self) -> dict[str, Any]:
        return dict(self.settings.environment)

    @property
    def name(self) -> str:
        return f"{self.environment} {self.settings.algorithm} seed {self.seed}"

    def config(self) -> dict[str, Any]:
        return {
            "command": TRAINING,
            "environment": self.environment,
            "sand": self.sand,
            "seed": self.seed,
            "settings": self.settings.as_json(),
            "versions": self.versions,
        }

    def locked(self) -> AbstractContextManager[None]:
        """Lock the folder; raise `OutputError` if another process has locked it."""
        return files.locked(self.path)

    def checkpoints(self) -> list[Path]:
        """Return the folders of the checkpoints, the newest first, damaged ones included."""
        return sorted((self.path / CHECKPOINTS).glob("step-*"), reverse=True)

    def newest_checkpoint(self) -> Path | None:
        """Return the newest complete checkpoint; a damaged one is skipped with a warning."""
        for folder in self.checkpoints():
            wrong = files.find_corruption(folder, _IN_A_CHECKPOINT)
            if wrong is None:
                return folder
            if folder.exists():  # otherwise a running training has replaced it by a newer one
                warn_user(f"the checkpoint {folder} is damaged ({wrong}) and was skipped")
        return None

    def checkpoint_folder(self, steps: int) -> Path:
        """Return the path of the checkpoint after `steps` steps."""
        return self.path / CHECKPOINTS / f"step-{steps:010d}"

    def extended(self, total_steps: int) -> Self:
        """Return the run with another number of steps, and write that to its folder."""
        longer = replace(self, settings=replace(self.settings, total_steps=total_steps))
        file = self.path / CONFIG
        content = {**read_json(file, infinite=True), **longer.config()}
        files.write_text(file, json.dumps(content, indent=2) + "\n")
        return longer

    def discard(self) -> None:
        """Remove the folder of a run without a checkpoint."""
        if not self.checkpoints():
            shutil.rmtree(self.path, ignore_errors=True)

    def steps(self) -> int:
        """Return the number of steps of the newest checkpoint; 0 without one."""
        folder = self.newest_checkpoint()
        return 0 if folder is None else int(folder.name.partition("-")[2])

    def version_names(self) -> str:
        """Return the packages that the run was started with, for messages."""
        return ", ".join(f"{name} {self.versions.get(name)}" for name in PACKAGES)

    def warn_of_sand(self, now: Sands | None) -> None:
        """Warn if sand differs from that at the start of the run."""
        if different := changes(self.sand, now):
            warn_user(f"{self.path} was started on other sand: {different}")

    def check_environment(self) -> None:
        """Check that no module is imported only because an untrusted file names it.

        One named `module:Name-v0` must be imported already, unless the user trusts the run.
        """
        module, colon, name = self.environment.rpartition(":")
        # These of Gymnasium make an environment of any module that their arguments name.
        indirect = name.startswith("GymV2")
        if self.trusted or not (colon or indirect) or (module in sys.modules and not indirect):
            return
        raise OutputError(
            f"{self.path / CONFIG} names an environment of the module "
            f"{module or 'in its arguments'}, and importing it would execute it: if you trust the "
            "source of the run, use --trust"
        )


def begin_run(path: Path | str, environment: str, settings: Settings, *, seed: int) -> Run:
    """Make the folder of a new run. If two processes try at once, one of them fails.

    The environment, by Gymnasium's id, is made once, to record its sand. All random numbers follow
    from the seed. Files that it is made with, such as a medium's, are noted with absolute paths.

    Raises:
        OutputError: the folder is not empty, or cannot be written to.
        MissingExtraError: Stable-Baselines3 is not installed; gives the install line.
        GranularError: the environment cannot be made; says why.
    """
    path = Path(path)
    _checked_seed(seed)
    if not is_text(environment):
        raise InputError(f"environment must be a printable name, got {shown(environment)}")
    algorithm_class(settings.algorithm)  # raises where it is not installed
    sand = sands_made(environment, settings.environment)
    settings = replace(settings, environment=_with_absolute_paths(settings.environment))
    run = Run(path, environment, settings, seed, versions(*PACKAGES), sand, trusted=True)
    with files.locked(path):
        files.remove_leftovers(path, (CONFIG,))
        if any(file.name != files.LOCK for file in path.iterdir()):
            content = "a training run" if (path / CONFIG).exists() else "something"
            raise OutputError(
                f"{path} holds {content} already: choose another folder with --out, or resume a "
                f"run with mjgranular train --resume {path}"
            )
        config = {**run.config(), "started": datetime.now(UTC).isoformat(timespec="seconds")}
        files.write_text(path / CONFIG, json.dumps(config, indent=2) + "\n")
    return run


def _with_absolute_paths(value: Any) -> Any:
    """Return arguments with absolute paths of existing files; options may follow a path."""
    if isinstance(value, dict):
        return {name: _with_absolute_paths(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_with_absolute_paths(one) for one in value]
    if isinstance(value, str):
        path, gap, options = value.partition(" ")
        with suppress(OSError):  # of a name that is too long
            if Path(path).suffix and Path(path).is_file():
                return f"{Path(path).absolute()}{gap}{options}"
    return value


def open_run(path: Path, *, trust: bool = False) -> Run:
    """Return the run whose `config.json` is in a folder: a run, one of its checkpoints, a policy.

    Nothing in it is executed. `trust` says that modules that it names may be imported.

    Raises:
        OutputError: the folder holds no run.
    """
    try:
        content = read_json(path / CONFIG, infinite=True)  # an option may be: rigid
        command, environment = content.get("command"), content.get("environment")
        if command not in (None, TRAINING):
            raise OutputError(f"it is the result of mjgranular {command}")
        if not is_text(environment):
            raise OutputError(f"{CONFIG} must name an environment")
        made_with, sand = content.get("versions"), content.get("sand")
        if not isinstance(made_with, dict):
            raise OutputError(f"{CONFIG}: versions must name packages and their versions")
        if sand is not None and not is_sands(sand):
            raise OutputError(f"{CONFIG}: sand must be a list of tables")
        seed = _checked_seed(content.get("seed"))
        settings = Settings.from_json(content.get("settings"))
    except GranularError as error:
        raise OutputError(
            f"{path} holds no training run ({error}); start one with mjgranular train ENV --out "
            f"{path}"
        ) from None
    return Run(path, str(environment), settings, seed, made_with, sand, trust)


def _checked_seed(seed: Any) -> int:
    if not fits(seed, int) or not 0 <= seed <= _LARGEST_SEED:
        raise InputError(f"a seed must be an integer from 0 to {_LARGEST_SEED}, got {shown(seed)}")
    return seed


def curve_text(rows: Sequence[Sequence[float]]) -> str:
    """Return a learning curve as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CURVE_COLUMNS)
    writer.writerows((int(steps), time, int(count), *means) for steps, time, count, *means in rows)
    return text.getvalue()


def mean_returns(curve: Sequence[tuple[float, ...]], episodes: int) -> list[tuple[float, float]]:
    """Return steps and mean returns of a learning curve, each over at least `episodes` episodes.

    At a checkpoint all episodes start over, so that those that end soon after it have failed: a row
    of few episodes says little. What remains at the end is left out, unless it is all there is.
    """
    points, count, total = [], 0.0, 0.0
    for steps, _, ended, mean, _ in curve:
        count, total = count + ended, total + ended * mean
        if count >= episodes:
            points.append((steps, total / count))
            count, total = 0.0, 0.0
    return points or [(row[0], total / count) for row in curve[-1:]]


def read_curve(file: Path) -> list[tuple[float, ...]]:
    """Read a learning curve; rows of `CURVE_COLUMNS`."""
    text = read_text(file)
    try:
        rows = [tuple(map(float, row)) for row in list(csv.reader(io.StringIO(text)))[1:]]
    except (ValueError, csv.Error):
        rows = [()]
    if not all(len(row) == len(CURVE_COLUMNS) and all(map(math.isfinite, row)) for row in rows):
        raise OutputError(f"{file} is damaged: rows must be numbers, {', '.join(CURVE_COLUMNS)}")
    return rows
