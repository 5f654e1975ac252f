"""The folder a result goes to: claimed before the work, written at its end, nothing lost."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular._util import files
from mjgranular._util.io import (
    checked_fields,
    is_plain_name,
    is_text,
    number,
    read_arrays,
    read_json,
)
from mjgranular.errors import GranularError, OutputError
from mjgranular.experiment.drop import Drop, DropResult
from mjgranular.experiment.impact import Impact, ImpactResult
from mjgranular.experiment.trajectory import Trajectory
from mjgranular.pool.versions import versions
from mjgranular.prints import Prints

CONFIG = "config.json"
SUMMARY = "summary.json"
TRAINING = "train"
"""Command that `config.json` of a training run names."""
_CSV = "trajectory.csv"
_NPZ = "trajectory.npz"


class ResultFolder:
    """A folder for the files of one result.

    Args:
        path: the folder; need not exist.
        names: names of the files that may be written.

    Attributes:
        path: the folder.
    """

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self.path = path
        self._names = tuple(names)
        self._waiting: Path | None = None  # where files lie that are to be published together

    @contextmanager
    def claimed(
        self, *, overwrite: bool = False, goes_on: Callable[[], bool] | None = None
    ) -> Iterator[ResultFolder]:
        """Makes sure beforehand that the result can be written, and cleans up if there is none.

        Until then no other process can write a result there.

        Args:
            overwrite: whether files of these names may be replaced.
            goes_on: asked, when nobody else is at work there, whether what is there is a part of
                this very result; then it may be replaced, too.

        Raises:
            OutputError: another process is at work in the folder, it holds one of the files already
                and `overwrite` is false, it holds a training run, is not a folder, or it cannot be
                written to.
        """
        made = _missing(self.path)
        # A single file, such as a film, may go to a folder in which a process is at work.
        lock = files.LOCK if self._is_a_result else f".{self._names[0]}{files.LOCK}"
        try:
            with files.locked(self.path, lock):
                if self._is_a_result:
                    files.finish_publishing(self.path)
                files.remove_leftovers(self.path, self._names)
                self._check(overwrite or (goes_on is not None and goes_on()))
                yield self
        finally:
            for folder in made:  # the innermost first; one with something in it stays
                with suppress(OSError):
                    folder.rmdir()

    @property
    def _is_a_result(self) -> bool:
        return CONFIG in self._names or SUMMARY in self._names

    def _check(self, overwrite: bool) -> None:
        present = [name for name in self._names if (self.path / name).exists()]
        if present and not overwrite:
            raise OutputError(
                f"{self.path} holds a result already ({', '.join(present)}): choose another "
                "folder, or say --overwrite"
            )
        if CONFIG in present and self._command() == TRAINING:
            raise OutputError(
                f"{self.path} holds a training run, which --overwrite does not replace: choose "
                "another folder"
            )

    def _command(self) -> object:
        with suppress(OutputError):
            return read_json(self.path / CONFIG).get("command")
        return None

    @contextmanager
    def published(self, *, keep: Sequence[str] = ()) -> Iterator[None]:
        """Publishes what is written within at once, in place of the whole result that was there.

        Args:
            keep: names of files to keep although they are not written again.
        """
        stale = [name for name in (*self._names, *self._names_before()) if name not in keep]
        with files.replace_directory(self.path, instead_of=stale) as waiting:
            self._waiting = waiting
            try:
                yield
            finally:
                self._waiting = None

    def _names_before(self) -> list[str]:
        """Files that the result may have which is there now; another command's, perhaps."""
        names: object = None
        with suppress(OutputError):
            names = read_json(self.path / CONFIG).get("files")
        return [name for name in names if is_plain_name(name)] if isinstance(names, list) else []

    def write(self, name: str, fill: Callable[[Path], object]) -> Path:
        """Writes one file whole or not at all.

        Args:
            name: of the file, one of those claimed.
            fill: writes the path it is given.
        """
        path = (self._waiting or self.path) / name
        with files.atomic_write(path) as part:
            fill(part)
        return self.path / name

    def write_json(self, name: str, content: Any) -> Path:
        """Writes numbers and names as JSON."""
        text = json.dumps(content, indent=2, allow_nan=False) + "\n"
        return self.write(name, lambda path: path.write_text(text, encoding="utf-8"))

    def write_config(self, command: str, config: dict[str, Any]) -> Path:
        """Writes what was asked for, resolved, and what it was made with."""
        return self.write_json(
            CONFIG,
            {
                "command": command,
                "config": config,
                "seed": None,  # nothing is random
                "versions": versions(),
                "finished": datetime.now(UTC).isoformat(timespec="seconds"),
                "files": list(self._names),
            },
        )


def _missing(folder: Path) -> list[Path]:
    """Folders that have to be made, the innermost first."""
    missing = []
    while not folder.exists() and folder != folder.parent:
        missing.append(folder)
        folder = folder.parent
    return missing


RUN_FILES = (CONFIG, SUMMARY, _CSV, _NPZ)


def write_impact(folder: ResultFolder, result: ImpactResult) -> None:
    """Writes a drop: configuration, trajectory and summary, at once."""
    with folder.published():
        folder.write_config("impact", {**asdict(result.impact), "law": result.law})
        folder.write(_CSV, result.trajectory.write_csv)
        folder.write(_NPZ, lambda path: result.trajectory.write_npz(path, result.prints))
        folder.write_json(SUMMARY, result.summary())


_DROP_ARRAYS = ("t", "qpos", "qvel", "depth", "point", "force", "power")


