"""Report that kernels are being compiled."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

_logger = logging.getLogger("mjgranular.kernel.compiled")

ONCE = "once on a machine, up to half a minute"
ALWAYS = "in every process, as no folder to keep them in can be written (see NUMBA_CACHE_DIR)"


def log(function: Callable[..., Any]) -> None:
    """Log that a kernel is compiled."""
    _logger.info("compiling %s", function.__qualname__)


class _Announcement:
    """Report that kernels are being compiled: each program of a sand, and the rest once.

    The report goes to a terminal. If the log is shown, as the command line does, nothing is
    printed.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._shown = False

    def show(self, how_often: str, what: str) -> None:
        """Report that kernels are compiled now.

        Args:
            how_often: how often this will happen, in words.
            what: sand they are for, in words; "" for what every sand needs.
        """
        if what:
            _logger.info("compiling for %s: %s", what, how_often, extra={"sand": what})
        with self._lock:
            new, self._shown = bool(what) or not self._shown, True
        if new and not (_logger.isEnabledFor(logging.INFO) and _logger.hasHandlers()):
            # A program without a console has no stderr, and a closed one cannot be queried.
            with suppress(AttributeError, OSError, ValueError):
                if sys.stderr.isatty():
                    kernels = f"for {what}" if what else "kernels"
                    print(f"mjgranular: compiling {kernels}: {how_often}", file=sys.stderr)


announcement = _Announcement()
