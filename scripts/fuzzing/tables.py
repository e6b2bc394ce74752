"""Hostile tables, CSV and Parquet: valid ones of which cells, columns and types are replaced."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from hypothesis import strategies as st

from scripts.fuzzing.documents import CHANGES, KEYS, NUMBERS, TEXTS

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


def _cell(draw: st.DrawFn, table: pa.Table) -> pa.Table:
    """Replace one value by another of its type, where there is one."""
    if not table.num_columns or not table.num_rows:
        return table
    i, row = draw(st.integers(0, table.num_columns - 1)), draw(st.integers(0, table.num_rows - 1))
    column, kind = table.column(i).to_pylist(), table.schema.field(i).type
    column[row] = draw(_value(kind, column[row]))
    try:
        return table.set_column(i, pa.field(table.column_names[i], kind), pa.array(column, kind))
    except (pa.ArrowException, OverflowError, ValueError, TypeError):
        return table


def _value(kind: pa.DataType, old: Any) -> st.SearchStrategy[Any]:
    if pa.types.is_floating(kind):
        return st.sampled_from([float(min(max(x, -1e308), 1e308)) for x in NUMBERS]) | st.none() | st.floats()
    if pa.types.is_integer(kind):
        return st.sampled_from([x for x in NUMBERS if isinstance(x, int)]) | st.none()
    if pa.types.is_string(kind):
        return (
            st.sampled_from(TEXTS)
            | st.none()
            | st.sampled_from(("ok", "lost", "missed", "read", "train", "../x", "[]", "{}"))
        )
    if pa.types.is_boolean(kind):
        return st.booleans() | st.none()
    if pa.types.is_list(kind):
        return st.sampled_from(([], None, [1e308] * 12, [float("nan")] * 30, list(old or ()) * 2, list(old or ())[:-1]))
    return st.none()


def _retyped(draw: st.DrawFn, table: pa.Table) -> pa.Table:
    if not table.num_columns:
        return table
    i = draw(st.integers(0, table.num_columns - 1))
    return table.set_column(i, table.column_names[i], draw(st.sampled_from(COLUMNS))(table.num_rows))


def _renamed(draw: st.DrawFn, table: pa.Table) -> pa.Table:
    if not table.num_columns:
        return table
    names = list(table.column_names)
    names[draw(st.integers(0, len(names) - 1))] = draw(
        st.sampled_from((*KEYS, *names)).filter(lambda n: "\x00" not in n)
    )
    return table.rename_columns(names)


def _without(draw: st.DrawFn, table: pa.Table) -> pa.Table:
    return table.remove_column(draw(st.integers(0, table.num_columns - 1))) if table.num_columns else table


def _twice(draw: st.DrawFn, table: pa.Table) -> pa.Table:
    if not table.num_columns:
        return table
    i = draw(st.integers(0, table.num_columns - 1))
    return table.append_column(table.column_names[i], table.column(i))


def _rows(draw: st.DrawFn, table: pa.Table) -> pa.Table:
    count = table.num_rows
    some = draw(st.sampled_from((range(0), range(1), range(count - 1, -1, -1), [*range(count)] * 2, [0] * count)))
    return table.take(pa.array([i for i in some if i < count], pa.int64()))


_CHANGES = (_cell, _cell, _cell, _cell, _retyped, _retyped, _renamed, _without, _twice, _rows)


def parquet(sound: bytes) -> st.SearchStrategy[bytes]:
    """Parquet files near a sound one."""

    @st.composite  # without arguments, which hypothesis would write out
    def file(draw: st.DrawFn) -> bytes:
        table = pq.ParquetFile(pa.BufferReader(sound)).read(use_threads=False)
        for _ in range(draw(st.sampled_from(CHANGES))):
            table = draw(st.sampled_from(_CHANGES))(draw, table)
        out = io.BytesIO()
        packed = draw(st.sampled_from(("none", "snappy", "gzip", "zstd", "brotli")))
        pq.write_table(table, out, compression=packed, use_dictionary=draw(st.booleans()), row_group_size=3)
        return out.getvalue()

    return file()


def csv(sound: bytes) -> st.SearchStrategy[bytes]:
    """CSV files near a sound one."""

    @st.composite
    def file(draw: st.DrawFn) -> bytes:
        return _csv(draw, [line.split(",") for line in sound.decode("utf-8").splitlines()])

    return file()


def _csv(draw: st.DrawFn, rows: list[list[str]]) -> bytes:
    for _ in range(draw(st.sampled_from(CHANGES))):
        change, at = draw(st.sampled_from(range(9))), draw(st.integers(1, len(rows) - 1)) if len(rows) > 1 else 0
        column = draw(st.integers(0, max(len(rows[at]) - 1, 0)))
        if change <= 2 and rows[at]:
            rows[at][column] = draw(st.sampled_from(CELLS) | st.floats().map(str))
        elif change == 3 and column < len(rows[0]):
            rows[0][column] = draw(st.sampled_from(HEADERS))
        elif change == 4:
            rows[at] = draw(st.sampled_from(([], [""], rows[at][:-1], [*rows[at], "1"], rows[at] * 50)))
        elif change == 5:
            rows = draw(st.sampled_from((rows[:1], rows[1:], rows[:2], rows * 2, [*rows[:1], *rows[:0:-1]])))
        elif change == 6:
            rows = [[*row, row[column] if column < len(row) else ""] for row in rows]
        elif change == 7:
            rows = [row[:column] + row[column + 1 :] for row in rows]
        else:
            value = draw(st.sampled_from(CELLS))
            rows = [rows[0], *([*row[:column], value, *row[column + 1 :]] for row in rows[1:])]
        rows = rows or [[]]
    comma = draw(st.sampled_from([*[","] * 20, ";", "\t", ", "]))
    end = draw(st.sampled_from([*["\n"] * 20, "\r\n", "\r", "\n\n"]))
    code = draw(st.sampled_from([*["utf-8"] * 20, "utf-8-sig", "utf-16", "latin-1"]))
    return (end.join(comma.join(row) for row in rows) + end).encode(code, errors="replace")
