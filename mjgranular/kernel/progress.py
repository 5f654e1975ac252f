"""Report that kernels are being compiled."""

from __future__ import annotations

import logging
import sys
from contextlib import suppress

_logger = logging.getLogger("mjgranular.kernel.compiled")

ONCE = "once on a machine, up to a minute"
ALWAYS = "in every process, as no folder for compiled kernels can be written (see NUMBA_CACHE_DIR)"

_reported = False


def report_compiling(how_often: str, what: str) -> None:
    """Report that kernels are compiled now: each program of a sand, and the rest once.

    The report goes to the log, which the command line shows. If the log is not shown, it is printed
    to a terminal.
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
