"""Options of commands that write a result, and the steps that such commands share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from mjgranular._util.result_folder import ResultFolder
from mjgranular.cli.console import out, progress_bar, show_error
from mjgranular.errors import (
    GranularError,
    InputError,
    MissingExtraError,
    RenderError,
)
from mjgranular.picture.video import Film, write_video

Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Frames = Callable[[], tuple[int, Iterator[Any]]]
"""Returns the number of frames of a film, and the frames."""


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Where results go."""

    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the results; nothing is written without it."""
    overwrite: Flag = False
    """Replace a result that the folder contains."""
    json: Flag = False
    """Print JSON instead of a table."""

    @contextmanager
    def claimed(
        self, *names: str, command: str = "", config: dict[str, Any] | None = None
    ) -> Iterator[ResultFolder | None]:
        """Claim the folder of `--out`; yield None without one.

        A command that was interrupted may go on there, if it has the same `config`.
        """
        if self.out is None:
            yield None
            return
        folder = ResultFolder(self.out, names)
        goes_on = None if config is None else partial(folder.lacks_figures, command, config)
        with folder.claimed(overwrite=self.overwrite, goes_on=goes_on):
            yield folder

    def finish(self, problems: Sequence[GranularError] = ()) -> int:
        """Print where the result is and what could not be drawn; return the exit status."""
        if self.out is not None and not self.json:
            out.print(f"written to {self.out}")
        for problem in problems:
            show_error(f"{problem} (the numbers are in {self.out})")
        return 2 if problems else 0


@dataclass(frozen=True, kw_only=True)
class FilmOptions(OutputOptions):
    """Where results go, and whether a film is one of them."""

    video: Flag = False
    """Write a film into the folder."""
    camera: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Camera of the film: side, close or corner of the link; one of a model's, or free."""

    def check_film(self) -> None:
        """Raise if options of a film are given and no film can be written."""
        if self.video and self.out is None:
            raise InputError("--video needs a folder to write to: add --out DIR")
        if self.camera is not None and not self.video:
            raise InputError("--camera is for a film: add --video")


@contextmanager
def collected(problems: list[GranularError]) -> Iterator[None]:
    """Append the error to a list if something cannot be drawn, and continue after the block."""
    try:
        yield
    except (MissingExtraError, RenderError) as error:
        problems.append(error)


def write_film(folder: ResultFolder, name: str, film: Film, frames: Frames) -> None:
    """Write a film with a progress bar."""
    with progress_bar("filming", 1.0, remaining=True) as show:

        def write(path: Path) -> None:
            write_video(path, film, *frames(), progress=lambda done, count: show(done / count))

        folder.write(name, write)
