"""Read records of pixels from CSV or parquet into arrays; errors name row and column."""

from __future__ import annotations

import codecs
import itertools
import re
from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.csv

from simgrab.errors import RecordError, first_line
from simgrab.instrument.estimate.record import PixelRecord
from simgrab.io.parquet import read_table
from simgrab.io.parse import cannot, opened
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array

MOST_CSV_BYTES = 2**30
MOST_HEADER_BYTES = 2**16
# A grab centre may lie outside of the picture by its own size, no more.
_MARGIN = 0.5
_LONGEST_ROPE_M = 200.0
# The second as a dataset's labels.parquet has them.
_PIXELS = (("u_px", "v_px"), ("grab_u_px", "grab_v_px"))
_DEVIATIONS = ("u_sd_px", "v_sd_px")  # as a run's angles.csv has them
HEADER = "u_px, v_px[, u_sd_px, v_sd_px, rope_length_m, time_s]"


def read_record(
    path: str | Path, calibration: Calibration, *, rope: bool = False, time: bool = False, displayed: bool = False
) -> PixelRecord:  # fmt: skip
    """Read the columns of `HEADER`; the first two may be called ``grab_u_px, grab_v_px``.

    Parameters
    ----------
    path : path
        ``.parquet``, or else CSV with a header.
    calibration : Calibration
        Camera in whose picture the pixels must lie.
    rope, time : bool
        Whether the column is required. An optional column may be empty, and an optional rope length invalid.
    displayed : bool
        Whether to leave out lengths that a run did not read on the display, and so has from a controller.

    Raises
    ------
    RecordError
        With one line that names the file and the row (the first is 1) or the column.
    """
    table = read_texts(path, (*itertools.chain(*_PIXELS), *_DEVIATIONS, "rope_length_m", "time_s"), HEADER)
    pair = _pixel_columns(path, table.column_names)
    needed = [*pair, *(["rope_length_m"] if rope else []), *(["time_s"] if time else [])]
    check_columns(path, table, *((name,) for name in needed))
    pixels = np.stack([numbers(path, table, name) for name in pair], axis=-1)
    _check_pixels(path, pixels, pair, calibration)
    try:
        length = _rope(path, table) if "rope_length_m" in table.column_names else None
    except RecordError:
        if rope:
            raise
        length = None
    if displayed and length is not None and "rope_status" in table.column_names:
        read = np.array([str(status) == "read" for status in table["rope_status"].to_pylist()])
        length = np.where(read, length, np.nan) if read.any() else None
    seconds = numbers(path, table, "time_s") if "time_s" in table.column_names else None
    if seconds is not None and not time and np.isnan(seconds).all():  # as in the labels of independent frames
        seconds = None
    if seconds is not None:
        check_present(path, "time_s", seconds, increasing=time)
    stated = [_deviation(path, table, name) for name in _DEVIATIONS if name in table.column_names]
    sd = np.sqrt(np.mean(np.square(stated), axis=0)) if stated else np.zeros(len(pixels))
    return PixelRecord(pixels=pixels, pixel_sd=sd, rope_length=length, time=seconds)


def check_columns(path: str | Path, table: pa.Table, *needed: Sequence[str]) -> None:
    """Refuse a table without rows, or without any column of each group that is needed."""
    for names in needed:
        if not set(names) & set(table.column_names):
            there = ", ".join(table.column_names) or "none"
            raise RecordError(f"{path}: column {' or '.join(names)} is missing; there are: {there}")
    if table.num_rows == 0:
        raise RecordError(f"{path}: no rows below the header")


def check_present(path: str | Path, name: str, values: Array, *, increasing: bool) -> None:
    """Refuse a column (n,) with empty cells, or that does not increase."""
    for row in np.flatnonzero(~np.isfinite(values))[:1]:
        raise RecordError(f"{path}: {name}, row {row + 1}: is missing")
    for row in np.flatnonzero(np.diff(values) <= 0)[:1] + 1 if increasing else ():
        raise RecordError(
            f"{path}: {name}, row {row + 1}: must increase, got {values[row]:g} after {values[row - 1]:g}"
        )


def _pixel_columns(path: str | Path, names: list[str]) -> tuple[str, str]:
    there = [pair for pair in _PIXELS if any(name in names for name in pair)]
    if len(there) > 1:
        one, other = (", ".join(name for name in pair if name in names) for pair in there)
        raise RecordError(f"{path}: columns {one} and {other} are both present; keep only one pair")
    return there[0] if there else _PIXELS[0]


def _deviation(path: str | Path, table: pa.Table, name: str) -> Array:
    sd = np.nan_to_num(numbers(path, table, name))
    for row in np.flatnonzero(~(sd >= 0))[:1]:
        raise RecordError(f"{path}: {name}, row {row + 1}: is {sd[row]:g}; must be 0 px or more")
    return sd


def _rope(path: str | Path, table: pa.Table) -> Array:
    length = numbers(path, table, "rope_length_m")
    for row in np.flatnonzero(~((length > 0) & (length < _LONGEST_ROPE_M)))[:1]:
        what = "is missing" if np.isnan(length[row]) else f"is {length[row]:g}"
        raise RecordError(
            f"{path}: rope_length_m, row {row + 1}: {what}; must be metres, above 0 and below {_LONGEST_ROPE_M:g}"
        )
    return length


