"""The truth table of a video: one row for each picture in it."""

from __future__ import annotations

import pyarrow as pa

from simgrab.dataset.tables import column, labels_schema

GROUP_ROWS = 500


def schema() -> pa.Schema:
    """Arrow schema: columns of the picture in the video, then the labels of the frame it shows.

    ``rgb_sha256`` replaces the columns of ``labels.parquet`` that name picture files, so that the table does not depend
    on file names.
    """
    labels = labels_schema()
    own = [
        column("sent", pa.int64(), "", "index of the picture within the video, from 0"),
        column("pts_s", pa.float64(), "s", "its time stamp in the video, with jitter"),
        column("repeated", pa.bool_(), "", "whether the picture before was sent again, for want of this instant's"),
        column("due_s", pa.float64(), "s", "time within the clip of the instant in whose place it was sent"),
        column("rgb_sha256", pa.string(), "", "digest of the picture before coding: 8-bit rgb, row by row"),
    ]
    known = [field for field in labels if field.name not in ("file", "image_sha256")]
    return pa.schema([*own, *(_for_clips(field) for field in known)], metadata=labels.metadata)


def _for_clips(field: pa.Field) -> pa.Field:
    text = {
        "frame": "index within the scenario of the frame that the picture shows",
        "clip": "index of the clip",
        "time_s": "time within the clip of the instant at which everything in this row holds",
    }.get(field.name)
    return field if text is None else column(field.name, field.type, field.metadata[b"unit"].decode(), text)
