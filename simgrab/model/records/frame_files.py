"""The picture files of a finished dataset and their times: the part that may be read without the truth.

Only this module opens a dataset's ``labels.parquet``; other modules read its table, or rows of a type that they pass.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Protocol, TypeVar

import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from simgrab.errors import DatasetError, first_line
from simgrab.io import parquet, pictures
from simgrab.io.parse import cannot, is_dir, is_file, opened, read_bytes

LABELS = "labels.parquet"
_CONVERTED_TOGETHER = 1024  # rows of which plain data are made at once
_Index = Annotated[int, msgspec.Meta(ge=0, le=2**53)]


class FrameFile(msgspec.Struct, frozen=True):
    """One frame's picture file; the columns of the same names in ``labels.parquet``."""

    frame: _Index
    file: str  # relative to the dataset
    clip: _Index | None
    # time within the clip; None, like `clip`, for independent frames
    time_s: Annotated[float, msgspec.Meta(ge=-1e12, le=1e12)] | None
    image_sha256: str  # SHA-256 of the file


class PictureRow(Protocol):
    """A row that names a picture file: a `FrameFile`, or a whole row of labels."""

    @property
    def frame(self) -> int: ...  # noqa: D102
    @property
    def file(self) -> str: ...  # noqa: D102
    @property
    def clip(self) -> int | None: ...  # noqa: D102
    @property
    def time_s(self) -> float | None: ...  # noqa: D102
    @property
    def image_sha256(self) -> str: ...  # noqa: D102


T = TypeVar("T", bound=msgspec.Struct)


def is_dataset(path: Path) -> bool:
    """Whether a folder is a dataset, finished or not, and not just a folder of pictures.

    Raises `DatasetError` if that cannot be determined, because the name is too long or the folder may not be searched.
    """
    return is_file(path / LABELS, DatasetError) or is_dir(path / ".partial", DatasetError)


def read(path: Path) -> tuple[tuple[FrameFile, ...], str]:
    """List a finished dataset's picture files, by frame, with the SHA-256 of its ``labels.parquet``.

    Raises `DatasetError` if the folder is not a dataset, or is unfinished, empty, or lacks a picture.
    """
    rows, _, digest = read_rows(path, FrameFile)
    check_files(path, rows)
    return rows, digest


def read_rows(path: Path, kind: type[T]) -> tuple[tuple[T, ...], pa.Schema, str]:
    """Read ``labels.parquet`` as rows of a type. Only the type's columns are read; the type may forbid others.

    Returns
    -------
    rows : tuple
    schema : pyarrow.Schema
        Schema of the columns that were read.
    digest : str
        SHA-256 of the file.
    """
    strict = kind.__struct_config__.forbid_unknown_fields
    table, digest = read_labels(path, None if strict else kind.__struct_fields__)
    return tuple(converted(table, kind, path)), table.schema, digest


def read_labels(path: Path, columns: Sequence[str] | None = None) -> tuple[pa.Table, str]:
    """Read ``labels.parquet``, or some of its columns, with the SHA-256 of the file.

    Raises `DatasetError` if the folder is not a finished dataset, or the file cannot be read.
    """
    file = path / LABELS
    if not is_file(file, DatasetError):
        state = "unfinished; continue with simgrab render --resume" if (path / ".partial").exists() else "not a dataset"
        if is_dir(path / "shards", DatasetError):
            state = "a dataset of shards, of which simgrab export --format simgrab makes a folder"
        raise DatasetError(f"{path} is {state}: it has no {LABELS}")
    with opened(file, DatasetError, most_bytes=parquet.MOST_BYTES) as handle:
        table = parquet.parse_table(handle, DatasetError, cannot(file), columns)
        handle.seek(0)
        return table, hashlib.file_digest(handle, "sha256").hexdigest()


def converted(table: pa.Table, kind: type[T], path: Path) -> Iterator[T]:
    """Make rows of a type from the labels of a dataset in a folder, few at a time.

    Raises `DatasetError` if a row holds values that the type refuses.
    """
    for start in range(0, table.num_rows, _CONVERTED_TOGETHER):
        plain = parquet.rows(table.slice(start, _CONVERTED_TOGETHER), DatasetError, cannot(path / LABELS))
        try:
            rows = msgspec.convert(plain, list[kind])  # type: ignore[valid-type]
        except (ValueError, LookupError, TypeError) as problem:
            why = f"{type(problem).__name__}: {_renumbered(first_line(problem), start)}"
            raise DatasetError(f"{path}: not a simgrab dataset ({why})") from None
        yield from rows


def _renumbered(text: str, start: int) -> str:
    """Name the row of an error line by its index among all rows: the line is about those from ``start`` on."""
    return re.sub(r"(?<=\$\[)\d+", lambda at: str(start + int(at[0])), text, count=1)


def check_files(path: Path, rows: Sequence[PictureRow]) -> None:
    """Refuse rows that are out of order, and files that are missing or lie elsewhere.

    A file may be a link out of the dataset if its digest is that of the labels: whoever knows the digest already knows
    the file.
    """
    if not rows:
        raise DatasetError(f"{path}: no frames in {LABELS}")
    _check_order(path, rows)
    folder = os.path.realpath(path)
    for row in rows:
        if os.path.isabs(row.file) or os.path.normpath(row.file).startswith(".."):  # noqa: PTH117
            raise DatasetError(f"{path}: frame {row.frame} names the image {row.file}, which is not in the dataset")
        if not is_file(path / row.file, DatasetError):
            raise DatasetError(f"{path}: frame {row.frame} has labels but no image; {row.file} is missing")
        if os.path.commonpath([folder, os.path.realpath(path / row.file)]) != folder:
            content(path / row.file, row)


def _check_order(path: Path, rows: Sequence[PictureRow]) -> None:
    """Refuse rows that are not in the order of their frames and, within a clip, of their times."""
    for row in rows:
        if len({row.clip is None, row.time_s is None, rows[0].clip is None}) > 1:
            raise DatasetError(f"{path}: frame {row.frame}: clip and time_s must be given in every frame or in none")
    for before, row in pairwise(rows):
        if row.frame <= before.frame:
            raise DatasetError(f"{path}: frame {row.frame} comes after frame {before.frame}; they must increase")
        if before.clip is None or row.clip is None or before.time_s is None or row.time_s is None:
            continue
        if (row.clip, row.time_s) <= (before.clip, before.time_s):
            raise DatasetError(
                f"{path}: frame {row.frame}: clip {row.clip}, time_s {row.time_s:g} comes after clip {before.clip}, "
                f"time_s {before.time_s:g}; they must increase"
            )


def picture(file: Path, row: PictureRow) -> NDArray[np.uint8]:
    """Decode the picture of a row after checking its SHA-256: RGB, uint8, shape (height, width, 3).

    Raises `DatasetError` if it cannot be read, or is not the labels' picture.
    """
    return pictures.decode(content(file, row), file)


def content(file: Path, row: PictureRow) -> bytes:
    """Read a row's picture file; raises `DatasetError` if it cannot be read, or is not the labels' picture."""
    return sound(read_bytes(file, DatasetError, most_bytes=pictures.MOST_BYTES), row, file)


def sound(data: bytes, row: PictureRow, where: object) -> bytes:
    """Refuse the bytes of a picture file if their digest differs from the labels'; the error line names ``where``."""
    if hashlib.sha256(data).hexdigest() != row.image_sha256:
        raise DatasetError(f"{where} does not match the digest in its labels: it was changed or damaged")
    return data
