"""Output of the command line: results on standard output, all else on standard error."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol, TextIO

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from mjgranular._util.extras import require
from mjgranular.errors import GranularWarning, one_line


class _PlainConsole(Console):
    """Shows texts as they are: names in a model or file can be anybody's.

    Without this `[/]` in a name would be an error of rich's, and an escape sequence would reach the
    terminal.
    """

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, markup=False, emoji=False)

    def on_broken_pipe(self) -> None:
        """Leaves it to the command: rich would end the process with exit status 1."""
        raise BrokenPipeError

    def render_str(self, text: str, **options: Any) -> Text:
        lines = text.split("\n")
        return super().render_str("\n".join(map(one_line, lines)), **options)


out = _PlainConsole()
err = _PlainConsole(stderr=True)


def print_json(content: Any) -> None:
    """Writes one JSON value to standard output."""
    json.dump(content, sys.stdout, indent=2, allow_nan=False)
    sys.stdout.write("\n")


def table(
    title: str, headings: Sequence[str], rows: Iterable[Iterable[str]], *, words: int = 1
) -> Table:
    """Make a table for people.

    Args:
        title: stands above it.
        headings: of the columns.
        rows: a cell for each column.
        words: number of columns that hold words, to the left; the others hold numbers.
    """
    made = Table(title=title, title_justify="left")
    for number, heading in enumerate(headings):
        made.add_column(
            Text(heading), justify="left" if number < words else "right", no_wrap=number == 0
        )
    for row in rows:
        made.add_row(*row)
    return made


def show_error(message: str) -> None:
    """Says what was wrong."""
    err.print("error: ", end="", style="bold red", highlight=False)
    err.print(message, highlight=False, soft_wrap=True)


def show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
    *,
    words: Callable[[str], str] = str,
) -> None:
    """Takes the place of `warnings.showwarning`, with the words of the command line."""
    if issubclass(category, GranularWarning):
        err.print("warning: ", end="", style="bold yellow", highlight=False)
        err.print(words(str(message)), highlight=False, soft_wrap=True)


class _Announcement(logging.Handler):
    """Says what sand kernels are being compiled for; once, where they are for any."""

    said = False

    def emit(self, record: logging.LogRecord) -> None:
        if hasattr(record, "sand"):
            self.said = True
            err.print(record.getMessage(), style="dim", highlight=False)
        elif not self.said:
            self.said = True
            err.print("compiling the sand's kernels: once on a machine, some seconds", style="dim")


def show_compilation() -> None:
    """Lets the first compilation of a kernel be announced."""
    logger = logging.getLogger("mjgranular.kernel")
    logger.setLevel(logging.INFO)
    logger.propagate = False
    if not logger.handlers:
        logger.addHandler(_Announcement())


def show_warp_compilation() -> None:
    """Says in a line what MuJoCo Warp says in one for each of its modules."""
    wp = require("warp", extra="warp", purpose="Training in MuJoCo Warp")
    wp.config.log_level = wp.LOG_ERROR
    err.print("MuJoCo Warp compiles its kernels: once on a machine, some minutes", style="dim")


class _Show(Protocol):
    """Shows the amount of work done and, where it changes, what is being done."""

    def __call__(self, done: float, what: str | None = None) -> None: ...


@contextmanager
def progress_bar(what: str, total: float, *, remaining: bool = False) -> Iterator[_Show]:
    """A progress bar on standard error, where that is a terminal; gone when the work is done.

    Args:
        what: is being done.
        total: amount of work.
        remaining: whether to show the time that is left, too.

    Yields:
        A function to be called with the amount of work done.
    """
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        *((TextColumn("left"), TimeRemainingColumn()) if remaining else ()),
    )
    with Progress(*columns, console=err, transient=True) as progress:
        task = progress.add_task(one_line(what), total=total)

        def show(done: float, what: str | None = None) -> None:
            description = None if what is None else one_line(what)
            progress.update(task, completed=done, description=description)

        yield show
