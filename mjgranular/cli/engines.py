"""Options that commands of many independent runs share: where these run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from mjgranular.errors import OutputError
from mjgranular.pool import UNFINISHED, Journal, Workers


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
    def on(self) -> Workers:
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
