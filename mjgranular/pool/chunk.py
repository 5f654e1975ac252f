"""One chunk, where it is worked on: in this process, another, or on another machine."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

from mjgranular.errors import GranularError, GranularWarning, one_line
from mjgranular.pool.workers import Answer, Chunk

Function = Callable[[Any, Any], Any]
"""Is given what all tasks share and one task, and gives a result; found by its name elsewhere."""

_LONGEST = 500  # characters of what an error says of itself; chosen


def run_chunk(function: Function, shared: Any, chunk: Chunk) -> tuple[list[Answer], float]:
    """Answer to all tasks, and the seconds that it took. A task that raises spoils no other."""
    begin = time.perf_counter()
    answers = [_answer(function, shared, index, task) for index, task in chunk]
    return answers, time.perf_counter() - begin


def _answer(function: Function, shared: Any, index: int, task: Any) -> Answer:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GranularWarning)  # of as many as there are tasks
            return Answer(index, function(shared, task), None)
    except GranularError as error:
        return Answer(index, None, str(error))
    except Exception as error:  # anybody's code, such as a law of a user's own
        return Answer(index, None, one_line(f"{type(error).__name__}: {error}")[:_LONGEST])
