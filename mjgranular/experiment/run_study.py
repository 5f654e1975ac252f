"""Running of a study, in processes or on Ray."""

import csv
import hashlib
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco

from mjgranular._util.checks import check_kind
from mjgranular._util.io import read_file
from mjgranular.errors import GranularError, InputError
from mjgranular.experiment.drop import Drop, loading, run_drop
from mjgranular.experiment.impact import Impact, run_impact
from mjgranular.experiment.intrusion import run_intrusion
from mjgranular.experiment.study import (
    Experiment,
    Study,
    Value,
    column_of,
    value_in_table,
    with_values,
)
from mjgranular.law import Law, law_in, laws, register_law
from mjgranular.medium import Medium, get_medium, media
from mjgranular.models import robot_path
from mjgranular.pool import Failure, Journal, Mapped, Workers, map_tasks

Row = dict[str, Any]
"""Result of one experiment: plain numbers and names."""

Custom = tuple[list[type[Law]], dict[str, Medium]]
"""Laws and media that are not part of the package: what a study needs besides, and workers too.

Workers import laws from the modules that define them.
"""


@dataclass(kw_only=True)
class StudyResult(Mapped):
    """Finished part of a study.

    Attributes:
        study: the study.
        journal: journal of the finished rows.
        failures: experiments without a row.
        stopped_by: the signal that interrupted the study before its end; None if none did.
    """

    study: Study

    @property
    def finished(self) -> int:
        """Number of rows."""
        return self.journal.count

    def rows(self) -> Iterator[Row]:
        """Yield the rows, in the order of the study, read from the disk one by one.

        The varied values come first, by `column_of` their names. Angles are in degrees if the name
        says so, everything else is in SI units.
        """
        return self.journal.results()

    def columns(self) -> list[str]:
        """Return the names of all columns of the rows."""
        names: dict[str, None] = {}
        for row in self.rows():
            names |= dict.fromkeys(row)
        return [*names]

    def write_csv(self, path: Path) -> None:
        """Write a CSV file with a line for each row; cells that a row lacks are empty."""
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self.columns())
            writer.writeheader()
            writer.writerows(self.rows())

    def describe(self, failure: Failure) -> str:
        """Return which experiment failed, with what values, and why."""
        table = {column_of(n): value_in_table(n, v) for n, v in self.study[failure.index].items()}
        values = (f"{n}={v:.6g}" if isinstance(v, float) else f"{n}={v}" for n, v in table.items())
        return f"number {failure.index} ({', '.join(values)}): {failure.reason}"


def run_study(
    study: Study,
    *,
    workers: Workers | int | None = None,
    journal: Journal | None = None,
    progress: Callable[[int], None] | None = None,
) -> StudyResult:
    """Run a study in processes that end with this one, or on Ray. Rows are bit-identical.

    Ctrl-C ends it early and keeps what is finished. A process that dies is replaced, and its
    experiments are repeated, for three attempts at most.

    Args:
        study: the experiments.
        workers: where they run, such as `pool.Workers("ray")`; or the number of processes of this
            machine, None for one per core. 1 is this process.
        journal: `journal_of` the study, opened; None for a temporary one.
        progress: called with the number of finished experiments.

    Raises:
        InputError: the first experiment cannot be set up, or the engine cannot be used.
    """
    check_kind(study, Study, "run_study", "Study(experiment, {'speed': [1.0, 2.0]})")
    if journal is not None:
        check_kind(journal, Journal, "run_study", "journal_of(study, folder), opened")
    custom = custom_of(study)
    if journal is None or journal.count < len(study):
        _try(study.at(0))
    mapped = map_tasks(
        _row,
        study,  # pyright: ignore[reportArgumentType] - it has what is used of a sequence
        shared=(_with_absolute_path(study.experiment), custom),
        on=workers if isinstance(workers, Workers) else Workers(count=workers),
        journal=journal,
        progress=progress,
    )
    return StudyResult(study=study, **vars(mapped))


def journal_of(study: Study, folder: Path | None) -> Journal:
    """Return the journal of a study in a folder; None for a temporary file."""
    check_kind(study, Study, "journal_of")
    # With the contents of files, since an edited model makes another study.
    asked = {**study.config(), "files": digest(study)}
    return Journal(folder, asked, len(study))


