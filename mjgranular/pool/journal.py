"""Results that are saved as soon as they exist, so that a killed run can resume."""

from __future__ import annotations

import json
import os
import tempfile
import time
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from mjgranular._util.io import NotRegularError, check_regular
from mjgranular._util.io import parse_json
from mjgranular.errors import OutputError
from mjgranular.pool.versions import versions

UNFINISHED = "unfinished.jsonl"
"""The file: the request, then a line of JSON for each result. A folder that contains it has an
unfinished run."""

_FLUSH_EVERY = 1.0  # [s]; a killed process loses nothing, a crashed machine this much
_LONGEST = 1 << 20  # bytes of a line; far beyond what is written. Chosen, not measured
_NONE = -1


class Journal:
    """Results of numbered tasks, on disk; only their positions are in memory.

    Args:
        folder: folder for the result; None for a temporary file, deleted with this object.
        asked: the request, in plain values; a run only resumes from results of the same request.
        size: number of tasks.
        is_result: returns True if a parsed value can be a result.
    """

    def __init__(
        self,
        folder: Path | None,
        asked: Mapping[str, Any],
        size: int,
        is_result: Callable[[Mapping[str, Any]], bool] | None = None,
    ) -> None:
        self._file: IO[bytes] | None = None
        self._path = None if folder is None else folder / UNFINISHED
        # Through JSON, so that it equals what is read: tuples are lists there.
        self._asked = json.loads(json.dumps({"asked": dict(asked), "versions": versions()}))
        self._is_result = is_result
        self._places = array("q", [_NONE]) * size
        self._flushed = 0.0
        self._end = 0
        self.count = 0
        """Number of results."""

    def __del__(self) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self._places)

    def __bool__(self) -> bool:
        return True  # also without tasks

    def __contains__(self, index: int) -> bool:
        return self._places[index] != _NONE

    def __getitem__(self, index: int) -> dict[str, Any]:
        assert self._file is not None
        self._file.seek(self._places[index])
        return json.loads(self._file.readline())["row"]

    def results(self) -> Iterator[dict[str, Any]]:
        """Yield the existing results, in the order of their tasks."""
        return (self[index] for index in range(len(self._places)) if index in self)

    def missing(self) -> Iterator[int]:
        """Yield the numbers of the tasks without a result, searched lazily."""
        return (index for index in range(len(self._places)) if index not in self)

    def goes_on(self) -> bool:
        """Return True if the folder has results, or a start, of the same request."""
        return self._path is not None and self._path.exists() and self.fault() is None

    def fault(self) -> str | None:
        """Return why a run cannot resume from the file in the folder; None if it can."""
        return self._read()[0]

    def begin(self) -> None:
        """Open the file: results of the same request stay, all else in it is deleted.

        Raises:
            OutputError: it cannot be written.
        """
        if self._path is None:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the journal
            return
        fault, places, end = self._read() if self._path.exists() else ("", None, 0)
        try:
            self._file = self._path.open("r+b" if fault is None and end else "w+b")
            self._end = end if fault is None else 0
            self._file.truncate(self._end)  # a partial line, where the process was killed
        except OSError as error:
            raise self._said(error) from None
        if fault is None and places is not None:
            self._places = places
            self.count = sum(place != _NONE for place in places)

    def keep(self, results: Sequence[tuple[int, Mapping[str, Any]]]) -> None:
        """Add results, all in one write.

        Raises:
            OutputError: they cannot be written.
        """
        if not results:
            return
        if self._file is None:
            self.begin()
        assert self._file is not None
        end, lines, places = self._end, [], []
        if end == 0:
            lines.append(_line(self._asked))
            end += len(lines[0])
        for index, row in results:
            line = _line({"index": index, "row": row})
            places.append((index, end))
            lines.append(line)
            end += len(line)
        try:
            self._file.seek(self._end)
            self._file.write(b"".join(lines))
            self._file.flush()
            if self._path is not None and time.monotonic() - self._flushed > _FLUSH_EVERY:
                os.fsync(self._file.fileno())
                self._flushed = time.monotonic()
        except OSError as error:
            raise self._said(error) from None
        self._end = end
        for index, place in places:
            self._places[index] = place
        self.count += len(places)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            self._file = None

    def _read(self) -> tuple[str | None, array[int] | None, int]:
        """Return any fault of the file, the positions of its results, and their end."""
        assert self._path is not None
        if not self._path.exists():
            return "there is none", None, 0
        places = array("q", [_NONE]) * len(self._places)
        end = 0
        try:
            check_regular(self._path, "the file")
            with self._path.open("rb") as file:
                while (line := file.readline(_LONGEST)).endswith(b"\n"):
                    fault = self._place(line, end, places)
                    if fault is not None:
                        return fault, None, 0
                    end += len(line)
        except (OSError, ValueError, NotRegularError) as error:
            return f"it cannot be read ({error})", None, 0
        if len(line) == _LONGEST:
            return "it is damaged", None, 0
        return None, places, end

    def _place(self, line: bytes, at: int, places: array[int]) -> str | None:
        """Record a line of the file; return its fault, if any."""
        try:
            content = parse_json(line.decode(), UNFINISHED)
        except (OutputError, UnicodeDecodeError):
            return "it is damaged"
        if at == 0:
            return _difference(content, self._asked)
        index, row = content.get("index"), content.get("row")
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(places):
            return "it is damaged"
        known = self._is_result is None or (isinstance(row, dict) and self._is_result(row))
        if "row" not in content or not known or places[index] != _NONE:
            return "it is damaged"
        places[index] = at
        return None

    def _said(self, error: OSError) -> OutputError:
        return OutputError(f"cannot write {self._path}: {error.strerror or error}")


def _difference(there: Mapping[str, Any], asked: Mapping[str, Any]) -> str | None:
    """Return the first difference of two requests; None if there is none."""
    if there == asked:
        return None
    for part in ("asked", "versions"):
        before, now = there.get(part), asked[part]
        if not isinstance(before, Mapping):
            return "it is damaged"
        for name in {**before, **now}:
            if before.get(name) != now.get(name):
                of = "the version of " if part == "versions" else ""
                return f"it was begun with another {of}{str(name)[:50]}"
    return "it is damaged"


def _line(content: Mapping[str, Any]) -> bytes:
    return (json.dumps(content, allow_nan=False) + "\n").encode()
