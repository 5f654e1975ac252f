"""Studies: an experiment with some of its fields varied, run in processes or on Ray."""

import csv
import hashlib
import math
import sys
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_args

import mujoco
import numpy as np

from mjgranular._util.checks import check_kind, check_name, is_finite, kind_of
from mjgranular._util.io import read_file
from mjgranular.errors import GranularError, InputError, UnknownNameError, loading, shown
from mjgranular.experiment.drop import Drop, run_drop
from mjgranular.experiment.impact import Impact, run_impact
from mjgranular.experiment.intrusion import Intrusion, run_intrusion
from mjgranular.experiment.trajectory import degrees
from mjgranular.law import Law, law_in, laws, register_law
from mjgranular.medium import Medium, get_medium, media
from mjgranular.models import robot_path
from mjgranular.pool import Failure, Journal, Mapped, Workers, map_tasks

Experiment = Impact | Drop | Intrusion
Value = float | int | str

ANGLES = ("angle", "slope", "uphill", "tilt", "direction")
"""Fields in radians, which are in degrees on the command line and in tables."""

LAW, DENSITY = "law.", "medium.density"
_MOST = 10**9  # tasks; chosen: a larger grid is a mistake
_CHECKED = 1000  # values of a field that are checked beforehand; of more, both ends
_NOT_VARIED = ("model", "bodies", "geoms", "groups", "instead_of", "keep_floor")


@dataclass(frozen=True)
class Study:
    """An experiment with some of its fields varied.

    Every value of a field is combined with every value of the others, the last field fastest.

    Attributes:
        experiment: the common part: an `Impact`, a `Drop` or an `Intrusion`.
        vary: values of each varied field. Fields of the experiment, in SI units and radians;
            `law.NAME` is a parameter of the law; `medium.density` is the bulk density of the sand
            [kg/m^3].

    Raises:
        InputError: nothing is varied, or a value is invalid.
        UnknownNameError: no such field; lists the valid ones.
    """

    experiment: Experiment = field(default_factory=Impact)
    vary: Mapping[str, Sequence[Value]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.experiment, get_args(Experiment)):
            raise InputError(
                f"a study is of an Impact, a Drop or an Intrusion, got {kind_of(self.experiment)}"
            )
        if not isinstance(self.vary, Mapping):
            raise InputError(f"vary must be a table, {{'speed': [1, 2]}}, got {kind_of(self.vary)}")
        if not self.vary:
            raise InputError("a study varies something, such as speed=(1.0, 2.0)")
        for name, values in self.vary.items():
            if isinstance(values, str) or not isinstance(values, (Sequence, np.ndarray)):
                raise InputError(f"{name} needs a list of values, got {kind_of(values)}")
            if not len(values):
                raise InputError(f"{name} needs at least one value")
            for value in values:
                if not isinstance(value, str) and not is_finite(value):
                    raise InputError(f"values of {name} are finite numbers or names, got {value!r}")
        if len(self) > _MOST:
            raise InputError(f"a study has at most {_MOST} points, got {len(self)}")
        # Each value of each field, the other fields at their first; of very many values both ends.
        some = {
            name: [*map(_plain, values if len(values) <= _CHECKED else (values[0], values[-1]))]
            for name, values in self.vary.items()
        }
        first = {name: values[0] for name, values in some.items()}
        for name, values in some.items():
            for value in values:
                with_values(self.experiment, {**first, name: value})

    def __len__(self) -> int:
        return math.prod(self._shape)

    def __getitem__(self, index: int) -> dict[str, Value]:
        """Return the values of one experiment, by the names of the fields."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        at = np.unravel_index(index, self._shape)
        return {
            name: _plain(values[int(k)])
            for (name, values), k in zip(self.vary.items(), at, strict=True)
        }

    def at(self, index: int) -> Experiment:
        """Return one of the experiments."""
        return with_values(self.experiment, self[index])

    def config(self) -> dict[str, Any]:
        """Return the study in plain values."""
        common = asdict(self.experiment).items()
        return {
            "experiment": type(self.experiment).__name__.lower(),
            "common": {key: str(v) if isinstance(v, Path) else v for key, v in common},
            "vary": {name: [*map(_plain, values)] for name, values in self.vary.items()},
        }

    @property
    def _shape(self) -> tuple[int, ...]:
        return tuple(map(len, self.vary.values()))


def with_values(experiment: Experiment, values: Mapping[str, Value]) -> Experiment:
    """Return an experiment with other values of some fields, of its law or of its medium."""
    hints = typing.get_type_hints(type(experiment))
    known = [f.name for f in fields(experiment) if f.name not in _NOT_VARIED]
    changes, law = {}, {}
    for name, value in values.items():
        if name.startswith(LAW):
            law[name.removeprefix(LAW)] = value
        elif name in known:
            changes[name] = _converted(name, value, hints[name])
        elif name != DENSITY:
            raise UnknownNameError("field to vary", name, [*known, "law.NAME", DENSITY])
    changed = replace(experiment, **changes)
    if law:  # before the medium: the constants of its law do not depend on its density
        changed = replace(changed, law=_law_with(changed, law))
    if DENSITY in values:
        if changed.medium is None:
            raise InputError("no medium is given: name the medium whose density is varied")
        name = str(changed.medium).partition(" density=")[0]
        changed = replace(changed, medium=f"{name} density={_word(values[DENSITY])}")
    return changed


def column_of(name: str) -> str:
    """Return the heading of a field in tables."""
    return f"{name}_deg" if name in ANGLES else name


def value_in_table(name: str, value: Value) -> Value:
    """Return a field's value as in tables."""
    return degrees(value) if name in ANGLES and not isinstance(value, str) else value


