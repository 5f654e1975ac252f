"""Work that must not be done on the thread that MuJoCo waits on."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from mjgranular.kernel.worker import run_in_worker

T = TypeVar("T")

_here = threading.local()


def is_preparing() -> bool:
    """Tells whether this thread prepares sand: what it makes on the way gets none."""
    return getattr(_here, "preparing", False)


def prepare_in_worker(work: Callable[[], T]) -> T:
    """Does something in a thread of its own, and waits for it, whatever happens (`run_in_worker`).

    MuJoCo turns its errors into exceptions by a jump to a place that it keeps one of per thread.
    While it waits in a callback of ours, nothing on its thread may call it again through Python:
    the place would be overwritten, and the next error would jump into nowhere.
    """

    def run() -> T:
        _here.preparing = True
        return work()

    return run_in_worker(run)
