"""Tables of rows on disk, written row by row."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from mjgranular._util.extras import require

Rows = Callable[[], Iterator[dict[str, Any]]]
"""Gives the rows from the first, each time that it is called."""

_GROUP = 10_000  # rows of a Parquet file that lie in memory at once; chosen


def write_csv(path: Path, columns: Sequence[str], rows: Rows) -> None:
    """Writes a CSV file. What a row does not have is empty there.

    Args:
        path: of the file.
        columns: names, in order.
        rows: the rows.
    """
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(columns))
        writer.writeheader()
        writer.writerows(rows())


def need_parquet() -> Any:
    """pyarrow, with which Parquet files are written.

    Raises:
        MissingExtraError: it is not installed.
    """
    return require("pyarrow.parquet", extra="parquet", purpose="A table as Parquet")


def write_parquet(path: Path, columns: Sequence[str], rows: Rows) -> None:
    """Writes a Parquet file: a column is numbers, whole numbers, yes and no, or texts.

    Args:
        path: of the file.
        columns: names, in order.
        rows: the rows.
    """
    parquet = need_parquet()
    arrow = require("pyarrow", extra="parquet", purpose="A table as Parquet")
    found: dict[str, set[type]] = {name: set() for name in columns}
    for row in rows():
        for name, value in row.items():
            found[name].add(type(value))
    kinds = {bool: arrow.bool_(), int: arrow.int64(), str: arrow.string()}

    def kind(types: set[type]) -> Any:
        types = types - {type(None)}
        return kinds.get(types.pop(), arrow.float64()) if len(types) == 1 else arrow.float64()

    schema = arrow.schema([(name, kind(found[name])) for name in columns])
    with parquet.ParquetWriter(path, schema) as writer:
        every = rows()
        while group := list(itertools.islice(every, _GROUP)):
            writer.write_table(arrow.Table.from_pylist(group, schema=schema))
