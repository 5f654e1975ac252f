"""Output of the command line: results on standard output, all else on standard error."""

import json
import logging
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from mjgranular.errors import GranularWarning, one_line


class _PlainConsole(Console):
    """Prints names as they are, without rich's markup: models and files may contain anything.

    Otherwise rich would fail on `[/]` in a name, and escape sequences would reach the terminal.
    """

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, markup=False, emoji=False, highlight=False)

    def on_broken_pipe(self) -> None:
        """Let the command decide: rich would end the process with exit status 1."""
        raise BrokenPipeError

    def render_str(self, text: str, **options: Any) -> Text:
        lines = text.split("\n")
        return super().render_str("\n".join(map(one_line, lines)), **options)


out = _PlainConsole()
err = _PlainConsole(stderr=True)
note = err.print  # remarks


def print_json(content: Any) -> None:
    """Write one JSON value to standard output; infinities and NaN, which JSON lacks, as strings."""
    json.dump(_with_words(content), sys.stdout, indent=2, allow_nan=False)
    sys.stdout.write("\n")


def print_result(content: Any, show: Callable[[], object], *, json: bool) -> None:
    """Print a result as JSON, or else by `show`."""
    if json:
        print_json(content)
    else:
        show()


def _with_words(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _with_words(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_with_words(each) for each in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def table(
    title: str,
    headings: Iterable[str],
    rows: Iterable[Iterable[str]],
    *,
    words: int = 1,
    fold: bool = False,
) -> Table:
    """Make a table with all columns but the first `words` at the right; `fold` long words."""
    made = Table(title=title, title_justify="left")
    overflow = "fold" if fold else "ellipsis"
    for number, heading in enumerate(headings):
        justify = "left" if number < words else "right"
        no_wrap = number >= words if fold else number == 0
        made.add_column(Text(heading), justify=justify, no_wrap=no_wrap, overflow=overflow)
    for row in rows:
        made.add_row(*row)
    return made


def show_error(message: str) -> None:
    """Print an error."""
    err.print("error: ", end="", style="bold red")
    err.print(message, soft_wrap=True)


def show_warning(
    message: Warning | str, category: type[Warning], *_: Any, translate: Callable[[str], str]
) -> None:
    """Print a warning of mjgranular; replaces `warnings.showwarning`."""
    if issubclass(category, GranularWarning):
        err.print("warning: ", end="", style="bold yellow")
        err.print(translate(str(message)), soft_wrap=True)


class _CompilationHandler(logging.Handler):
    """Prints what is compiled; kernels of no particular sand only once."""

    printed = False

    def emit(self, record: logging.LogRecord) -> None:
        if hasattr(record, "sand"):
            err.print(record.getMessage(), style="dim")
        elif not self.printed:
            err.print("compiling the sand's kernels: once per machine, some seconds", style="dim")
        self.printed = True


def show_compilation() -> None:
    """Print a line when kernels are compiled for the first time."""
    logger = logging.getLogger("mjgranular.kernel")
    logger.setLevel(logging.INFO)
    logger.propagate = False
    if not logger.handlers:
        logger.addHandler(_CompilationHandler())


@contextmanager
def progress_bar(
    what: str, total: float, *, remaining: bool = False
) -> Iterator[Callable[..., None]]:
    """Show a progress bar on standard error, if that is a terminal, until the work is done.

    Yield `show(done, what=None)`, to be called with the amount of work done and, if it changes, the
    description. `remaining` adds the remaining time.
    """
    if not err.is_terminal:  # rich would print an empty line
        yield lambda done, what=None: None
        return
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