def run_experiment(experiment: Experiment) -> Row:
    """Run an experiment, and return its result as one row."""
    if isinstance(experiment, Impact):
        return run_impact(experiment).summary()
    if isinstance(experiment, Drop):
        return run_drop(experiment).row()
    return run_intrusion(experiment).row()


def _try(experiment: Experiment) -> None:
    """Set up the first experiment, and make a step.

    This reports what is wrong with all of them before workers start, and compiles missing machine
    code once, not in all of them.
    """
    short: dict[str, Any] = {"points": 2}
    if isinstance(experiment, Impact):
        short = {"duration": experiment.timestep}
    elif isinstance(experiment, Drop):
        short = {"duration": 1e-9}
    try:
        run_experiment(replace(experiment, **short))
    except GranularError as error:
        if isinstance(error, (InputError, KeyError)):
            raise


def _with_absolute_path(experiment: Experiment) -> Experiment:
    """Return the experiment with a path of its model for workers in other folders."""
    if isinstance(experiment, Impact) or experiment.model is None:
        return experiment
    return replace(experiment, model=robot_path(experiment.model).absolute())


def _row(shared: tuple[Experiment, Custom], values: Mapping[str, Value]) -> Row:
    """Return the row of one experiment, in any process; the varied values come first."""
    experiment, (custom_laws, custom_media) = shared
    for law in custom_laws:
        if law.name not in laws:
            register_law(law)
    for name, medium in custom_media.items():
        media.add(name, medium, replace=True)
    varied = {column_of(name): value_in_table(name, value) for name, value in values.items()}
    row = {**varied, **run_experiment(with_values(experiment, values)), **varied}
    # Tables have no infinities: the cell is empty.
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in row.items()
    }


_LARGEST = 256 * 2**20  # bytes of a file; chosen
_SHIPPED = dict(media)  # those of the package: every worker has them


def custom_of(study: Study) -> Custom:
    """Return what a study uses; a law defined where workers cannot import it is an error."""
    names = {text.partition(" density=")[0] for text in _words(study, "medium")}
    used = {name: get_medium(name) for name in sorted(names)}
    others = {name: one for name, one in used.items() if _SHIPPED.get(name) is not one}
    return list(_laws(study)), others


def _laws(study: Study) -> Iterator[type[Law]]:
    """Yield the laws that a study uses and that are not part of the package."""
    kinds = {law_in(text)[0].name: law_in(text)[0] for text in _words(study, "law")}
    for kind in kinds.values():
        package = kind.__module__.partition(".")[0]
        if package == "__main__":
            raise InputError(
                f"the law {kind.name!r} is defined in a script or notebook, where workers do not "
                "find it: put it into a module, a separate file"
            )
        if package != "mjgranular":
            yield kind


def _words(study: Study, name: str) -> list[str]:
    """Return all values of a field in a study, except None."""
    values: Any = study.vary.get(name, [getattr(study.experiment, name)])
    return [str(value) for value in values if value is not None]


def digest(study: Study) -> str:
    """Return a digest of the files, laws and media on which the results of a study depend."""
    (custom_laws, custom_media), digest = custom_of(study), hashlib.sha256()
    modules = [Path(sys.modules[law.__module__].__file__ or "") for law in custom_laws]
    for path in [*_files(study.experiment), *modules]:
        content = read_file(path, "a file of the study", largest=_LARGEST)
        digest.update(f"{path.name}\0{len(content)}\0".encode() + content)
    for name, medium in custom_media.items():
        digest.update(f"{name}\0{medium}".encode())
    return digest.hexdigest()


def _files(experiment: Experiment) -> list[Path]:
    """Return the model's file, and those that it refers to."""
    if isinstance(experiment, Impact) or experiment.model is None:
        return []
    model = robot_path(experiment.model)
    if model.suffix.lower() not in (".xml", ".urdf"):
        return [model]
    with loading(model.name):
        return [model, *(Path(file) for file in mujoco.mju_getXMLDependencies(str(model)))]
