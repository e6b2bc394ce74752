"""The truth table of a video: one row for each picture in it."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from simgrab.dataset.tables import labels_schema, with_identity
from simgrab.model.truth import Truth

ROWS_AT_ONCE = 500


def schema() -> pa.Schema:
    """Arrow schema: what the picture is within the video, then what is known of the frame that it shows.

    The columns of ``labels.parquet`` that speak of picture files give way to ``rgb_sha256``: the table lies beside its
    video, and is the same whatever they are called.
    """
    labels = labels_schema()
    own = [
        _field("sent", pa.int64(), "", "index of the picture within the video, from 0"),
        _field("pts_s", pa.float64(), "s", "its time stamp in the video, with jitter"),
        _field("repeated", pa.bool_(), "", "whether the picture before was sent again, for want of this instant's"),
        _field("due_s", pa.float64(), "s", "time within the clip of the instant in whose place it was sent"),
        _field("rgb_sha256", pa.string(), "", "digest of the picture before coding: 8-bit rgb, row by row"),
    ]
    known = [field for field in labels if field.name not in ("file", "image_sha256")]
    return pa.schema([*own, *(_for_clips(field) for field in known)], metadata=labels.metadata)


def _field(name: str, kind: pa.DataType, unit: str, text: str) -> pa.Field:
    return pa.field(name, kind, metadata={"unit": unit, "description": text})


def _for_clips(field: pa.Field) -> pa.Field:
    text = {
        "frame": "index within the scenario of the frame that the picture shows",
        "clip": "index of the clip",
        "time_s": "time within the clip of the instant at which everything in this row holds",
    }.get(field.name)
    return field if text is None else _field(field.name, field.type, field.metadata[b"unit"].decode(), text)


class Table:
    """Writes the table as rows come, a few hundred at a time. Use as a context manager.

    Parameters
    ----------
    path : Path
    metadata : dict
        Kept under the schema key ``simgrab``.
    """

    def __init__(self, path: Path, metadata: dict[str, Any]) -> None:
        self._schema = with_identity(schema(), metadata)
        self._file = path.open("wb")
        self._writer = pq.ParquetWriter(self._file, self._schema, compression="zstd")
        self._rows: list[dict[str, Any]] = []

    def __enter__(self) -> Table:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            if kind is None:
                self._flush()
        finally:
            with self._file:
                self._writer.close()

    def add(self, truth: Truth, **own: Any) -> None:
        """Add a picture: what it shows, and its own columns."""
        self._rows.append(msgspec.structs.asdict(truth) | own)
        if len(self._rows) == ROWS_AT_ONCE:
            self._flush()

    def _flush(self) -> None:
        self._writer.write_table(pa.Table.from_pylist(self._rows, schema=self._schema))
        self._rows.clear()
