"""The folder a result goes to: claimed before the work, written at its end, nothing lost."""

from __future__ import annotations

import csv
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular.errors import OutputError
from mjgranular.experiment.drop import Drop, DropResult
from mjgranular.experiment.impact import Impact, ImpactResult
from mjgranular.experiment.provenance import versions
from mjgranular.experiment.trajectory import Trajectory

CONFIG = "config.json"
SUMMARY = "summary.json"
_CSV = "trajectory.csv"
_NPZ = "trajectory.npz"


class ResultFolder:
    """A folder for the files of one result.

    Args:
        path: the folder; need not exist.
        names: names of the files that will be written.

    Attributes:
        path: the folder.
    """

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self.path = path
        self._names = tuple(names)

    @contextmanager
    def claimed(self, *, overwrite: bool = False) -> Iterator[ResultFolder]:
        """Makes sure beforehand that the result can be written, and cleans up if there is none.

        Raises:
            OutputError: the folder holds one of the files already and `overwrite` is false, it is
                not a folder, or it cannot be written to.
        """
        if not overwrite:
            present = [name for name in self._names if (self.path / name).exists()]
            if present:
                raise OutputError(
                    f"{self.path} holds a result already ({', '.join(present)}): choose another "
                    "folder, or say --overwrite"
                )
        made = self._make()
        try:
            yield self
        finally:
            for folder in made:  # the innermost first; one with something in it stays
                with suppress(OSError):
                    folder.rmdir()

    def _make(self) -> list[Path]:
        missing = []
        folder = self.path
        while not folder.exists() and folder != folder.parent:
            missing.append(folder)
            folder = folder.parent
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.path):
                pass
        except OSError as error:
            for made in missing:
                with suppress(OSError):
                    made.rmdir()
            raise OutputError(
                f"cannot write to {self.path}: {error.strerror or error}; choose a folder that "
                "can be written to"
            ) from None
        return missing

    def write(self, name: str, fill: Callable[[Path], object]) -> Path:
        """Writes one file whole or not at all.

        Args:
            name: of the file, one of those claimed.
            fill: writes the path it is given.
        """
        path = self.path / name
        # The ending stays: writers choose the format by it.
        part = self.path / f".{path.stem}.part{os.getpid()}{path.suffix}"
        try:
            fill(part)
            part.replace(path)
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror or error}") from None
        finally:
            with suppress(OSError):
                part.unlink()
        return path

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
            },
        )


RUN_FILES = (CONFIG, SUMMARY, _CSV, _NPZ)


def write_impact(folder: ResultFolder, result: ImpactResult) -> None:
    """Writes a drop: configuration, trajectory and, last, the summary."""
    folder.write_config("impact", {**asdict(result.impact), "law": result.law})
    folder.write(_CSV, result.trajectory.write_csv)
    folder.write(_NPZ, result.trajectory.write_npz)
    folder.write_json(SUMMARY, result.summary())


_DROP_ARRAYS = ("t", "qpos", "qvel", "depth", "point", "force", "power")


def write_drop(folder: ResultFolder, result: DropResult) -> None:
    """Writes a run of a model: configuration, samples and, last, the summary."""
    folder.write_config("drop", result.drop.config())
    folder.write(_CSV, lambda path: _write_drop_csv(path, result))
    arrays = {name: getattr(result, name) for name in _DROP_ARRAYS}
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
        return str(json.loads((path / CONFIG).read_text(encoding="utf-8"))["command"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OutputError(
            f"{path} holds no saved run ({error}); make one with mjgranular impact --out {path}"
        ) from None


def read_drop(path: Path) -> tuple[Drop, dict[str, np.ndarray]]:
    """Reads a run of a model that was written before: what was asked for, and the samples.

    Raises:
        OutputError: the folder holds no such result.
    """
    try:
        config = json.loads((path / CONFIG).read_text(encoding="utf-8"))["config"]
        with np.load(path / _NPZ) as arrays:
            return Drop.from_config(config), {name: arrays[name] for name in _DROP_ARRAYS}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OutputError(f"{path} holds no saved drop ({error})") from None


def read_impact(path: Path) -> tuple[Impact, dict[str, Any], Trajectory]:
    """Reads a drop that was written before: what was asked for, summary, trajectory.

    Raises:
        OutputError: the folder holds no such result.
    """
    try:
        config = json.loads((path / CONFIG).read_text(encoding="utf-8"))
        summary = json.loads((path / SUMMARY).read_text(encoding="utf-8"))
        if config["command"] != "impact":
            raise OutputError(
                f"{path} holds the result of '{config['command']}': a video can be made of an "
                "impact, mjgranular impact --out DIR"
            )
        return Impact(**config["config"]), summary, Trajectory.read_npz(path / _NPZ)
    except (OSError, ValueError, KeyError, TypeError) as error:
        if isinstance(error, OutputError):
            raise
        raise OutputError(
            f"{path} holds no saved impact ({error}); make one with mjgranular impact --out {path}"
        ) from None
