"""Work that an interrupt must not cut in two: done in a thread of its own, and waited for.

Python raises `KeyboardInterrupt`, and whatever else a signal's handler raises, in the main thread,
between any two of its instructions. A compiler that is left there is half made, and what is tried
next fails in other ways. Threads of their own are not interrupted: who waits for one is, and keeps
the interrupt until there is nothing left to harm.
"""

from __future__ import annotations

import _thread
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

_PATIENCE = 0.1  # s: a signal that another thread took is looked at after it

_here = threading.local()


class _Work(Generic[T]):
    """Something to do, once, and what became of it."""

    def __init__(self, work: Callable[[], T]) -> None:
        self._work = work
        self.claimed = threading.Lock()
        """Taken by who sees to it that the work is done, or that it never is."""
        self.unfinished = threading.Lock()
        """Held until the work is done."""
        self.unfinished.acquire()
        self.finished = False
        self.unwanted = False
        self.value: T
        self.error: BaseException | None = None

    def run(self) -> None:
        if not self.claimed.acquire(blocking=False):
            return
        _here.work = self
        try:
            self.value = self._work()
        except BaseException as error:
            self.error = error
        finally:
            self.finished = True
            self.unfinished.release()


def run_in_worker(work: Callable[[], T]) -> T:
    """Does something in a thread of its own, and waits for it, whatever happens.

    Args:
        work: what to do.

    Raises:
        BaseException: what interrupted the waiting, once the work is done or has given way; else
            what the work raised.
    """
    task = _Work(work)
    interrupt = None
    try:
        # Not of class Thread: what it does to begin one cannot be interrupted safely either.
        _thread.start_new_thread(task.run, ())
    except BaseException as error:
        if task.claimed.acquire(blocking=False):  # it has not begun, and never will
            raise
        interrupt = error
        task.unwanted = True
    while True:
        try:
            while not task.finished:
                task.unfinished.acquire(timeout=_PATIENCE)
            break
        except BaseException as error:
            interrupt = error
            task.unwanted = True
    if interrupt is not None:
        raise interrupt
    if task.error is not None:
        raise task.error
    return task.value


def uninterrupted(work: Callable[[], T]) -> T:
    """Does something where no interrupt can cut it in two: not in the main thread."""
    return run_in_worker(work) if is_main() else work()


def is_main() -> bool:
    """Tells whether this is the main thread, the one that signals interrupt."""
    return threading.get_ident() == threading.main_thread().ident


def cancellation_point() -> None:
    """Ends work whose result nobody waits for any more: called where ending it harms nothing.

    Raises:
        KeyboardInterrupt: who waited was interrupted.
    """
    work = getattr(_here, "work", None)
    if work is not None and work.unwanted:
        raise KeyboardInterrupt
