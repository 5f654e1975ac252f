"""Signals that end a program, as exceptions, so that cleanup runs as after Ctrl-C."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# Sent by a scheduler, a shell and a closed terminal; Windows does not have the last.
_ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


class Stopped(KeyboardInterrupt):
    """The process received a signal to end."""

    def __init__(self, number: int) -> None:
        self.number = int(number)
        super().__init__(signal.Signals(number).name)


def signal_of(stop: KeyboardInterrupt) -> int:
    """Return the number of the signal that an interruption comes from."""
    return stop.number if isinstance(stop, Stopped) else int(signal.SIGINT)


@contextmanager
def kept_signals(*numbers: int) -> Iterator[dict[int, Any]]:
    """Restore the handlers of signals at the end; return them by number.

    There are none outside the main thread, to which signals belong.
    """
    is_main = threading.current_thread() is threading.main_thread()
    before = {number: signal.getsignal(number) for number in numbers if is_main}
    try:
        yield before
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def stopped_by_signals() -> Iterator[None]:
    """Raise `Stopped` where SIGTERM or SIGHUP would end the process immediately.

    A signal that has another handler, or that is ignored (`nohup`), is not changed.
    """
    mine = [number for number in _ENDING if signal.getsignal(number) is signal.SIG_DFL]
    came: list[int] = []

    def stop(number: int, _frame: object) -> None:
        came.append(number)
        raise Stopped(number)

    with kept_signals(*mine) as kept:
        for number in kept:
            signal.signal(number, stop)
        try:
            yield
        except Exception as error:
            # C++ libraries turn an exception that a signal raised within them into their own error.
            if came:
                raise Stopped(came[-1]) from error
            raise
