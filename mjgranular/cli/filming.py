"""Films of results, as commands write them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from mjgranular._util.result_folder import ResultFolder
from mjgranular.cli.console import err, progress_bar

if TYPE_CHECKING:
    from mjgranular.picture.video import Film


_TRIED = 5  # pictures after which it is said how long all of them take
_LONG = 3.0  # worth saying [s]


class Estimate:
    """Says how long a film will take, from the time that its first pictures took.

    Args:
        film: what is filmed.
        show: a progress bar that ends at 1.
    """

    def __init__(self, film: Film, show: Callable[[float], None]) -> None:
        self._film, self._show = film, show
        self._begin: tuple[int, float] | None = None
        self._said = False

    def __call__(self, done: int, count: int) -> None:
        """Takes the number of pictures that are done, and that of all."""
        self._show(done / count)
        if self._begin is None:
            self._begin = done, time.perf_counter()
        elif not self._said and done - self._begin[0] >= _TRIED:
            first, start = self._begin
            left = (time.perf_counter() - start) / (done - first) * (count - done)
            if left >= _LONG:
                size = f"{self._film.width} x {self._film.height}"
                err.print(
                    f"filming {count} pictures of {size}: about {left:.0f} s",
                    style="dim",
                    highlight=False,
                )
            self._said = True


def write_film(
    folder: ResultFolder,
    name: str,
    film: Film,
    pictures: Callable[[], tuple[int, Iterator[Any]]],
) -> None:
    """Write a film with a progress bar."""
    from mjgranular.picture.video import write_video

    with progress_bar("filming", 1.0, remaining=True) as show:
        estimate = Estimate(film, show)
        folder.write(name, lambda path: write_video(path, film, *pictures(), progress=estimate))
