"""Tables on disk, written row by row."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Rows = Callable[[], Iterator[dict[str, Any]]]
"""Returns an iterator over the rows, from the first, at each call."""


def write_numbers(path: Path, header: Sequence[str], values: np.ndarray) -> None:
    """Write an array, shape (rows, columns), as a CSV file with all digits."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows([map(repr, row) for row in values.tolist()])


def write_csv(path: Path, columns: Sequence[str], rows: Rows) -> None:
    """Write a CSV file with the columns in the given order; cells that a row lacks are empty."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(columns))
        writer.writeheader()
        writer.writerows(rows())
