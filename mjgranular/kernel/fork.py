"""The locks of this package, which a fork waits for.

A forked process has one thread: a lock that another one held is never released there, and what it
guarded is half made. So all of them are taken before a fork, which waits for work that is under
way, and released after it on both sides.
"""

from __future__ import annotations

import os
import sys
import threading
from typing import Any

# Outer ones first: who holds one takes none of those before it.
ENGINE = threading.RLock()
"""Of the plugins' functions."""
LOADER = threading.RLock()
"""Of the sands that are kept, and of whose block is where."""
PROGRAMS = threading.RLock()
"""Of compiling, and of what was compiled."""
MEMORY = threading.RLock()
"""Of the memory that programs lie in."""

_held: list[Any] = []


def _hold() -> None:
    # numba's own belongs to all that compiles; where numba is not loaded nothing does.
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
