"""Execution of one chunk, in this process, another, or on another machine."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

from mjgranular.errors import GranularError, GranularWarning, one_line
from mjgranular.pool.workers import Answer, Chunk

Function = Callable[[Any, Any], Any]
"""Takes the shared data and one task, and returns a result; workers import it by its name."""

_LONGEST = 500  # characters of an error's message; chosen


def run_chunk(function: Function, shared: Any, chunk: Chunk) -> tuple[list[Answer], float]:
    """Return the answers to all tasks and the time [s]. A task that raises affects no other."""
    begin = time.perf_counter()
    answers = [_answer(function, shared, index, task) for index, task in chunk]
    return answers, time.perf_counter() - begin


def _answer(function: Function, shared: Any, index: int, task: Any) -> Answer:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GranularWarning)  # there may be one per task
            return Answer(index, function(shared, task), None)
    except GranularError as error:
        return Answer(index, None, str(error))
    except Exception as error:  # any code, such as a custom law
        return Answer(index, None, one_line(f"{type(error).__name__}: {error}")[:_LONGEST])
