"""Tables on disk, written row by row."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular._util.extras import require

Rows = Callable[[], Iterator[dict[str, Any]]]
"""Returns an iterator over the rows, from the first, at each call."""

_GROUP = 10_000  # rows of a Parquet file that are in memory at once; chosen


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


def need_parquet() -> Any:
    """Return pyarrow's module for Parquet files.

    Raises:
        MissingExtraError: it is not installed.
    """
    return require("pyarrow.parquet", extra="parquet", purpose="A table as Parquet")


def write_parquet(path: Path, columns: Sequence[str], rows: Rows) -> None:
    """Write a Parquet file; a column has numbers, integers, booleans or strings."""
    parquet = need_parquet()
    arrow = require("pyarrow", extra="parquet", purpose="A table as Parquet")
    types: dict[str, set[type]] = {name: set() for name in columns}
    for row in rows():
        for name, value in row.items():
            types[name].add(type(value))
    kinds = {bool: arrow.bool_(), int: arrow.int64(), str: arrow.string()}

    def kind(found: set[type]) -> Any:
        found = found - {type(None)}
        return kinds.get(next(iter(found)), arrow.float64()) if len(found) == 1 else arrow.float64()

    schema = arrow.schema([(name, kind(types[name])) for name in columns])
    with parquet.ParquetWriter(path, schema) as writer:
        remaining = rows()
        while group := list(itertools.islice(remaining, _GROUP)):
            writer.write_table(arrow.Table.from_pylist(group, schema=schema))
