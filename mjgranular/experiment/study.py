"""An experiment with some of its fields varied, on a grid or drawn at random."""

import math
import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np

from mjgranular._util.checks import check_count, is_finite, kind_of
from mjgranular._util.extras import require
from mjgranular.errors import InputError, UnknownNameError, shown
from mjgranular.experiment.drop import Drop
from mjgranular.experiment.impact import Impact
from mjgranular.experiment.intrusion import Intrusion
from mjgranular.experiment.trajectory import degrees
from mjgranular.law import law_in
from mjgranular.medium import get_medium

Experiment = Impact | Drop | Intrusion
Value = float | int | str

ANGLES = ("angle", "slope", "uphill", "tilt", "direction")
"""Fields in radians, which are in degrees on the command line and in tables."""

LAW, DENSITY = "law.", "medium.density"
_MOST = 10**9  # tasks; chosen: a larger grid is a mistake
_CHECKED = 1000  # values of a field that are checked beforehand; of more, both ends
_NOT_VARIED = ("model", "bodies", "geoms", "groups", "instead_of", "keep_floor")


@dataclass(frozen=True)
class Between:
    """A range that values are drawn from.

    Attributes:
        low: its lower end.
        high: its upper end.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        low, high = self.low, self.high
        if not (is_finite(low) and is_finite(high) and low < high):
            raise InputError(
                "a range goes from its lower to its upper end, both finite, got "
                f"{shown(low)} to {shown(high)}"
            )


@dataclass(frozen=True)
class Study:
    """An experiment with some of its fields varied.

    Without `sample` it is a grid: every value of a field with every value of the others, the last
    field fastest. With it, points are drawn, spread evenly over the ranges.

    Attributes:
        experiment: the common part: an `Impact`, a `Drop` or an `Intrusion`.
        vary: values of each varied field, or for a sample a range, `Between`. Fields of the
            experiment, in SI units and radians; `law.NAME` is a parameter of the law;
            `medium.density` is the bulk density of the sand [kg/m^3].
        sample: number of points of a Latin hypercube, by `scipy.stats.qmc`; None for a grid.
        seed: seed of the sample.

    Raises:
        InputError: nothing is varied, a value is invalid, or a grid has a range.
        UnknownNameError: no such field; lists the valid ones.
        MissingExtraError: a sample needs SciPy, which is not installed.
    """

    experiment: Experiment = field(default_factory=Impact)
    vary: Mapping[str, Sequence[Value] | Between] = field(default_factory=dict)
    sample: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.experiment, get_args(Experiment)):
            raise InputError(
                f"a study is of an Impact, a Drop or an Intrusion, got {kind_of(self.experiment)}"
            )
        if not isinstance(self.vary, Mapping):
            raise InputError(f"vary must be a table, {{'speed': [1, 2]}}, got {kind_of(self.vary)}")
        if not self.vary:
            raise InputError("a study varies something, such as speed=(1.0, 2.0)")
        if self.sample is not None:
            check_count("sample", self.sample)
        check_count("seed", self.seed, least=0)
        for name, values in self.vary.items():
            self._check_values(name, values)
        if len(self) > _MOST:
            raise InputError(f"a study has at most {_MOST} points, got {len(self)}")
        self._check_experiments()

    def __len__(self) -> int:
        """Return the number of experiments."""
        return math.prod(self._shape) if self.sample is None else self.sample

    def __getitem__(self, index: int) -> dict[str, Value]:
        """Return the values of one experiment, by the names of the fields."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        if self.sample is None:
            at = np.unravel_index(index, self._shape)
            return {
                name: _plain(values[int(k)])  # pyright: ignore[reportIndexIssue]
                for (name, values), k in zip(self.vary.items(), at, strict=True)
            }
        drawn = self._points[index].tolist()
        return {
            name: _drawn(values, share)
            for (name, values), share in zip(self.vary.items(), drawn, strict=True)
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
            "vary": {
                name: asdict(values) if isinstance(values, Between) else [*map(_plain, values)]
                for name, values in self.vary.items()
            },
            "sample": self.sample,
            "seed": None if self.sample is None else self.seed,
        }

    @property
    def _shape(self) -> tuple[int, ...]:
        return tuple(1 if isinstance(v, Between) else len(v) for v in self.vary.values())

    @cached_property
    def _points(self) -> np.ndarray:
        """Drawn points in the unit cube, shape (sample, fields)."""
        assert self.sample is not None
        qmc = require("scipy.stats.qmc", extra="sample", purpose="Drawing a sample")
        cube = qmc.LatinHypercube(len(self.vary), seed=np.random.default_rng(self.seed))
        return cube.random(self.sample)

    def _check_values(self, name: str, values: object) -> None:
        if isinstance(values, Between):
            if self.sample is None:
                raise InputError(
                    f"{name} has a range, and a grid needs values: say how many, as in "
                    f"{name}={values.low:g}:{values.high:g}:10, or draw a sample"
                )
            return
        if isinstance(values, str) or not isinstance(values, (Sequence, np.ndarray)):
            raise InputError(f"{name} needs a list of values, got {kind_of(values)}")
        if not len(values):
            raise InputError(f"{name} needs at least one value")
        for value in values:
            if not isinstance(value, str) and not is_finite(value):
                raise InputError(f"values of {name} are finite numbers or names, got {value!r}")

    def _check_experiments(self) -> None:
        """Make the experiments at each value of each field, the other fields at their first."""
        some = {name: _some(values) for name, values in self.vary.items()}
        first = {name: values[0] for name, values in some.items()}
        for name, values in some.items():
            for value in values:
                with_values(self.experiment, {**first, name: value})
        if self.sample is not None:
            _ = self._points


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
            raise InputError(
                "law and bodies determine the medium if it is not given: name the medium whose "
                "density is varied"
            )
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
                f"without law and medium the bodies determine the law: name the law whose "
                f"parameter is law.{next(iter(values))}"
            )
        text = get_medium(experiment.medium).default_law
    kind, options = law_in(text)
    hints = typing.get_type_hints(kind)
    known = [f.name for f in fields(kind)]  # pyright: ignore[reportArgumentType]
    for name, value in values.items():
        if name not in known:
            raise UnknownNameError(f"parameter of the law {kind.name}", name, known)
        options[name] = _converted(f"law.{name}", value, hints[name])
    words = (f"{name}={_word(value)}" for name, value in options.items())
    return " ".join((kind.name, *words))


def _word(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else repr(value)


def _converted(name: str, value: Value, kind: Any) -> Any:
    """Convert a value to the type of a field."""
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


def _drawn(values: Sequence[Value] | Between, share: float) -> Value:
    """Return the value at a share of a range or list, from 0 to 1."""
    if isinstance(values, Between):
        return values.low + share * (values.high - values.low)
    return _plain(values[min(int(share * len(values)), len(values) - 1)])


def _some(values: Sequence[Value] | Between) -> list[Value]:
    """Return values to check beforehand."""
    if isinstance(values, Between):
        return [values.low, values.high]
    few = values if len(values) <= _CHECKED else [values[0], values[-1]]
    return [_plain(value) for value in few]
