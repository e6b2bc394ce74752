"""Hostile tables, CSV and Parquet: valid ones of which cells, columns and types are replaced."""

from __future__ import annotations

import io
from collections.abc import Callable
from random import Random
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from scripts.fuzzing.documents import CHANGES, FLOATS, INTEGERS, KEYS, TEXTS, number

CELLS = (
    "", " ", "nan", "NaN", "inf", "-inf", "1e999", "1,5", "0x10", "1_000", "٣", "--", "NULL", "None", "true", '"',
    '"a', "a\x00b",
    "9" * 400, "1e-320", "-1", "0", "1e300", "1\t2", "=1+1", "x" * 3000, "'", "；", "960", "-960", "1e6",
)  # fmt: skip
HEADERS = (
    "u_px", "v_px", "grab_u_px", "grab_v_px", "rope_length_m", "time_s", "", " u_px ", '"u_px"', "U_PX", "u_px\x00",
    "a\nb", "é",
    "x" * 500,
)  # fmt: skip
_BAD_UTF8 = b"\xff\xfe\x80a"


def _texts_of_bytes(count: int) -> pa.Array:
    """Column of texts that are no UTF-8, as damaged writers leave them."""
    offsets = pa.array(range(0, 4 * count + 1, 4), pa.int32()).buffers()[1]
    return pa.Array.from_buffers(pa.string(), count, [None, offsets, pa.py_buffer(_BAD_UTF8 * count)])


COLUMNS: tuple[Callable[[int], pa.Array], ...] = (
    pa.nulls,
    _texts_of_bytes,
    lambda n: pa.array(["1"] * n),
    lambda n: pa.array(["x" * 2000] * n),
    lambda n: pa.array(["1"] * n, pa.large_string()),
    lambda n: pa.array(["1"] * n).dictionary_encode(),
    lambda n: pa.array([True] * n),
    lambda n: pa.array([-(2**63)] * n, pa.int64()),
    lambda n: pa.array([2**64 - 1] * n, pa.uint64()),
    lambda n: pa.array([10**37] * n, pa.decimal128(38, 0)),
    lambda n: pa.array([float("nan")] * n),
    lambda n: pa.array([float("inf")] * n),
    lambda n: pa.array([-1e308] * n),
    lambda n: pa.array([1.5] * n, pa.float32()),
    lambda n: pa.array([0] * n, pa.timestamp("ns")),
    lambda n: pa.array([2**62] * n, pa.timestamp("us")),
    lambda n: pa.array([2**40] * n, pa.date64()),
    lambda n: pa.array([b"\xff"] * n, pa.binary()),
    lambda n: pa.array([[1.0, float("nan")]] * n),
    lambda n: pa.array([[]] * n, pa.list_(pa.float64())),
    lambda n: pa.array([{"a": 1}] * n),
    lambda n: pa.array([[("a", 1)]] * n, pa.map_(pa.string(), pa.int64())),
)


def _cell(rng: Random, table: pa.Table) -> pa.Table:
    """Replace one value by another of its type, where there is one."""
    if not table.num_rows:
        return table
    i, row = rng.randrange(table.num_columns), rng.randrange(table.num_rows)
    column, kind = table.column(i).to_pylist(), table.schema.field(i).type
    column[row] = rng.choice((*_values(rng, kind, column[row]), None))
    try:
        return table.set_column(i, pa.field(table.column_names[i], kind), pa.array(column, kind))
    except (pa.ArrowException, OverflowError, ValueError, TypeError):
        return table


def _values(rng: Random, kind: pa.DataType, old: Any) -> tuple[Any, ...]:
    if pa.types.is_floating(kind):
        return *(min(max(x, -1e308), 1e308) for x in FLOATS), number(rng), number(rng)
    if pa.types.is_integer(kind):
        return INTEGERS
    if pa.types.is_string(kind):
        return *TEXTS, *("ok", "lost", "missed", "read", "train", "../x", "[]", "{}") * 5
    if pa.types.is_boolean(kind):
        return True, False
    if pa.types.is_list(kind):
        return [], [1e308] * 12, [float("nan")] * 30, list(old or ()) * 2, list(old or ())[:-1]
    return ()


def _retyped(rng: Random, table: pa.Table) -> pa.Table:
    i = rng.randrange(table.num_columns)
    return table.set_column(i, table.column_names[i], rng.choice(COLUMNS)(table.num_rows))


def _renamed(rng: Random, table: pa.Table) -> pa.Table:
    names = list(table.column_names)
    names[rng.randrange(len(names))] = rng.choice([name for name in (*KEYS, *names) if "\x00" not in name])
    return table.rename_columns(names)


def _twice(rng: Random, table: pa.Table) -> pa.Table:
    i = rng.randrange(table.num_columns)
    return table.append_column(table.column_names[i], table.column(i))


def _rows(rng: Random, table: pa.Table) -> pa.Table:
    count = table.num_rows
    some = rng.choice((range(0), range(1), range(count - 1, -1, -1), [*range(count)] * 2, [0] * count))
    return table.take(pa.array([i for i in some if i < count], pa.int64()))


_CHANGES: tuple[Callable[[Random, pa.Table], pa.Table], ...] = (
    *[_cell] * 4, _retyped, _retyped, _renamed, _twice, _rows,
    lambda rng, table: table.remove_column(rng.randrange(table.num_columns)),
)  # fmt: skip


def parquet(rng: Random, sound: bytes) -> bytes:
    """Parquet file near a sound one."""
    table = pq.ParquetFile(pa.BufferReader(sound)).read(use_threads=False)
    for _ in range(rng.choice(CHANGES)):
        table = rng.choice(_CHANGES)(rng, table) if table.num_columns else table
    out = io.BytesIO()
    packed = rng.choice(("none", "snappy", "gzip", "zstd", "brotli"))
    pq.write_table(table, out, compression=packed, use_dictionary=rng.random() < 0.5, row_group_size=3)
    return out.getvalue()


def csv(rng: Random, sound: bytes) -> bytes:
    """CSV file near a sound one."""
    rows = [line.split(",") for line in sound.decode("utf-8").splitlines()]
    for _ in range(rng.choice(CHANGES)):
        change, at = rng.randrange(9), rng.randrange(1, len(rows)) if len(rows) > 1 else 0
        column = rng.randrange(max(len(rows[at]), 1))
        if change <= 2 and rows[at]:
            rows[at][column] = rng.choice((*CELLS, *[str(number(rng))] * 20))
        elif change == 3 and column < len(rows[0]):
            rows[0][column] = rng.choice(HEADERS)
        elif change == 4:
            rows[at] = rng.choice(([], [""], rows[at][:-1], [*rows[at], "1"], rows[at] * 50))
        elif change == 5:
            rows = rng.choice((rows[:1], rows[1:], rows[:2], rows * 2, [*rows[:1], *rows[:0:-1]]))
        elif change == 6:
            rows = [[*row, row[column] if column < len(row) else ""] for row in rows]
        elif change == 7:
            rows = [row[:column] + row[column + 1 :] for row in rows]
        else:
            value = rng.choice(CELLS)
            rows = [rows[0], *([*row[:column], value, *row[column + 1 :]] for row in rows[1:])]
        rows = rows or [[]]
    comma = rng.choice([*[","] * 20, ";", "\t", ", "])
    end = rng.choice([*["\n"] * 20, "\r\n", "\r", "\n\n"])
    code = rng.choice([*["utf-8"] * 20, "utf-8-sig", "utf-16", "latin-1"])
    return (end.join(comma.join(row) for row in rows) + end).encode(code, errors="replace")
