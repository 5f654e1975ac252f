"""Work that an interrupt must not split: done in a separate thread while the caller waits.

Python raises `KeyboardInterrupt`, and whatever else a signal's handler raises, in the main thread,
between any two of its instructions. A compiler interrupted there is left in an inconsistent state,
and later calls fail in other ways. Other threads are not interrupted: only the waiting caller is,
and it delays the interrupt until nothing can be damaged.
"""

from __future__ import annotations

import _thread
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

_PATIENCE = 0.1  # s: interval at which signals taken by another thread are noticed

_here = threading.local()


class _Work(Generic[T]):
    """A task that runs once, and its result."""

    def __init__(self, work: Callable[[], T]) -> None:
        self._work = work
        self.claimed = threading.Lock()
        """Acquired by the thread that runs the task, or that cancels it."""
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
    """Run a function in a separate thread, and wait until it ends.

    Args:
        work: the function.

    Raises:
        BaseException: what interrupted the waiting, once the work is done or has been cancelled;
            else what the work raised.
    """
    task = _Work(work)
    interrupt = None
    try:
        # Not of class Thread: its start cannot be interrupted safely either.
        _thread.start_new_thread(task.run, ())
    except BaseException as error:
        if task.claimed.acquire(blocking=False):  # it has not started, and never will
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
    """Run a function outside the main thread, where no interrupt can split it."""
    return run_in_worker(work) if is_main() else work()


def is_main() -> bool:
    """Return True if this is the main thread, the one that signals interrupt."""
    return threading.get_ident() == threading.main_thread().ident


def cancellation_point() -> None:
    """Cancel work whose result is no longer awaited; called where cancelling is safe.

    Raises:
        KeyboardInterrupt: the caller that waited was interrupted.
    """
    work = getattr(_here, "work", None)
    if work is not None and work.unwanted:
        raise KeyboardInterrupt