def write_drop(folder: ResultFolder, result: DropResult) -> None:
    """Writes a run of a model: configuration, samples and summary, at once."""
    arrays = {name: getattr(result, name) for name in _DROP_ARRAYS}
    if result.prints is not None:
        arrays |= result.prints.arrays()
    with folder.published():
        folder.write_config("drop", result.drop.config())
        folder.write(_CSV, lambda path: _write_drop_csv(path, result))
        folder.write(_NPZ, lambda path: np.savez_compressed(path, **arrays))
        folder.write_json(SUMMARY, result.summary())


def _write_drop_csv(path: Path, result: DropResult) -> None:
    header = ["t [s]"]
    columns = [result.t[:, None]]
    for k, body in enumerate(result.bodies):
        header += [
            f"{body.body}: {name}" for name in ("depth [m]", "F_x [N]", "F_y [N]", "F_z [N]")
        ]
        header.append(f"{body.body}: power [W]")
        columns += [result.depth[:, k, None], result.force[:, k], result.power[:, k, None]]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows([[repr(float(v)) for v in row] for row in np.hstack(columns)])


def saved_command(path: Path) -> str:
    """The command whose result a folder holds.

    Raises:
        OutputError: it holds none.
    """
    try:
        command = read_json(files.latest_path(path, CONFIG)).get("command")
    except OutputError as error:
        raise OutputError(
            f"{path} holds no saved run ({error}); make one with mjgranular impact --out {path}"
        ) from None
    if not is_text(command):
        raise OutputError(f"{path} holds no saved run ({CONFIG} names no command)")
    return str(command)


def read_drop(path: Path) -> tuple[Drop, dict[str, np.ndarray]]:
    """Reads a run of a model that was written before: what was asked for, and the samples.

    Raises:
        OutputError: the folder holds no such result.
    """

    def read() -> tuple[Drop, dict[str, np.ndarray]]:
        config = read_json(files.latest_path(path, CONFIG)).get("config")
        drop, file = Drop.from_config(config), files.latest_path(path, _NPZ)
        names = _DROP_ARRAYS
        if drop.sand.memory is not None and Prints.are_in(file):
            names += Prints.names()
        return drop, read_arrays(file, names)

    try:
        drop, arrays = files.read_consistent(path, CONFIG, read)
    except (GranularError, ValueError, KeyError, TypeError) as error:
        raise OutputError(f"{path} holds no saved drop ({error})") from None
    try:
        prints_of(arrays)
    except ValueError as error:
        raise OutputError(f"{path} holds no saved drop ({_NPZ} is damaged: {error})") from None
    wrong = _fault_of_samples(arrays, drop.duration)
    if wrong is not None:
        raise OutputError(f"{path} holds no saved drop ({_NPZ} is damaged: {wrong})")
    return drop, arrays


def prints_of(arrays: dict[str, np.ndarray]) -> Prints | None:
    """The prints among the samples of a run; None if there are none.

    Raises:
        ValueError: they do not fit together.
    """
    return Prints.from_arrays(arrays) if Prints.names()[0] in arrays else None


def _fault_of_samples(arrays: dict[str, np.ndarray], duration: float) -> str | None:
    """Finds what is wrong with the samples of a run of a model; None if nothing is."""
    t, force = arrays["t"], arrays["force"]
    if t.ndim != 1 or not len(t) or force.shape != (len(t), *force.shape[1:2], 3):
        return "it has no samples"
    if arrays["point"].shape != force.shape:
        return "points and forces do not fit together"
    if arrays["qpos"].shape[:1] != t.shape or arrays["qpos"].ndim != 2:
        return "times and positions do not fit together"
    if (np.diff(t) <= 0).any() or t[-1] - t[0] > 1.01 * duration:
        return "its times are not those of a run"
    return None


def read_impact(path: Path) -> tuple[Impact, dict[str, Any], Trajectory]:
    """Reads a drop that was written before: what was asked for, summary, trajectory.

    Raises:
        OutputError: the folder holds no such result.
    """

    def read() -> tuple[Impact, dict[str, Any], Trajectory]:
        config = read_json(files.latest_path(path, CONFIG))
        if config.get("command") != "impact":
            raise OutputError(
                f"{path} holds the result of {str(config.get('command'))[:40]!r}: a video can be "
                "made of an impact, mjgranular impact --out DIR"
            )
        summary = read_json(files.latest_path(path, SUMMARY))
        impact = Impact(**checked_fields(Impact, config.get("config"), path / CONFIG))
        trajectory = Trajectory.read_npz(files.latest_path(path, _NPZ))
        _check_summary(summary, float(trajectory.t[-1]), path / SUMMARY)
        return impact, summary, trajectory

    try:
        return files.read_consistent(path, CONFIG, read)
    except (GranularError, ValueError, KeyError, TypeError) as error:
        raise OutputError(
            f"{path} holds no saved impact ({error}); make one with mjgranular impact --out {path}"
        ) from None


def read_prints(path: Path) -> Prints | None:
    """Reads the prints of an impact that was written before; None for sand that did not remember.

    Raises:
        OutputError: they are damaged.
    """
    try:
        file = files.latest_path(path, _NPZ)
        return prints_of(read_arrays(file, Prints.names())) if Prints.are_in(file) else None
    except (GranularError, ValueError, KeyError, TypeError) as error:
        raise OutputError(f"{path} holds no saved impact ({_NPZ} is damaged: {error})") from None


def _check_summary(summary: dict[str, Any], end: float, file: Path) -> None:
    """Refuses a summary without what figures and films need of it."""
    for name in ("speed", "angle_deg", "timestep"):
        if number(summary, name, file) is None:
            raise OutputError(f"{file} is damaged: {name} must be a number")
    stop, touch = (number(summary, name, file) for name in ("stopping_time", "touchdown_time"))
    if end <= 0 or (stop is not None and (touch is None or not 0 < touch + stop <= 1.01 * end)):
        raise OutputError(f"{file} is damaged: the stop is not within the run")
