"""What `mjgranular sweep --vary` and `--of` say: fields with their values, and an experiment."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Annotated, Any, Union

import numpy as np
import tyro

from mjgranular._util.parse import split_words
from mjgranular.cli.drop import DropCommand
from mjgranular.cli.impact import ImpactCommand
from mjgranular.cli.intrude import IntrudeCommand
from mjgranular.cli.numbers import number_rules, whole_number
from mjgranular.cli.options import given_options, law_named, option, record_of
from mjgranular.errors import InputError, UnknownNameError, shown
from mjgranular.experiment import Between, Drop
from mjgranular.experiment.chain_impact import chain_length
from mjgranular.experiment.study import ANGLES, Experiment, Value

_COMMANDS: dict[str, Any] = {
    "impact": ImpactCommand,
    "drop": DropCommand,
    "intrude": IntrudeCommand,
}
_Command: Any = Union[  # noqa: UP007 - of a list
    tuple(Annotated[kind, tyro.conf.subcommand(name)] for name, kind in _COMMANDS.items())
]
_OUTPUTS = ("out", "video", "camera", "overwrite", "json")
_MOST = 10**6  # values of one field; chosen


def read_vary(words: Sequence[str]) -> dict[str, Sequence[Value] | Between]:
    """Fields and their values from `speed=1:10:19 angle=30,45 law.eta_v=18:26`.

    `FIRST:LAST:COUNT` is evenly spaced, both ends included; `LOW:HIGH` a range to draw from.

    Raises:
        InputError: not of this form; says what would be.
    """
    found: dict[str, Sequence[Value] | Between] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not (equals and name and text):
            raise InputError(
                "what is varied is NAME=FIRST:LAST:COUNT, NAME=VALUE,VALUE,... or, for a sample, "
                f"NAME=LOW:HIGH, not {shown(word)}"
            )
        if name in found:
            raise InputError(f"{name} is varied twice")
        found[name] = _values(name, text)
    return found


def _values(name: str, text: str) -> Sequence[Value] | Between:
    scale = math.radians(1) if name in ANGLES else 1.0
    parts = text.split(":")
    numbers = [_number(part) for part in parts[:2]]
    if len(parts) == 1 or name == "law" or None in numbers:  # my_laws:Mud is a name
        return [_value(name, part.strip()) for part in text.split(",")]
    low, high = (scale * (number or 0.0) for number in numbers)
    if len(parts) == 2:
        return Between(low, high)
    if len(parts) > 3:
        raise InputError(f"{name} varies from FIRST:LAST:COUNT, not {shown(text)}")
    try:
        count = whole_number(parts[2])
    except ValueError as error:
        raise InputError(f"{name}={text}: {error}") from None
    if not 2 <= count <= _MOST:
        raise InputError(f"{name}={text}: from 2 to {_MOST} values, not {count}")
    Between(min(low, high), max(low, high))  # which refuses ends that are none, and equal ones
    return np.linspace(low, high, count).tolist()


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _value(name: str, text: str) -> Value:
    if not text:
        raise InputError(f"{name} has an empty value: write NAME=VALUE,VALUE,...")
    if name == "law":
        return str(law_named(text))
    number = _number(text)
    if number is None:
        return text
    return math.radians(number) if name in ANGLES else number


def refuse_fixed(command: object, varied: Iterable[str]) -> None:
    """Refuses an option that fixes what is varied.

    Args:
        command: with the options.
        varied: names of what is varied.

    Raises:
        InputError: names the option.
    """
    for name in given_options(command, *varied):
        raise InputError(
            f"{name} is varied, and {option(name)} {shown(getattr(command, name))} fixes it: leave "
            "one of the two away"
        )


def read_experiment(text: str, varied: Iterable[str] = ()) -> Experiment:
    """The experiment of a command in one text, such as "drop block.xml --slope 15".

    Args:
        text: the command.
        varied: names of what is varied.

    Raises:
        UnknownNameError: no command of an experiment.
        InputError: options of output within it or of what is varied, or a body that is a chain.
    """
    words = split_words(text)
    if not words or words[0] not in _COMMANDS:
        raise UnknownNameError("experiment to sweep", (words or [""])[0], _COMMANDS)
    command = tyro.cli(
        _Command,
        prog="mjgranular sweep --of",
        args=words,
        config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes),
        registry=number_rules(),
    )
    for name in given_options(command, *_OUTPUTS):
        raise InputError(f"--{name} is of the sweep and not of each of its runs: not within --of")
    refuse_fixed(command, varied)
    if isinstance(command, DropCommand):
        return record_of(Drop, command)
    if isinstance(command, IntrudeCommand):
        return command.intrusion()
    if chain_length(command.body) is not None:
        raise InputError("a chain cannot be swept over: write it as a model, for --of drop")
    return command.impact(
        speed=command.speed, angle_deg=command.angle, until=command.until, body=command.body
    )
