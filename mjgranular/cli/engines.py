"""Options that commands of many independent runs share: where these run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mjgranular.cli.console import err, show_error
from mjgranular.errors import InputError, OutputError
from mjgranular.experiment.folder import ResultFolder
from mjgranular.pool import UNFINISHED, Journal, Mapped, Workers


@dataclass(frozen=True, kw_only=True)
class EngineOptions:
    """Where the runs are done, and whether they go on."""

    engine: Literal["local", "ray"] = "local"
    """Processes of this machine, or Ray: on this machine, or with --address on a cluster."""
    address: Annotated[str | None, tyro.conf.arg(metavar="auto|HOST:PORT")] = None
    """Head of a Ray cluster; auto for the one that this machine belongs to."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Number of processes. Default: one a core."""
    chunk: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Runs that a process is given at a time. Default: about a second's worth."""
    resume: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Go on with what the folder of --out holds, and refuse to begin anew."""

    @property
    def where(self) -> Workers:
        """Where the runs are done."""
        return Workers(self.engine, self.workers, self.chunk, self.address)


def check_resumed(journal: Journal, folder: object) -> None:
    """Refuses to go on where there is nothing to go on with.

    Raises:
        OutputError: says what there is instead.
    """
    fault = journal.fault()
    if fault is not None:
        raise OutputError(
            f"{folder} has nothing to go on with ({UNFINISHED}: {fault}): give the options that it "
            "was begun with, or begin anew without --resume"
        )


@contextmanager
def kept(
    journal: Journal, place: Path | None, names: Sequence[str], *, overwrite: bool, resume: bool
) -> Iterator[ResultFolder | None]:
    """Claims a folder for a result, and begins the journal of what is finished in it.

    Args:
        journal: of that folder.
        place: the folder; None for none.
        names: of all files that a result may have.
        overwrite: whether a result there is replaced.
        resume: whether there has to be an unfinished one.

    Raises:
        InputError: options that contradict each other.
        OutputError: the folder holds something else.
    """
    if resume and (place is None or overwrite):
        raise InputError("--resume goes on with the folder of --out, and overwrites nothing")
    try:
        if place is None:
            journal.begin()
            yield None
            return
        if resume:
            check_resumed(journal, place)
        folder = ResultFolder(place, (*names, UNFINISHED))
        with folder.claimed(overwrite=overwrite, goes_on=journal.goes_on):
            try:
                journal.begin()
                if journal.count:
                    err.print(f"{journal.count} parts are finished", style="dim")
                yield folder
            finally:
                journal.close()
                if not journal.count:
                    (place / UNFINISHED).unlink(missing_ok=True)
    finally:
        journal.close()


def tell_interrupted(found: Mapped, place: Path | None) -> int:
    """Says how far a run came that was broken off. Returns the exit status."""
    count = found.journal.count
    where = f", kept in {place}; the same command goes on" if place and count else ""
    show_error(f"interrupted: {count} of {len(found.journal)} parts are finished{where}")
    return 2 if found.stopped_by is None else 128 + found.stopped_by
