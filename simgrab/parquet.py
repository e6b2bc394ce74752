"""Read and write parquet files: one reader, which answers whatever a file holds with one line.

pyarrow reads and writes through open files: it takes no path that is no UTF-8. It reads without threads of Arrow's own,
one of which, letting go of an object of Python's while Python ends, would abort the process.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from simgrab.errors import first_line, one_line
from simgrab.parse import Refuse, cannot, opened

MOST_ROWS = 10_000_000
"""Of a table; a scenario has no more frames."""
MOST_BYTES = 4 * 2**30
"""Of a file, and of its table in memory."""
MOST_ROW_BYTES = 2**16
"""Of a row in memory, on average over the rows of a table, or over 256 where it has fewer."""


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
    with opened(path, refuse, kind, most_bytes=MOST_BYTES) as file:
        return parse_table(file, refuse, cannot(path, kind), columns)


def parse_table(file: BinaryIO, refuse: Refuse, what: str, columns: Sequence[str] | None = None) -> pa.Table:
    """Read an open parquet file; ``what`` begins the line that says what is wrong with it.

    A few bytes of a file can stand for a table of any size. Its footer states how many numbers it holds and how many
    bytes of text. A text that many rows share is kept once until it is known how long the texts of all rows are.
    """
    with _refusing(refuse, what):
        known = pq.ParquetFile(file, pre_buffer=False)  # buffering would be done in threads
        about, names = known.metadata, known.schema_arrow.names
        chunks = [about.row_group(i).column(j) for i in range(about.num_row_groups) for j in range(about.num_columns)]
        texts = {chunk.path_in_schema for chunk in chunks if chunk.physical_type == "BYTE_ARRAY"}
        size = sum(max(8 * chunk.num_values, chunk.total_uncompressed_size) for chunk in chunks)
    if about.num_rows > MOST_ROWS:
        raise refuse(f"{what}: it has {about.num_rows} rows, and at most {MOST_ROWS} are read")
    most = min(MOST_BYTES, MOST_ROW_BYTES * max(about.num_rows, 256))
    too_large = f"{what}: its table takes more than {most} bytes of memory"
    if size > most:
        raise refuse(too_large)
    missing = [name for name in columns or () if name not in names]
    if missing:
        raise refuse(f"{what}: it has no column {missing[0]}")
    with _refusing(refuse, what):
        table = pq.ParquetFile(file, pre_buffer=False, read_dictionary=list(texts)).read(columns, use_threads=False)
    if sum(_whole_size(column) for column in table.columns) > most:
        raise refuse(too_large)
    with _refusing(refuse, what):
        return _with_texts(table)


def _whole_size(column: pa.ChunkedArray) -> int:
    """Bytes that a column takes once each row has its own text."""
    if not _is_shared_text(column.type):
        return int(column.nbytes)
    lengths = (pc.binary_length(chunk.dictionary).take(chunk.indices) for chunk in column.chunks)
    return 8 * len(column) + sum(pc.sum(each).as_py() or 0 for each in lengths)


def _with_texts(table: pa.Table) -> pa.Table:
    """Give each row its own text."""
    for i, field in enumerate(table.schema):
        if _is_shared_text(field.type):
            kind = field.type.value_type
            table = table.set_column(i, field.with_type(kind), table.column(i).cast(kind))
    return table


def _is_shared_text(kind: pa.DataType) -> bool:
    return pa.types.is_dictionary(kind) and (pa.types.is_string(kind.value_type) or pa.types.is_binary(kind.value_type))


def rows(table: pa.Table, refuse: Refuse, what: str) -> list[dict[str, Any]]:
    """Rows of a table as plain data; ``what`` begins the line that names a column which Python cannot hold.

    A column holds one number, text or truth value in each row, or a list of floats.
    """
    columns: dict[str, list[Any]] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if name in columns:
            raise refuse(f"{what}: column {name} is there twice")
        if not _is_plain(column.type):
            raise refuse(f"{what}: column {name} is of type {one_line(column.type, 80)}, which no table of simgrab has")
        try:
            columns[name] = column.to_pylist()
        except MemoryError:
            raise
        except (pa.ArrowException, ArithmeticError, ValueError) as problem:  # a text that is no UTF-8, the year 10000
            raise refuse(f"{what}: column {name} cannot be read ({first_line(problem)})") from None
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _is_plain(kind: pa.DataType) -> bool:
    if pa.types.is_list(kind):
        return bool(pa.types.is_float64(kind.value_type))
    return pa.types.is_primitive(kind) or pa.types.is_string(kind) or pa.types.is_null(kind)


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
