"""The folder of a result: claimed before the work, written at its end, nothing lost.

And the versions that a result depends on.
"""

import json
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Self

from mjgranular._util import files
from mjgranular._util.io import read_json
from mjgranular._version import __version__
from mjgranular.errors import OutputError

CONFIG = "config.json"
SUMMARY = "summary.json"
UNFINISHED = "unfinished"  # empty file beside numbers whose figures are not drawn yet
TRAINING = "train"  # command that `config.json` of a training run names


class ResultFolder:
    """A folder for the files of one result."""

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self.path = path
        self._names = tuple(names)
        self._is_a_result = CONFIG in names or SUMMARY in names
        self._waiting: Path | None = None  # folder of files that are published together

    @contextmanager
    def claimed(
        self, *, overwrite: bool = False, goes_on: Callable[[], bool] | None = None
    ) -> Iterator[Self]:
        """Check that the result can be written, and lock the folder; clean up if there is none.

        Files of these names may be replaced with `overwrite`, or if `goes_on`, called once the
        folder is locked, says that it holds a part of this very result; a training run never is.
        """
        made = [path for path in (self.path, *self.path.parents) if not path.exists()]
        # A single file, such as a film, may go to a folder that another process uses.
        lock = files.LOCK if self._is_a_result else f".{self._names[0]}{files.LOCK}"
        try:
            with files.locked(self.path, lock):
                if self._is_a_result:
                    files.finish_publishing(self.path)
                files.remove_leftovers(self.path, self._names)
                self._check(overwrite or (goes_on is not None and goes_on()))
                yield self
        finally:
            for folder in made:  # the innermost first; one with content stays
                with suppress(OSError):
                    folder.rmdir()

    def _check(self, overwrite: bool) -> None:
        present = [name for name in self._names if (self.path / name).exists()]
        if present and not overwrite:
            raise OutputError(
                f"{self.path} holds a result already ({', '.join(present)}): choose another "
                "folder, or use --overwrite"
            )
        if CONFIG in present and self._saved().get("command") == TRAINING:
            raise OutputError(
                f"{self.path} holds a training run, which --overwrite keeps: choose another folder"
            )

    def lacks_figures(self, command: str, config: dict[str, Any]) -> bool:
        """Return True if this very command was interrupted here after it wrote its numbers."""
        saved, wanted = self._saved(), json.loads(json.dumps(config, default=str))
        values = saved.get("config")
        if saved.get("command") != command or not isinstance(values, dict):
            return False
        same = all(values.get(name) == value for name, value in wanted.items())
        return same and (self.path / UNFINISHED).exists()

    def finish(self) -> None:
        """Note that all figures are drawn."""
        (self.path / UNFINISHED).unlink(missing_ok=True)

    def _saved(self) -> dict[str, Any]:
        """Return the options of the previous result; empty if there are none, or damaged ones."""
        with suppress(OutputError):
            return read_json(self.path / CONFIG, infinite=True)
        return {}

    @contextmanager
    def published(
        self,
        command: str,
        config: dict[str, Any],
        summary: Any,
        *,
        keep: Sequence[str] = (),
        unfinished: bool = False,
    ) -> Iterator[None]:
        """Publish summary, resolved options with versions, and all files of the block at once.

        They replace the last result but `keep`; it may be `unfinished` until `finish` is called.
        """
        options = {
            "command": command,
            "config": config,
            "seed": None,  # nothing is random
            "versions": versions(),
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
            "files": list(self._names),
        }
        previous = self._saved().get("files")  # of the last result, perhaps of another command
        names = (*self._names, *(previous if isinstance(previous, list) else ()), UNFINISHED)
        stale = [name for name in names if name not in keep]
        with files.replace_directory(self.path, instead_of=stale) as waiting:
            for name, content in ((CONFIG, options), (SUMMARY, summary)):
                text = json.dumps(content, indent=2, allow_nan=False, default=str)  # paths
                files.write_text(waiting / name, text + "\n")
            if unfinished:
                (waiting / UNFINISHED).touch()
            self._waiting = waiting
            try:
                yield
            finally:
                self._waiting = None

    def write(self, name: str, fill: Callable[[Path], object]) -> None:
        with files.atomic_write((self._waiting or self.path) / name) as part:
            fill(part)


_PACKAGES = ("mujoco", "numpy", "numba")


def versions(*further: str) -> dict[str, Any]:
    """Return versions of Python, of packages that affect results and of `further`; the platform."""
    found: dict[str, Any] = {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "mjgranular": __version__,  # that of an editable installation may be old
    }
    for package in (*_PACKAGES, *further):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = None
    return found


def mismatch(here: Mapping[str, Any], there: Mapping[str, Any]) -> str | None:
    """Return packages whose versions differ in two processes, with both; None if none do."""
    different = [
        f"{name} {there.get(name) or 'none'} there and {here.get(name) or 'none'} here"
        for name in ("mjgranular", *_PACKAGES)
        if here.get(name) != there.get(name)
    ]
    return ", ".join(different) or None
