"""Runs a command; a user's mistake becomes one line and exit status 2."""

import os
import sys
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

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
from mjgranular.cli.options import in_options, parse_command
from mjgranular.cli.render import RenderCommand
from mjgranular.cli.sweep import SweepCommand
from mjgranular.cli.train import TrainCommand
from mjgranular.cli.view import ViewCommand
from mjgranular.errors import GranularError, GranularWarning, UnknownNameError, one_line

PIPE_CLOSED = 141  # 128 + SIGPIPE, as for any command whose reader has ended

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
    "list": ListCommand,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, by default with the arguments of the process.

    Return the exit status: 0 for success; 2 for a mistake in the arguments, reported in one
    sentence; 130 if interrupted, 143 if terminated, 141 if standard output is closed.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        try:
            return _main(given)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # as in `mjgranular ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PIPE_CLOSED


def _main(given: Sequence[str]) -> int:
    if given in (["--version"], ["-V"]):
        print(f"mjgranular {__version__}")
        return 0
    mistake = _find_mistake(given)
    if mistake is not None:
        show_error(mistake)
        return 2
    command = parse_command(
        COMMANDS,
        given,
        program="mjgranular",
        description="Sand for MuJoCo: drops, sweeps, films, policies. SI units; angles in degrees.",
    )
    show_compilation()
    try:
        with warnings.catch_warnings(), stopped_by_signals():
            warnings.simplefilter("always", GranularWarning)
            if not isinstance(command, TrainCommand):  # only a policy reads sensors
                warnings.filterwarnings("ignore", "MuJoCo's sensors", GranularWarning)
            warnings.showwarning = partial(show_warning, translate=partial(in_options, command))
            return command.run()
    except GranularError as error:
        show_error(in_options(command, str(error)))
    except KeyboardInterrupt as stop:
        show_error("interrupted")
        return 128 + signal_of(stop)
    except BrokenPipeError:
        raise
    except OSError as error:  # such as a path that is too long
        if error.filename is None:
            raise
        show_error(one_line(f"{place(Path(os.fsdecode(error.filename)))}: {error.strerror}"))
    except Exception as error:
        gym = sys.modules.get("gymnasium")
        if gym is None or not isinstance(error, gym.error.DependencyNotInstalled):
            raise
        show_error(one_line(str(error)))  # from an environment that renders itself
    return 2


def _find_mistake(given: Sequence[str]) -> str | None:
    """Find mistakes that the parser would not report, or not in one sentence."""
    for argument in given:
        try:
            argument.encode()
        except UnicodeEncodeError:
            return "an argument is not UTF-8: names and paths must be, for MuJoCo too"
    if given and not given[0].startswith("-") and given[0] not in COMMANDS:
        return str(UnknownNameError("command", given[0], COMMANDS))
    options = [argument.partition("=")[0].replace("_", "-") for argument in given]
    for number, name in enumerate(options):
        if name.startswith("--") and name in options[:number]:  # the first would be ignored
            return f"{name} is given twice: give it once, with all of its values behind it"
    return None