def read_texts(path: str | Path, names: Collection[str], header: str) -> pa.Table:
    """Read ``.parquet``, or else CSV, of which every column is text, so that errors can name a cell.

    Parameters
    ----------
    names : collection of str
        Columns that must not be there twice; others are ignored.
    header : str
        The columns, in the words of a message.

    Raises
    ------
    RecordError
    """
    path = Path(path)
    if path.suffix.lower() == ".parquet":
        table = read_table(path, RecordError)
    else:
        with opened(path, RecordError, most_bytes=MOST_CSV_BYTES) as file:
            table = parsed_csv(file.read(), path, header)
    for name in names:
        if table.column_names.count(name) > 1:
            raise RecordError(f"{path}: duplicate column {name}")
    return table


def decimal_comma(cell: str) -> str:
    """Name the cure of a number with a decimal comma; empty for other cells."""
    return "; write decimals with a point, such as 12.5" if re.fullmatch(r"\s*[+-]?\d*,\d+\s*", cell) else ""


def separator(header: bytes) -> str:
    """Return what separates the columns of a CSV file."""
    return ";" if b";" in header.partition(b",")[0] else ","


def parsed_csv(content: bytes, path: Path, needed: str) -> pa.Table:
    """Parse the content of a CSV file as `read_texts` does.

    Columns are separated by commas, or by semicolons, of which decimals may have commas. Text is UTF-8 or else
    Windows-1252.
    """
    content = content.removeprefix(codecs.BOM_UTF8)
    header = content[: MOST_HEADER_BYTES + 1].splitlines()[:1]
    if not header or not header[0].strip():
        raise RecordError(f"{path}: the file is empty; a header {needed} is needed")
    if len(header[0]) > MOST_HEADER_BYTES:
        raise RecordError(
            f"{cannot(path)}: its first line is not a header: it is longer than {MOST_HEADER_BYTES} bytes"
        )
    try:
        mark = separator(header[0])
        names = [name.strip().strip('"') for name in header[0].decode().split(mark)]
        options = pa.csv.ConvertOptions(column_types=dict.fromkeys(names, pa.string()))
        reading = pa.csv.ReadOptions(column_names=names, skip_rows=1, use_threads=False)
        parsing = pa.csv.ParseOptions(delimiter=mark, newlines_in_values=True)  # of a file's name, e.g.
        found = pa.csv.read_csv(pa.BufferReader(content), reading, parsing, options)
        return found if mark == "," else _with_points(found)
    except MemoryError:  # pyarrow's is one of its own exceptions as well
        raise
    except (UnicodeDecodeError, pa.ArrowException) as problem:
        if "Empty CSV" in str(problem):
            return pa.table({name: pa.array([], pa.string()) for name in names})
        if ("UTF8" in str(problem) or isinstance(problem, UnicodeDecodeError)) and b"\0" not in content:
            with suppress(UnicodeDecodeError):
                return parsed_csv(content.decode("cp1252").encode(), path, needed)
        cure = "; decimals need points, not commas" if "columns, got" in str(problem) else ""
        raise RecordError(f"{cannot(path)}: {first_line(problem)}{cure}") from None


def _with_points(table: pa.Table) -> pa.Table:
    """Write the decimals of texts that are numbers with a point."""
    columns = [
        pa.compute.replace_substring_regex(column, r"^(\s*[+-]?\d*),(\d+(?:[eE][+-]?\d+)?\s*)$", r"\1.\2")
        for column in table.columns
    ]
    return pa.table(columns, table.column_names)


def numbers(path: str | Path, table: pa.Table, name: str) -> Array:
    """Read a column as numbers (n,), NaN where cells are empty."""
    column = table.column(name)
    if not pa.types.is_string(column.type):
        try:
            return np.asarray(column.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)
        except pa.ArrowException:
            raise RecordError(f"{path}: column {name} must be numbers, is {column.type}") from None
    text = np.array([("nan" if not t or not t.strip() else t) for t in column.to_pylist()], dtype=object)
    try:
        return text.astype(np.float64)
    except ValueError:
        for row, cell in enumerate(text, start=1):
            try:
                float(cell)
            except ValueError:
                raise RecordError(
                    f"{path}: {name}, row {row}: {cell.strip()!r} is not a number{decimal_comma(cell)}"
                ) from None
        raise


def _check_pixels(path: str | Path, pixels: Array, names: tuple[str, str], calibration: Calibration) -> None:
    size = np.array([calibration.width_px, calibration.height_px])
    seen = pixels[np.isfinite(pixels).all(axis=-1)]
    if len(seen) > 1 and np.all(np.abs(seen) <= 1.5):
        raise RecordError(
            f"{path}: columns {', '.join(names)}: all within 1.5 of 0; use pixels, not fractions of the picture"
        )
    outside = (pixels < -_MARGIN * size) | (pixels > (1 + _MARGIN) * size)
    for row, axis in np.argwhere(outside)[:1]:
        raise RecordError(
            f"{path}: {names[axis]}, row {row + 1}: {pixels[row, axis]:g} lies outside any picture of "
            f"{calibration.width_px} x {calibration.height_px} pixels"
        )
