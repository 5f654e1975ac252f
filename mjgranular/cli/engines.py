"""Options that commands of many independent runs share: where these run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from mjgranular._util.result_folder import ResultFolder
from mjgranular.cli.console import err, show_error
from mjgranular.cli.results import OutputOptions
from mjgranular.errors import InputError, OutputError
from mjgranular.pool import UNFINISHED, Journal, Workers


@dataclass(frozen=True, kw_only=True)
class EngineOptions(OutputOptions):
    """Where the runs are done, and whether they are resumed."""

    engine: Literal["local", "ray"] = "local"
    """Processes of this machine, or Ray: on this machine, or with --address on a cluster."""
    address: Annotated[str | None, tyro.conf.arg(metavar="auto|HOST:PORT")] = None
    """Head of a Ray cluster; auto for the one that this machine belongs to."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Number of processes. Default: one per core."""
    chunk: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Runs that a process is given at a time. Default: about a second's worth."""
    resume: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Resume what the folder of --out holds, and never start over."""

    @property
    def where(self) -> Workers:
        """Where the runs are done."""
        return Workers(self.engine, self.workers, self.chunk, self.address)

    def check_resume(self) -> None:
        """Raise if `--resume` contradicts other options."""
        if self.resume and (self.out is None or self.overwrite):
            raise InputError(
                "--resume continues in the folder of --out: add --out DIR, omit --overwrite"
            )

    @contextmanager
    def resumable(self, journal: Journal, *names: str) -> Iterator[ResultFolder | None]:
        """Claim the folder of `--out`, and open the journal of what is finished in it.

        Args:
            journal: of that folder.
            names: of all files that a result may have.

        Raises:
            OutputError: the folder holds something else, or nothing to resume.
        """
        try:
            if self.out is None:
                journal.begin()
                yield None
                return
            fault = journal.fault() if self.resume else None
            if fault is not None:
                raise OutputError(
                    f"{self.out} has nothing to resume ({UNFINISHED}: {fault}): give the "
                    "options that it was started with, or start over without --resume"
                )
            claim = ResultFolder(self.out, (*names, UNFINISHED))
            with claim.claimed(overwrite=self.overwrite, goes_on=journal.goes_on) as folder:
                try:
                    journal.begin()
                    if journal.count:
                        err.print(f"{journal.count} of {len(journal)} are finished", style="dim")
                    yield folder
                finally:
                    journal.close()
                    if not journal.count:
                        (self.out / UNFINISHED).unlink(missing_ok=True)
        finally:
            journal.close()

    def show_interrupted(self, journal: Journal, stopped_by: int | None) -> int:
        """Say how far an interrupted run came; return the exit status."""
        kept = f", kept in {self.out}; the same command resumes it" if self.out else ""
        where = kept if journal.count else ""
        show_error(f"interrupted: {journal.count} of {len(journal)} are finished{where}")
        return 2 if stopped_by is None else 128 + stopped_by
