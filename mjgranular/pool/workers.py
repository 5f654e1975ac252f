"""Where tasks run, and what passes between the workers and their caller."""

from __future__ import annotations

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

_LONGEST = 500  # characters of an error's message; chosen


@dataclass(frozen=True)
class Workers:
    """Where tasks run.

    Attributes:
        engine: "local", processes of this machine, or "ray".
        count: number of tasks that run at once; None for one per core. A single local one is this
            process.
        address: address of a Ray cluster: HOST:PORT of its head, or "auto" for the one that this
            machine belongs to. None to start Ray on this machine.
    """

    engine: Engine = "local"
    count: int | None = None
    address: str | None = None

    def __post_init__(self) -> None:
        if self.engine not in get_args(Engine):
            raise UnknownNameError("engine", self.engine, get_args(Engine))
        if self.count is not None and self.count < 1:
            raise InputError(f"a run needs at least 1 worker, got {self.count}")
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
    """Outcome of one task: the result of the function, or why there is none."""

    result: Any
    error: str | None = None


class WorkerLostError(Exception):
    """A worker died with a task; says why, as far as it is known."""


class Pool(Protocol):
    """An engine with a function and the shared data of its tasks, ready for tasks."""

    slots: int
    """Number of tasks that it accepts at a time."""

    def submit(self, task: Any) -> Future:
        """Submit a task; at most `slots` at a time."""
        ...

    def result(self, future: Future) -> Answer:
        """Return the outcome of a task whose future is done; raise if no worker could do it."""
        ...

    def close(self) -> None:
        """End all workers, even busy ones."""
        ...


def run_task(function: Function, shared: Any, task: Any) -> Answer:
    """Run a task in this process. A task that raises affects no other."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GranularWarning)  # there may be one per task
            return Answer(function(shared, task))
    except GranularError as error:
        return Answer(None, str(error))
    except (Exception, SystemExit) as error:  # any code, such as a custom law
        return Answer(None, one_line(f"{type(error).__name__}: {error}")[:_LONGEST])
