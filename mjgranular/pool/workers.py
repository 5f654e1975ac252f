"""Where tasks run, and what passes between the workers and their caller."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, get_args

from mjgranular.errors import (
    GranularError,
    GranularWarning,
    InputError,
    UnknownNameError,
    one_line,
)

Engine = Literal["local", "ray"]

Function = Callable[[Any, Any], Any]
"""Takes the shared data and one task, and returns a result; workers import it by its name."""

Chunk = tuple[tuple[int, Any], ...]
"""Tasks with their numbers."""

_LONGEST = 500  # characters of an error's message; chosen


@dataclass(frozen=True)
class Workers:
    """Where tasks run.

    Attributes:
        engine: "local", processes of this machine, or "ray".
        count: number of tasks that run at once; None for one per core. A single local one is this
            process.
        chunk: number of tasks per chunk; None for chunks of about a second.
        address: address of a Ray cluster: HOST:PORT of its head, or "auto" for the one that this
            machine belongs to. None to start Ray on this machine.
    """

    engine: Engine = "local"
    count: int | None = None
    chunk: int | None = None
    address: str | None = None

    def __post_init__(self) -> None:
        if self.engine not in get_args(Engine):
            raise UnknownNameError("engine", self.engine, get_args(Engine))
        if self.count is not None and self.count < 1:
            raise InputError(f"a run needs at least 1 worker, got {self.count}")
        if self.chunk is not None and self.chunk < 1:
            raise InputError(f"a chunk has at least 1 task, got {self.chunk}")
        if self.address is not None and self.engine != "ray":
            raise InputError(
                f"an address is that of a Ray cluster, and the engine is {self.engine}: say "
                "--engine ray too"
            )

    @classmethod
    def of(cls, given: Workers | int | None) -> Workers:
        """Return workers from a number of local processes, or unchanged."""
        return given if isinstance(given, Workers) else cls(count=given)


class Answer(NamedTuple):
    """Outcome of one task: its number, and the result of the function or why there is none."""

    number: int
    result: Any
    error: str | None


class Done(NamedTuple):
    """A finished chunk: an answer for each of its tasks, and the time that it took [s]."""

    answers: list[Answer]
    seconds: float


class WorkerLostError(Exception):
    """A worker died with a chunk.

    Args:
        reason: the known reason.
        begun: whether it may have begun the chunk; False if it died before.
    """

    def __init__(self, reason: str, *, begun: bool = True) -> None:
        super().__init__(reason)
        self.begun = begun


class Pool(Protocol):
    """An engine with a function and the shared data of its tasks, ready for chunks."""

    slots: int
    """Number of chunks that it accepts at a time."""
    count: int
    """Number of chunks that it processes at a time."""

    def submit(self, chunk: Chunk) -> Future:
        """Submit a chunk; at most `slots` at a time."""
        ...

    def result(self, future: Future) -> Done:
        """Return the outcome of a chunk whose future is done.

        Raises:
            WorkerLostError: its worker died.
            InputError: no worker can do the work, because of another installed version for example.
        """
        ...

    def close(self) -> None:
        """End all workers, even busy ones."""
        ...


def run_chunk(function: Function, shared: Any, chunk: Chunk) -> Done:
    """Run the tasks of a chunk in this process. A task that raises affects no other."""
    begin = time.perf_counter()
    answers = [_answer(function, shared, number, task) for number, task in chunk]
    return Done(answers, time.perf_counter() - begin)


def _answer(function: Function, shared: Any, number: int, task: Any) -> Answer:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GranularWarning)  # there may be one per task
            return Answer(number, function(shared, task), None)
    except GranularError as error:
        return Answer(number, None, str(error))
    except (Exception, SystemExit) as error:  # any code, such as a custom law
        return Answer(number, None, one_line(f"{type(error).__name__}: {error}")[:_LONGEST])
