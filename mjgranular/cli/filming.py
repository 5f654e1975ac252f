"""Films of results, as commands write them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from mjgranular.cli.console import progress_bar
from mjgranular.errors import GranularError, MissingExtraError
from mjgranular.experiment.folder import ResultFolder

if TYPE_CHECKING:
    from mjgranular.picture.video import Film


def write_film(
    folder: ResultFolder,
    name: str,
    film: Film,
    pictures: Callable[[], tuple[int, Iterator[Any]]],
) -> list[GranularError]:
    """Writes a film with a progress bar; returns what kept it from doing so."""
    from mjgranular.errors import RenderError
    from mjgranular.picture.video import write_video

    try:
        with progress_bar("filming", 1.0) as progress:
            folder.write(
                name,
                lambda path: write_video(
                    path, film, *pictures(), progress=lambda done, count: progress(done / count)
                ),
            )
    except (MissingExtraError, RenderError) as error:
        return [error]
    return []
