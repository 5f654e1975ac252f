"""Where tasks run, and what passes between them and whoever hands them out."""

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
        count: how many tasks run at once; None for one a core. One on this machine is this process.
        chunk: how many tasks are handed out together; None for about a second's worth.
        address: of a Ray cluster: HOST:PORT of its head, or "auto" for the one that this machine
            belongs to. None for a Ray of one's own, on this machine.
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
        """These; a number is that of processes of this machine."""
        return given if isinstance(given, Workers) else cls(count=given)


Chunk = tuple[tuple[int, Any], ...]
"""Tasks with their numbers."""


class Answer(NamedTuple):
    """What became of one task.

    Attributes:
        number: of the task.
        result: what its function gave; None if that raised.
        error: why there is no result; None if there is one.
    """

    number: int
    result: Any
    error: str | None


class Done(NamedTuple):
    """A chunk that was worked through.

    Attributes:
        key: of the chunk.
        answers: one for each of its tasks.
        seconds: that it took.
    """

    key: int
    answers: list[Answer]
    seconds: float


class Lost(NamedTuple):
    """A chunk whose worker died.

    Attributes:
        key: of the chunk.
        reason: what is known of it.
        begun: whether it may have been at the chunk; not where it died before it could begin.
    """

    key: int
    reason: str
    begun: bool = True


class Pool(Protocol):
    """An engine with a function and what its tasks share, ready for chunks."""

    slots: int
    """Chunks that it takes at a time."""
    count: int
    """Chunks that it works on at a time."""

    def submit(self, key: int, chunk: Chunk) -> None:
        """Take a chunk; not more than `slots` at a time."""
        ...

    def wait(self) -> list[Done | Lost]:
        """Wait until something has become of a chunk, and say what.

        Raises:
            InputError: no worker can do anything, as where another version is installed there.
        """
        ...

    def close(self) -> None:
        """End all workers, whatever they do."""
        ...
