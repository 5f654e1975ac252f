"""Rows of a sweep that are kept as soon as they are finished, so that a killed one goes on."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mjgranular import files
from mjgranular.errors import OutputError
from mjgranular.experiment.provenance import versions
from mjgranular.experiment.sweep import Sweep
from mjgranular.saved import number, parse_json, read_text

UNFINISHED = "unfinished.jsonl"
"""The file: what was asked for, then a line of JSON for each row. A folder with it in it holds a
sweep that is not finished."""

_FLUSH_EVERY = 1.0  # [s]; a killed process loses nothing, a lost machine this much


class Unfinished:
    """The rows of a sweep that are finished.

    Args:
        folder: where the result goes.
        sweep: what is asked for.
    """

    def __init__(self, folder: Path, sweep: Sweep) -> None:
        self._file = folder / UNFINISHED
        self._sweep = sweep
        self._flushed = 0.0

    def rows(self) -> dict[int, dict[str, Any]] | None:
        """Rows that a process kept before of this sweep, by their number; None if it kept none."""
        if not self._file.exists():
            return None
        try:
            # The last is empty, or the one in which the process was killed.
            lines = [parse_json(line, "") for line in read_text(self._file).split("\n")[:-1]]
        except OutputError:
            return None
        if not lines:  # killed before it had written anything
            return {}
        if lines[0] != self._asked():
            return None
        rows = {}
        for line in lines[1:]:
            index, row = line.get("index"), line.get("row")
            if not self._is_row(index, row):
                return None
            rows[index] = row
        return rows

    def keep(self, index: int, row: dict[str, Any]) -> None:
        """Adds a row."""
        begun = self._file.exists()
        try:
            with self._file.open("a", encoding="utf-8") as file:
                lines = [] if begun else [self._asked()]
                file.write("".join(map(_line, [*lines, {"index": index, "row": row}])))
                file.flush()
                if time.monotonic() - self._flushed > _FLUSH_EVERY:
                    os.fsync(file.fileno())
                    self._flushed = time.monotonic()
        except OSError as error:
            raise OutputError(f"cannot write {self._file}: {error.strerror or error}") from None

    def begin(self) -> dict[int, dict[str, Any]]:
        """The rows to go on from; those of another sweep, and half a line, are gone then."""
        rows = self.rows() or {}
        if rows:
            lines = [self._asked(), *({"index": k, "row": row} for k, row in rows.items())]
            files.write_text(self._file, "".join(map(_line, lines)))
        else:
            with suppress(OSError):
                self._file.unlink()
        return rows

    def _asked(self) -> dict[str, Any]:
        return {"sweep": asdict(self._sweep), "versions": versions()}

    def _is_row(self, index: object, row: object) -> bool:
        if not isinstance(index, int) or not 0 <= index < self._sweep.points:
            return False
        if not isinstance(row, Mapping):
            return False
        names = ("speed", "angle_deg", "timestep", "depth", "stopping_time")
        try:
            numbers = [number(row, name, "") for name in names]
        except OutputError:
            return False
        return None not in numbers[:-1]


def _line(content: Mapping[str, Any]) -> str:
    return json.dumps(content, allow_nan=False) + "\n"
