"""Errors of compilation that are short, and reports of compilation."""

import logging
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Self

from mjgranular.errors import GranularError


class KernelError(GranularError, TypeError):
    """A kernel cannot be compiled, most likely one of a custom law or surface.

    numba's long message is its cause.
    """

    @classmethod
    def of(cls, error: BaseException, what: str) -> Self:
        """Return the short one of an error of numba; `what` was to be compiled."""
        lines = [_COLORS.sub("", line).strip() for line in str(error).splitlines()]
        reason = next((line for line in lines if line and not line.startswith(_NO_REASON)), "")
        place = next(filter(None, map(_PLACE.search, lines)), None)
        where = f", in {place[1]}, line {place[2]}" if place else ""
        if isinstance(error, KeyError):  # numba names the attribute and nothing else
            reason = f"no record that they read has a field {reason}"
        return cls(
            f"numba cannot compile the kernels{what and ' for '}{what}: "
            f"{type(error).__name__}: {reason}{where}"
        )


_COLORS = re.compile(r"\x1b\[[0-9;]*m")  # of a terminal
_NO_REASON = "Failed in nopython mode pipeline"
_PLACE = re.compile(r'File "([^"]+)", line (\d+)')


@contextmanager
def compiling(what: str = "") -> Iterator[None]:
    """Turn errors of numba into a short one that says what failed and where."""
    try:
        yield
    except (GranularError, MemoryError):
        raise
    except Exception as error:
        raise KernelError.of(error, what) from error


ONCE = "once on a machine, up to a minute"
ALWAYS = "in every process, as no folder for compiled kernels can be written (see NUMBA_CACHE_DIR)"

_logger = logging.getLogger("mjgranular.kernel.compiled")
_reported = False


def report_compiling(how_often: str, what: str) -> None:
    """Report that kernels are compiled now: each program of a sand, and the rest once.

    The report goes to the log, which the command line shows; else it is printed to a terminal.
    """
    global _reported
    if what:
        _logger.info("compiling for %s: %s", what, how_often, extra={"sand": what})
    new, _reported = bool(what) or not _reported, True
    if new and not (_logger.isEnabledFor(logging.INFO) and _logger.hasHandlers()):
        # A program without a console has no stderr, and a closed one cannot be queried.
        with suppress(AttributeError, OSError, ValueError):
            if sys.stderr.isatty():
                kernels = f"for {what}" if what else "kernels"
                print(f"mjgranular: compiling {kernels}: {how_often}", file=sys.stderr)
