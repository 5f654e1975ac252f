"""The locks of this package, which a fork waits for.

A forked process has one thread: a lock held by another thread is never released there, and the
state that it protects is incomplete. So all locks are taken before a fork, which waits for work in
progress, and released after it on both sides.
"""

from __future__ import annotations

import os
import sys
import threading
from typing import Any

# Outer ones first: a thread that holds one takes none of those before it.
ENGINE = threading.RLock()
"""Lock of the plugins' functions."""
LOADER = threading.RLock()
"""Lock of the cached sands and of the table of blocks."""
PROGRAMS = threading.RLock()
"""Lock of compilation and of compiled programs."""
MEMORY = threading.RLock()
"""Lock of the memory that holds programs."""

_held: list[Any] = []


def _hold() -> None:
    # numba's own lock guards all compilation; if numba is not loaded, nothing compiles.
    numba = getattr(sys.modules.get("numba.core.compiler_lock"), "global_compiler_lock", None)
    for lock in (ENGINE, LOADER, PROGRAMS, numba, MEMORY):
        if lock is not None:
            lock.acquire()
            _held.append(lock)


def _release() -> None:
    while _held:
        _held.pop().release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_hold, after_in_parent=_release, after_in_child=_release)
