"""Read and write parquet files. One reader reports any defect of a file in one line.

pyarrow reads and writes through open files: it accepts only UTF-8 paths. It reads without Arrow's own threads: a thread
that releases a Python object while Python exits would abort the process.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa
import pyarrow.parquet as pq

from simgrab.errors import first_line, one_line
from simgrab.io.parse import Refuse, cannot, opened

MOST_ROWS = 10_000_000
"""Of a table; a scenario has no more frames."""
MOST_BYTES = 4 * 2**30
"""Of a file, and of its table in memory."""
MOST_ROW_BYTES = 2**16
"""Of a row in memory, on average over the rows of a table, or over 256 where it has fewer."""
_ROWS_AT_ONCE = 64  # so that a long text in each of them takes little
_BATCHES_TOGETHER = 64  # copied into one piece: many small ones take twice the memory of their content


def read_table(path: str | Path, refuse: Refuse, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a parquet file, or some of its columns; ``refuse`` makes the error to raise from a line."""
    with opened(path, refuse, most_bytes=MOST_BYTES) as file:
        return parse_table(file, refuse, cannot(path), columns)


def parse_table(file: BinaryIO, refuse: Refuse, what: str, columns: Sequence[str] | None = None) -> pa.Table:
    """Read an open parquet file; ``what`` begins the error line.

    A few bytes of a file can encode a table of any size, so rows are read in batches and their memory is counted. Only
    the schema and the number of rows are read from the footer: Arrow aborts on some damaged footers.
    """
    with _refusing(refuse, what):
        known = pq.ParquetFile(file, pre_buffer=False)  # buffering would be done in threads
        count, schema = known.metadata.num_rows, known.schema_arrow
    if count > MOST_ROWS:
        raise refuse(f"{what}: it has {count} rows; the limit is {MOST_ROWS}")
    missing = [name for name in columns or () if name not in schema.names]
    if missing:
        raise refuse(f"{what}: it has no column {missing[0]}")
    most, size = min(MOST_BYTES, MOST_ROW_BYTES * max(count, 256)), 0
    pieces, batches = list[pa.Table](), list[pa.RecordBatch]()
    with _refusing(refuse, what):
        for batch in known.iter_batches(_ROWS_AT_ONCE, columns=columns, use_threads=False):
            size += batch.nbytes
            if size > most:
                break
            batch.validate(full=True)  # texts are UTF-8, and lists lie within their column
            batches.append(batch)
            if len(batches) == _BATCHES_TOGETHER:
                pieces.append(pa.Table.from_batches(batches).combine_chunks())
                batches.clear()
        if batches:
            pieces.append(pa.Table.from_batches(batches).combine_chunks())
        table = pa.concat_tables(pieces) if pieces else known.read(columns, use_threads=False)
    if size > most:
        raise refuse(f"{what}: its table takes more than {most} bytes of memory")
    return table


def rows(table: pa.Table, refuse: Refuse, what: str) -> list[dict[str, Any]]:
    """Rows of a table as plain data; ``what`` begins the error line, which names a column that Python cannot represent.

    Each value is a number, a text, a truth value or a list of floats.
    """
    columns: dict[str, list[Any]] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if name in columns:
            raise refuse(f"{what}: duplicate column {name}")
        if not _is_plain(column.type):
            raise refuse(f"{what}: column {name} has the unsupported type {one_line(column.type, 80)}")
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
    if pa.types.is_dictionary(kind):  # as pandas writes categories
        kind = kind.value_type
    return pa.types.is_primitive(kind) or pa.types.is_string(kind) or pa.types.is_null(kind)


def groups(path: Path) -> Iterator[pa.Table]:
    """Read a table that simgrab wrote, one row group at a time. Errors are those of the file system and of Arrow."""
    with path.open("rb") as opened, pq.ParquetFile(opened, pre_buffer=False) as file:
        for group in range(file.num_row_groups):
            yield file.read_row_group(group, use_threads=False)


def write(table: pa.Table, path: Path, **options: Any) -> None:
    """Write a table; ``options`` are of `pyarrow.parquet.write_table`. Errors are those of the file system."""
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