def _law_with(experiment: Experiment, values: Mapping[str, Value]) -> str:
    """Return the law of an experiment in words, with other parameters."""
    text = experiment.law
    if text is None:
        if experiment.medium is None:
            raise InputError(
                f"no law is given: name the law whose parameter is law.{next(iter(values))}"
            )
        text = get_medium(experiment.medium).default_law
    kind, options = law_in(text)
    hints = typing.get_type_hints(kind)
    known = [f.name for f in fields(kind)]  # pyright: ignore[reportArgumentType]
    for name, value in values.items():
        check_name(f"parameter of the law {kind.name}", name, known)
        options[name] = _converted(f"law.{name}", value, hints[name])
    words = (f"{name}={_word(value)}" for name, value in options.items())
    return " ".join((kind.name, *words))


def _word(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else repr(value)


def _converted(name: str, value: Value, kind: Any) -> Any:
    kinds = typing.get_args(kind) if isinstance(kind, types.UnionType) else (kind,)
    if float not in kinds and int not in kinds:
        return value if isinstance(value, str) else f"{value:g}"
    if isinstance(value, str):
        raise InputError(f"{name} must be a number, got {shown(value)}")
    if float in kinds:
        return float(value)
    if value != int(value):
        raise InputError(f"{name} must be an integer, got {value}: give a list of integers")
    return int(value)


def _plain(value: Any) -> Value:
    return value.item() if isinstance(value, np.generic) else value


Row = dict[str, Any]
"""Result of one experiment: plain numbers and names."""

Custom = tuple[list[type[Law]], dict[str, Medium]]
"""Laws, which workers import from their modules, and media that are not part of the package."""


@dataclass(kw_only=True)
class StudyResult(Mapped):
    """Finished part of a study: a `pool.Mapped` of its rows."""

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

    def write_csv(self, path: Path) -> None:
        """Write a CSV file with a line for each row; cells that a row lacks are empty."""
        columns: dict[str, None] = {}
        for row in self.rows():
            columns |= dict.fromkeys(row)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns)
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
    asked = {**study.config(), "model, law or medium": digest(study)}
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

    It finds what is wrong with all, and compiles machine code once, before workers start.
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
    names = {text.partition(" density=")[0] for text in _values_of(study, "medium")}
    used = {name: get_medium(name) for name in sorted(names)}
    others = {name: one for name, one in used.items() if _SHIPPED.get(name) is not one}
    return list(_laws(study)), others


def _laws(study: Study) -> Iterator[type[Law]]:
    """Yield the laws that a study uses and that are not part of the package."""
    kinds = {law_in(text)[0].name: law_in(text)[0] for text in _values_of(study, "law")}
    for kind in kinds.values():
        package = kind.__module__.partition(".")[0]
        if package == "__main__":
            raise InputError(
                f"the law {kind.name!r} is defined in a script or notebook, where workers do not "
                "find it: put it into a module, a separate file"
            )
        if package != "mjgranular":
            yield kind


def _values_of(study: Study, name: str) -> list[str]:
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
