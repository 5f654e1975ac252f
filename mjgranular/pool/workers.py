"""Workers, and the messages between them and the caller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, get_args

from mjgranular.errors import InputError, UnknownNameError

Engine = Literal["local", "ray"]


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
            raise InputError(f"a run needs at least 1 worker, not {self.count}")
        if self.chunk is not None and self.chunk < 1:
            raise InputError(f"a chunk has at least 1 task, not {self.chunk}")
        if self.address is not None and self.engine != "ray":
            raise InputError(
                f"an address is that of a Ray cluster, and the engine is {self.engine}: say "
                "--engine ray too"
            )

    @classmethod
    def of(cls, given: Workers | int | None) -> Workers:
        """Return workers from a number of local processes, or unchanged."""
        return given if isinstance(given, Workers) else cls(count=given)


Chunk = tuple[tuple[int, Any], ...]
"""Tasks with their numbers."""


class Answer(NamedTuple):
    """Outcome of one task.

    Attributes:
        number: number of the task.
        result: return value of the function; None if it raised.
        error: reason for a missing result; None with a result.
    """

    number: int
    result: Any
    error: str | None


class Done(NamedTuple):
    """A finished chunk.

    Attributes:
        key: key of the chunk.
        answers: one for each of its tasks.
        seconds: time that it took.
    """

    key: int
    answers: list[Answer]
    seconds: float


class Lost(NamedTuple):
    """A chunk whose worker died.

    Attributes:
        key: key of the chunk.
        reason: the known reason.
        begun: whether it may have begun the chunk; False if it died before.
    """

    key: int
    reason: str
    begun: bool = True


class Pool(Protocol):
    """An engine with a function and the shared data of its tasks, ready for chunks."""

    slots: int
    """Number of chunks that it accepts at a time."""
    count: int
    """Number of chunks that it processes at a time."""

    def submit(self, key: int, chunk: Chunk) -> None:
        """Submit a chunk; at most `slots` at a time."""
        ...

    def wait(self) -> list[Done | Lost]:
        """Wait until chunks are done or lost, and return them.

        Raises:
            InputError: no worker can do the work, because of another installed version for example.
        """
        ...

    def close(self) -> None:
        """End all workers, even busy ones."""
        ...
