"""Chooses the command, and turns a user's mistake into one line and exit status 2."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Union

import tyro

from mjgranular._util.io import place
from mjgranular._util.signals import signal_of, stopped_by_signals
from mjgranular._version import __version__
from mjgranular.cli.console import show_compilation, show_error, show_warning
from mjgranular.cli.drop import DropCommand
from mjgranular.cli.elements import ElementsCommand
from mjgranular.cli.evaluate import EvaluateCommand
from mjgranular.cli.fit import FitCommand
from mjgranular.cli.impact import ImpactCommand
from mjgranular.cli.intrude import IntrudeCommand
from mjgranular.cli.lists import ListCommand
from mjgranular.cli.numbers import number_rules
from mjgranular.cli.options import in_options
from mjgranular.cli.render import RenderCommand
from mjgranular.cli.studio import StudioCommand
from mjgranular.cli.sweep import SweepCommand
from mjgranular.cli.train import TrainCommand
from mjgranular.cli.view import ViewCommand
from mjgranular.cli.warm import WarmCommand
from mjgranular.errors import GranularError, GranularWarning, UnknownNameError, one_line

PIPE_CLOSED = 141  # what a shell expects when the reader went away: 128 + SIGPIPE

COMMANDS: dict[str, Any] = {
    "impact": ImpactCommand,
    "sweep": SweepCommand,
    "drop": DropCommand,
    "view": ViewCommand,
    "intrude": IntrudeCommand,
    "fit": FitCommand,
    "elements": ElementsCommand,
    "train": TrainCommand,
    "evaluate": EvaluateCommand,
    "render": RenderCommand,
    "warm": WarmCommand,
    "studio": StudioCommand,
    "list": ListCommand,
}
_Command: Any = Union[  # noqa: UP007 - of a list
    tuple(Annotated[kind, tyro.conf.subcommand(name)] for name, kind in COMMANDS.items())
]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Args:
        arguments: without the program's name; None for those of the process.

    Returns:
        Exit status: 0 done; 2 for a mistake in the arguments, reported in one sentence; 130 when
        interrupted, 143 when terminated, 141 when nobody reads the output any more.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        try:
            return _main(given)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # the reader of our output has gone: `mjgranular ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PIPE_CLOSED


def _main(given: Sequence[str]) -> int:
    """Runs what the arguments ask for."""
    if given in (["--version"], ["-V"]):
        print(f"mjgranular {__version__}")
        return 0
    if not all(_is_text(argument) for argument in given):
        show_error("an argument is not UTF-8: names and paths are to be, for MuJoCo too")
        return 2
    if given and not given[0].startswith("-") and given[0] not in COMMANDS:
        show_error(str(UnknownNameError("command", given[0], COMMANDS)))
        return 2
    twice = _given_twice(given)
    if twice is not None:  # the first would be dropped without a word
        show_error(f"{twice} is given twice: give it once, with all of its values behind it")
        return 2
    command = tyro.cli(
        _Command,
        prog="mjgranular",
        description="Sand for MuJoCo: drops, sweeps, films, policies. SI units; angles in degrees.",
        args=given,
        config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes),
        registry=number_rules(),
    )
    show_compilation()
    try:
        with warnings.catch_warnings(), stopped_by_signals():
            warnings.simplefilter("always", GranularWarning)
            warnings.showwarning = partial(show_warning, words=partial(in_options, command))
            return command.run()
    except GranularError as error:
        show_error(in_options(command, str(error)))
        return 2
    except KeyboardInterrupt as stop:
        show_error("interrupted")
        return 128 + signal_of(stop)
    except BrokenPipeError:
        raise
    except OSError as error:  # a path that is too long, a folder that may not be looked into
        if error.filename is None:
            raise
        show_error(one_line(f"{place(Path(os.fsdecode(error.filename)))}: {error.strerror}"))
        return 2
    except Exception as error:
        gym = sys.modules.get("gymnasium")
        if gym is None or not isinstance(error, gym.error.DependencyNotInstalled):
            raise
        show_error(one_line(str(error)))  # of an environment that draws itself
        return 2


def _given_twice(given: Sequence[str]) -> str | None:
    """The first option that is given a second time; None if none is."""
    seen = set()
    for argument in given:
        name = argument.partition("=")[0].replace("_", "-")
        if name.startswith("--") and name in seen:
            return name
        seen.add(name)
    return None


def _is_text(argument: str) -> bool:
    """Whether an argument of the process could be read."""
    try:
        argument.encode()
    except UnicodeEncodeError:
        return False
    return True
