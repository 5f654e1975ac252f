"""Locks of this package, and work that an interrupt must not split.

A forked process has one thread: a lock held by another thread is never released there. So all locks
are taken before a fork, which waits for work in progress, and released after it on both sides.

Python raises `KeyboardInterrupt`, and whatever else a signal's handler raises, in the main thread,
between any two of its instructions. A compiler interrupted there is left in an inconsistent state.
So such work is done in another thread, which is not interrupted: only the waiting caller is, and it
delays the interrupt until nothing can be damaged.
"""

import _thread
import os
import sys
import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

T = TypeVar("T")

# Outer ones first: a thread that holds one takes none of those before it.
ENGINE = threading.RLock()
"""Lock of the plugins' functions."""
LOADER = threading.RLock()
"""Lock of the cached sands and of the table of blocks."""
PROGRAMS = threading.RLock()
"""Lock of compilation and of compiled programs."""

_PATIENCE = 0.1  # s: interval at which signals taken by another thread are noticed

_locked: list[Any] = []
_here = threading.local()


def _lock_all() -> None:
    # numba's own lock is not documented, but a child whose parent compiled a user's function
    # with numba in another thread would wait for it forever. Without numba nothing compiles.
    numba = getattr(sys.modules.get("numba.core.compiler_lock"), "global_compiler_lock", None)
    for lock in (ENGINE, LOADER, PROGRAMS, numba):
        if lock is not None:
            lock.acquire()
            _locked.append(lock)


def _unlock_all() -> None:
    while _locked:
        _locked.pop().release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_lock_all, after_in_parent=_unlock_all, after_in_child=_unlock_all)


class _Task(Generic[T]):
    """Work that runs once, and its result."""

    def __init__(self, work: Callable[[], T]) -> None:
        self._work = work
        self.claimed = threading.Lock()  # acquired by the thread that runs it, or that cancels it
        self.unfinished = threading.Lock()
        self.unfinished.acquire()
        self.finished = False
        self.unwanted = False
        self.value: T
        self.error: BaseException | None = None

    def run(self) -> None:
        if not self.claimed.acquire(blocking=False):
            return
        _here.task = self
        try:
            self.value = self._work()
        except BaseException as error:
            self.error = error
        finally:
            self.finished = True
            self.unfinished.release()


def run_in_worker(work: Callable[[], T]) -> T:
    """Run a function in a separate thread, and wait until it ends.

    What interrupts the waiting is raised once the work is done or has been canceled.
    """
    task, interrupt = _Task(work), None
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
    raised = interrupt or task.error
    if raised is not None:
        raise raised
    return task.value


def prepare_in_worker(work: Callable[[], T]) -> T:
    """Run a function as `run_in_worker` does, while MuJoCo waits in a callback.

    MuJoCo turns its errors into exceptions by a jump to a target stored per thread. While it waits
    in a callback, nothing on its thread may call it again through Python: the target would be
    overwritten, and the next error would jump to an invalid address.
    """

    def run() -> T:
        _here.preparing = True
        return work()

    return run_in_worker(run)


def is_preparing() -> bool:
    """Return True if this thread prepares sand: models and data it makes get none."""
    return getattr(_here, "preparing", False)


def uninterrupted(work: Callable[[], T]) -> T:
    """Run a function outside the main thread, where no interrupt can split it."""
    return run_in_worker(work) if is_main() else work()


def is_main() -> bool:
    """Return True if this is the main thread, the one that signals interrupt."""
    return threading.get_ident() == threading.main_thread().ident


def cancellation_point() -> None:
    """Cancel work whose result is no longer awaited; called where canceling is safe."""
    task = getattr(_here, "task", None)
    if task is not None and task.unwanted:
        raise KeyboardInterrupt
