"""Results that are saved as soon as they exist, so that a killed run can resume."""

import json
import os
import tempfile
import zlib
from array import array
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from mjgranular._util.io import check_regular
from mjgranular._util.result_folder import versions
from mjgranular.errors import InputError, OutputError

UNFINISHED = "unfinished.jsonl"
"""File of an unfinished run: the request, then a line of JSON for each result."""

_NONE = -1
_DAMAGED = "it is damaged"


class Journal:
    """Results of numbered tasks, on disk; only their positions are in memory.

    Args:
        folder: folder for the result; None for a temporary file, deleted with this object.
        asked: the request, in plain values; a run only resumes from results of the same request.
        size: number of tasks.
    """

    def __init__(self, folder: Path | None, asked: Mapping[str, Any], size: int) -> None:
        self.count = 0
        self._path = None if folder is None else folder / UNFINISHED
        # Through JSON, so that it equals what is read: tuples are lists there.
        self._asked = json.loads(json.dumps({"asked": dict(asked), "versions": versions()}))
        self._places = array("q", [_NONE]) * size
        self._file: IO[bytes] | None = None

    def __del__(self) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self._places)

    def __contains__(self, index: int) -> bool:
        return self._places[index] != _NONE

    def __getitem__(self, index: int) -> dict[str, Any]:
        assert self._file is not None
        self._file.seek(self._places[index])
        return json.loads(self._file.readline())["row"]

    def results(self) -> Iterator[dict[str, Any]]:
        """Yield the existing results, in the order of their tasks."""
        return (self[index] for index in range(len(self)) if index in self)

    def fault(self) -> str | None:
        """Return why a run cannot resume from the file in the folder; None if it can."""
        return self._read()[0]

    def begin(self) -> None:
        """Open the file: results of the same request stay, all else in it is deleted."""
        if self._path is None:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the journal
            return
        fault, self._places, end = self._read()
        self.count = len(self) - self._places.count(_NONE)
        try:
            self._file = self._path.open("w+b" if fault else "r+b")
            self._file.truncate(end)  # a partial line, where the process was killed
        except OSError as error:
            raise self._as_output_error(error) from None

    def keep(self, index: int, row: Mapping[str, Any]) -> None:
        if self._file is None:
            self.begin()
        file = self._file
        assert file is not None
        try:
            if file.seek(0, os.SEEK_END) == 0:
                file.write(_line(self._asked))
            self._places[index] = file.tell()
            file.write(_line(_entry(index, row)))
            file.flush()
        except OSError as error:
            raise self._as_output_error(error) from None
        self.count += 1

    def recount(self) -> None:
        """Count what is in the file: an interrupt may have come between writing and counting."""
        if self._path is not None:
            self.close()
            self.begin()

    def close(self) -> None:
        if self._file is not None:
            with suppress(OSError):  # of a full disk, which `keep` has reported
                self._file.close()
            self._file = None

    def _read(self) -> tuple[str | None, "array[int]", int]:
        """Return any fault of the file, and the positions and the end of its results."""
        none = array("q", [_NONE]) * len(self)
        if self._path is None or not self._path.exists():
            return "there is none", none, 0
        places, end = none[:], 0
        try:
            check_regular(self._path, "the file")
            with self._path.open("rb") as file:
                for line in file:
                    if not line.endswith(b"\n"):  # where the process was killed
                        break
                    content = json.loads(line)
                    if end == 0 and content != self._asked:
                        return _difference(content, self._asked), none, 0
                    if end > 0:
                        places[_index(content, len(self))] = end
                    end += len(line)
        except (OSError, InputError) as error:
            return f"it cannot be read ({error})", none, 0
        except (ValueError, TypeError, KeyError, RecursionError):
            return _DAMAGED, none, 0
        return None, places, end

    def _as_output_error(self, error: OSError) -> OutputError:
        return OutputError(f"cannot write {self._path}: {error.strerror or error}")


def _index(content: Any, size: int) -> int:
    """Return the number of the task of a line of the file."""
    if not 0 <= content["index"] < size or content != _entry(content["index"], content["row"]):
        raise ValueError
    return content["index"]


def _entry(index: int, row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a line of the file, with a checksum of the result."""
    return {"index": index, "row": row, "crc": zlib.crc32(_line(row))}


def _difference(there: Any, asked: Mapping[str, Any]) -> str:
    for part, of in (("asked", ""), ("versions", "the version of ")):
        before, now = there[part], asked[part]
        for name in {**before, **now}:
            if before.get(name) != now.get(name):
                return f"it was begun with another {of}{str(name)[:50]}"
    return _DAMAGED


def _line(content: Mapping[str, Any]) -> bytes:
    return (json.dumps(content) + "\n").encode()
