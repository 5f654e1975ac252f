"""What a search over settings goes through: values and ranges, and the points that are tried."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjgranular.errors import InputError, UnknownNameError, shown
from mjgranular.extras import need
from mjgranular.learn.evaluate import split_values
from mjgranular.learn.settings import (
    Settings,
    setting_names,
    takes_whole_numbers,
    toml_value,
)

_MOST = 10_000  # trials of a search; chosen: each is a training
_DIGITS = 6  # of a drawn value: files and tables stay readable. Chosen
_LINEAR = "linear_"
_FORMS = (
    "NAME=VALUE,VALUE,... or NAME=FIRST:LAST:COUNT or, with --trials, NAME=LOW:HIGH, each range "
    "with :log behind it for factors in place of steps"
)
# What no policy becomes better of, and what would make returns of another thing of them.
_NOT_SEARCHED = {
    "total_steps": "is the budget of each trial, the same for all: give --total-steps",
    "processes": "changes where environments are stepped, and not what is learned",
    "checkpoint_every": "is how often a trial is kept: give --set checkpoint_every=...",
    "algorithm": "is the same for all: search twice, each with its --algorithm",
    "seed": "is the same for all, lest the luckiest be the best: train the best with others",
}

Point = dict[str, Any]
"""A value for each setting that is searched over."""


@dataclass(frozen=True)
class Range:
    """A range that values are drawn from.

    Attributes:
        low: its lower end.
        high: its upper end.
        log: whether factors are evenly spread, in place of differences.
        whole: whether values are whole numbers.
        falling: whether a value falls to zero in the training: "linear_3e-4".
    """

    low: float
    high: float
    log: bool = False
    whole: bool = False
    falling: bool = False

    def at(self, share: float) -> Any:
        """The value at a share, from 0 to 1, of the range."""
        if self.whole and not self.log:  # each as likely as the others
            return int(min(self.low + math.floor(share * (self.high - self.low + 1)), self.high))
        if self.log:
            value = self.low * (self.high / self.low) ** share
        else:
            value = self.low + share * (self.high - self.low)
        if self.whole:
            return round(value)
        return _written(value, self.falling)


Space = Mapping[str, Range | tuple[Any, ...]]
"""A range or values for each setting that is searched over."""


def read_space(words: Sequence[str], settings: Settings) -> Space:
    """Settings with their values or ranges, from `gamma=0.95,0.99 learning_rate=1e-4:1e-2:log`.

    Args:
        words: one for each setting.
        settings: that are changed by them.

    Raises:
        UnknownNameError: no such setting; lists those there are.
        InputError: not of this form, or a setting that is not searched over.
    """
    if not words:
        raise InputError(f"--search needs what is searched over: {_FORMS}")
    found: dict[str, Range | tuple[Any, ...]] = {}
    for word in words:
        name, equals, text = word.partition("=")
        name = name.strip()
        if not (name and equals and text.strip()):
            raise InputError(f"what is searched over is {_FORMS}, not {shown(word)}")
        if name in found:
            raise InputError(f"{name} is searched over twice")
        _check_name(name, settings.algorithm)
        found[name] = _values(name, text, takes_whole_numbers(settings.algorithm, name))
    return found


def points_of(space: Space, trials: int | None, seed: int) -> list[Point]:
    """What is tried: a grid, every value with every other; or as many points as there are trials.

    Args:
        space: values and ranges.
        trials: how many points are drawn, a Latin hypercube by SciPy; None for a grid.
        seed: of what is drawn.

    Raises:
        InputError: a range in a grid, or too many points.
        MissingExtraError: points are drawn, and SciPy is not installed.
    """
    if trials is None:
        for name, values in space.items():
            if isinstance(values, Range):
                raise InputError(
                    f"{name} has a range, and a grid needs values: say how many, "
                    f"{name}=LOW:HIGH:COUNT, or draw so many points with --trials N"
                )
        count = math.prod(len(values) for values in space.values())  # pyright: ignore[reportArgumentType]
        _check_count(count, "a grid")
        each: list[Any] = list(space.values())
        return [dict(zip(space, point, strict=True)) for point in itertools.product(*each)]
    _check_count(trials, "a search")
    qmc = need("scipy.stats.qmc", extra="train", purpose="Drawing settings to try")
    drawn = qmc.LatinHypercube(len(space), seed=np.random.default_rng(seed)).random(trials)
    return [
        {name: _at(values, share) for (name, values), share in zip(space.items(), row, strict=True)}
        for row in drawn.tolist()
    ]


def at_ends(space: Space, point: Point) -> list[str]:
    """Names of what is at an end of its numbers in a point: the best may lie beyond."""
    found = []
    for name, values in space.items():
        ends = (values.at(0.0), values.at(1.0)) if isinstance(values, Range) else values
        sizes = [_size(value) for value in ends]
        here = _size(point[name])
        known = [size for size in sizes if size is not None]
        if len(known) < len(sizes) or here is None:
            continue  # switches and names have no ends
        if not isinstance(values, Range) and len(known) < 3:
            continue  # of two values each is an end
        margin = 0.02 * (max(known) - min(known)) if isinstance(values, Range) else 0.0
        if here <= min(known) + margin or here >= max(known) - margin:
            found.append(name)
    return found


def _check_count(count: int, what: str) -> None:
    if count < 2:
        raise InputError(f"a search tries at least 2 points, not {count}")
    if count > _MOST:
        raise InputError(f"{what} of {count} trainings: {_MOST} are the most")


def _check_name(name: str, algorithm: str) -> None:
    if name in _NOT_SEARCHED:
        raise InputError(f"{name} is not searched over: it {_NOT_SEARCHED[name]}")
    if name.startswith("environment."):
        raise InputError(
            f"{name} is not searched over: returns in different environments tell nothing of the "
            "settings; give --set for all trials"
        )
    known = [one for one in setting_names(algorithm) if one not in _NOT_SEARCHED]
    key = name.removeprefix("policy.")
    if name not in known and not (key != name and key.isidentifier()):
        raise UnknownNameError(f"setting of {algorithm} to search over", name, known)


def _values(name: str, text: str, whole: bool) -> Range | tuple[Any, ...]:
    parts = [part.strip() for part in text.split(":")]
    log = parts[-1] == "log" and len(parts) > 1
    parts = parts[:-1] if log else parts
    falling = parts[0].startswith(_LINEAR)
    ends = [_number(part.removeprefix(_LINEAR) if falling else part) for part in parts[:2]]
    if len(parts) == 1 and not log:
        return _choices(name, text)
    if len(parts) not in (2, 3) or None in ends:
        raise InputError(f"what is searched over is {_FORMS}, not {shown(f'{name}={text}')}")
    low, high = (end or 0.0 for end in ends)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"the range of {name} goes from its lower to its upper end, not {text}")
    if log and low <= 0:
        raise InputError(f"{name}={text}: factors need a lower end above 0, not {low:g}")
    if whole and not (low.is_integer() and high.is_integer()):
        raise InputError(f"{name}={text}: {name} is a whole number, and so are the ends")
    if len(parts) == 2:
        return Range(low, high, log, whole, falling)
    if not parts[2].isdigit() or not 2 <= int(parts[2][:9]) <= _MOST:
        raise InputError(
            f"{name}={text}: a range has from 2 to {_MOST} values, not {shown(parts[2])}"
        )
    spaced = (np.geomspace if log else np.linspace)(low, high, int(parts[2])).tolist()
    if whole and not log and not all(value.is_integer() for value in spaced):
        raise InputError(f"{name}={text}: {name} is a whole number: give a list of such")
    values = [round(value) if whole else _written(value, falling) for value in spaced]
    return tuple(dict.fromkeys(values))


def _choices(name: str, text: str) -> tuple[Any, ...]:
    found = [toml_value(part) for part in split_values(text)]
    if text.strip().startswith(",") or text.strip().endswith(",") or ",," in text:
        raise InputError(f"{name} has an empty value: write {name}=VALUE,VALUE,...")
    for k, value in enumerate(found):
        if value in found[:k]:
            raise InputError(f"{name} has the value {shown(value)} twice")
    return tuple(found)


def _written(value: float, falling: bool) -> float | str:
    text = f"{value:.{_DIGITS}g}"
    return f"{_LINEAR}{text}" if falling else float(text)


def _at(values: Range | tuple[Any, ...], share: float) -> Any:
    if isinstance(values, Range):
        return values.at(share)
    return values[min(int(share * len(values)), len(values) - 1)]


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _size(value: Any) -> float | None:
    """The number that a value is, or falls from; None for what is none."""
    if isinstance(value, str):
        return _number(value.removeprefix(_LINEAR))
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None
