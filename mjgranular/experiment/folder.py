"""Files of saved runs: impacts and drops."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular._util import files
from mjgranular._util.io import checked_fields, is_text, number, read_arrays, read_json
from mjgranular._util.result_folder import CONFIG, SUMMARY, ResultFolder
from mjgranular.errors import GranularError, OutputError
from mjgranular.experiment.drop import Drop, DropResult
from mjgranular.experiment.impact import Impact, ImpactResult
from mjgranular.experiment.trajectory import Trajectory
from mjgranular.relief.memory import as_memory
from mjgranular.render import Tracks

_NPZ = "trajectory.npz"
RUN_FILES = (CONFIG, SUMMARY, _NPZ)
_DROP_ARRAYS = ("t", "qpos", "qvel", "depth", "point", "force", "power")


def write_run(folder: ResultFolder, result: ImpactResult | DropResult) -> None:
    """Write an impact or a drop: configuration, samples and summary, at once."""
    if isinstance(result, ImpactResult):
        command, config = "impact", {**asdict(result.impact), "law": result.law}
        arrays = dict(vars(result.trajectory))
    else:
        command, config = "drop", asdict(result.drop)
        arrays = {name: getattr(result, name) for name in _DROP_ARRAYS}
    if result.prints is not None:
        arrays |= result.prints.arrays()
    with folder.published(command, config, result.summary(), unfinished=True):
        folder.write(_NPZ, lambda path: np.savez_compressed(path, **arrays))


def saved_command(path: Path) -> str:
    """Return the command whose result a folder contains."""
    with _saved(path, "run"):
        command = read_json(files.latest_path(path, CONFIG)).get("command")
        if not is_text(command):
            raise OutputError(f"{CONFIG} names no command")
    return str(command)


def read_drop(path: Path) -> tuple[Drop, dict[str, np.ndarray]]:
    """Read a saved run of a model: options, and the samples."""

    def read() -> tuple[Drop, dict[str, np.ndarray]]:
        config = read_json(files.latest_path(path, CONFIG)).get("config")
        drop, file = Drop.from_config(config), files.latest_path(path, _NPZ)
        names = _DROP_ARRAYS
        if as_memory(drop.sand.memory) is not None:
            names += Tracks.names()
        arrays = read_arrays(file, names)
        prints_of(arrays)  # raises if they are damaged
        if len({len(arrays[name]) for name in _DROP_ARRAYS}) != 1:
            raise OutputError(f"{file} is damaged: numbers of times and samples differ")
        return drop, arrays

    with _saved(path, "drop"):
        return files.read_consistent(path, CONFIG, read)


@contextmanager
def _saved(path: Path, what: str) -> Iterator[None]:
    """Turn any error of reading a folder into one sentence."""
    try:
        yield
    except (GranularError, ValueError, KeyError, TypeError) as error:
        command = "drop MODEL.xml" if what == "drop" else "impact"
        raise OutputError(
            f"{path} holds no saved {what} ({error}); use mjgranular {command} --out {path}"
        ) from None


def prints_of(arrays: dict[str, np.ndarray]) -> Tracks | None:
    """Return the tracks among the samples of a run; None if there are none."""
    return Tracks.from_arrays(arrays) if Tracks.names()[0] in arrays else None


def read_impact(path: Path) -> tuple[Impact, dict[str, Any], Trajectory, Tracks | None]:
    """Read a saved impact: options, summary, trajectory, and the tracks in sand with memory."""

    def read() -> tuple[Impact, dict[str, Any], Trajectory, Tracks | None]:
        config = read_json(files.latest_path(path, CONFIG))
        if config.get("command") != "impact":
            raise OutputError(
                f"{path} holds the result of {str(config.get('command'))[:40]!r}: a video can be "
                "made of an impact, mjgranular impact --out DIR"
            )
        summary = read_json(files.latest_path(path, SUMMARY))
        for name in ("touchdown_time", "stopping_time"):
            number(summary, name, path / SUMMARY)
        impact = Impact(**checked_fields(Impact, config.get("config"), path / CONFIG))
        file = files.latest_path(path, _NPZ)
        names = () if as_memory(impact.memory) is None else Tracks.names()
        return impact, summary, Trajectory.read_npz(file), prints_of(read_arrays(file, names))

    with _saved(path, "impact"):
        return files.read_consistent(path, CONFIG, read)
