"""Work that must not be done on the thread that MuJoCo waits on."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from mjgranular.kernel.threads import run_in_worker

T = TypeVar("T")

_here = threading.local()


def is_preparing() -> bool:
    """Return True if this thread prepares sand: models and data it makes get none."""
    return getattr(_here, "preparing", False)


def prepare_in_worker(work: Callable[[], T]) -> T:
    """Run a function in a separate thread, and wait until it ends (`run_in_worker`).

    MuJoCo turns its errors into exceptions by a jump to a target stored per thread. While it waits
    in a callback, nothing on its thread may call it again through Python: the target would be
    overwritten, and the next error would jump to an invalid address.
    """

    def run() -> T:
        _here.preparing = True
        return work()

    return run_in_worker(run)
