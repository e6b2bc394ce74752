"""Hostile tables in Parquet: valid ones of which cells, columns and types are replaced."""

from __future__ import annotations

import io
from collections.abc import Callable
from random import Random
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from scripts.fuzzing.documents import CHANGES, FLOATS, INTEGERS, KEYS, TEXTS, number

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
