"""Read and write parquet files: one reader, which answers whatever a file holds with one line.

pyarrow reads and writes through open files: it takes no path that is no UTF-8. It reads without threads of Arrow's own,
one of which, letting go of an object of Python's while Python ends, would abort the process.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from simgrab.errors import first_line
from simgrab.parse import Refuse, cannot, opened

MOST_ROWS = 10_000_000
"""Of a table; a scenario has no more frames."""


def read_table(path: str | Path, refuse: Refuse, kind: str = "", columns: Sequence[str] | None = None) -> pa.Table:
    """Read a parquet file.

    Parameters
    ----------
    path : path
    refuse : callable
        From a line with file and reason to what is raised.
    kind : str
        What such a file is called, e.g. ``"truth table"``.
    columns : sequence of str, optional
        Names of the columns to read; all by default.
    """
    with opened(path, refuse, kind) as file:
        content = file.read()
    return parse_table(content, refuse, cannot(path, kind), columns)


def parse_table(content: bytes, refuse: Refuse, what: str, columns: Sequence[str] | None = None) -> pa.Table:
    """Parse the bytes of a parquet file; ``what`` begins the line that says what is wrong with it."""
    with _refusing(refuse, what):
        file = pq.ParquetFile(pa.BufferReader(content), pre_buffer=False)  # which would be done in threads
    if file.metadata.num_rows > MOST_ROWS:
        raise refuse(f"{what}: it has {file.metadata.num_rows} rows, and at most {MOST_ROWS} are read")
    missing = [name for name in columns or () if name not in file.schema_arrow.names]
    if missing:
        raise refuse(f"{what}: it has no column {missing[0]}")
    with _refusing(refuse, what):
        return file.read(columns=columns, use_threads=False)


def rows(table: pa.Table, refuse: Refuse, what: str) -> list[dict[str, Any]]:
    """Rows of a table as plain data; ``what`` begins the line that names a column which Python cannot hold."""
    columns: dict[str, list[Any]] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if name in columns:
            raise refuse(f"{what}: column {name} is there twice")
        try:
            columns[name] = column.to_pylist()
        except MemoryError:
            raise
        except (pa.ArrowException, ArithmeticError, ValueError) as problem:  # a text that is no UTF-8, the year 10000
            raise refuse(f"{what}: column {name} cannot be read ({first_line(problem)})") from None
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def groups(path: Path) -> Iterator[pa.Table]:
    """Read a table of our own one row group at a time, as they were written.

    Raises
    ------
    OSError, pyarrow.ArrowException
        If it cannot be read.
    """
    with path.open("rb") as opened, pq.ParquetFile(opened, pre_buffer=False) as file:
        for group in range(file.num_row_groups):
            yield file.read_row_group(group, use_threads=False)


def write(table: pa.Table, path: Path, **options: Any) -> None:
    """Write a table; ``options`` are of `pyarrow.parquet.write_table`.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with path.open("wb") as file:
        pq.write_table(table, file, **options)


@contextmanager
def _refusing(refuse: Refuse, what: str) -> Iterator[None]:
    try:
        yield
    except MemoryError:  # pyarrow's is one of its own exceptions as well
        raise
    except (pa.ArrowException, OSError, ValueError) as problem:
        raise refuse(f"{what}: it is not a parquet file that can be read ({first_line(problem)})") from None
