"""A dataset in a folder, whose labels are not checked as `simgrab.open` does. An unfinished one too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa

from simgrab.dataset import datasets
from simgrab.dataset.datasets import MANIFEST, Dataset, FolderFiles, FolderRows
from simgrab.dataset.record import MOST_RECORD_BYTES, FrameRecord
from simgrab.dataset.tables import labels_schema, table_of
from simgrab.errors import DatasetError, first_line
from simgrab.io.journal import IDENTITY, PARTIAL, ROWS
from simgrab.io.parse import is_dir, is_file, read_bytes, read_json
from simgrab.io.stores import Store
from simgrab.model.masks import Coded, Masks
from simgrab.model.records import frame_files
from simgrab.model.records.frame_files import LABELS
from simgrab.model.truth import Row
from simgrab.pages.browse import columns
from simgrab.pages.browse.subject import Order, Subject

VARIED = "varied."
SHOWN = ("alpha_deg", "rope_length_m", "visible_fraction", "distance_m", "split", "labelled")
_FACTORS = ("weather", "place", "grab")


def open(path: Path) -> Subject:
    """Open a dataset to browse it; raises `DatasetError` if it is none, or its labels cannot be read."""
    if is_file(path / MANIFEST, DatasetError) and is_file(path / LABELS, DatasetError):
        labels, whole, notes = read(path)
        return _subject(labels, whole.least_visible_fraction, notes, whole)
    if is_dir(path / PARTIAL, DatasetError):
        return _unfinished(path)
    if is_dir(path / "shards", DatasetError):
        raise DatasetError(f"{path} is a dataset of shards; simgrab export --format simgrab makes a folder of it")
    if is_file(path / LABELS, DatasetError):
        raise DatasetError(f"{path}: not a simgrab dataset: it has no {MANIFEST}")
    raise DatasetError(f"{path}: neither a dataset nor a run: it has neither {LABELS} nor angles.parquet")


def read(path: Path) -> tuple[FolderRows, Dataset, tuple[str, ...]]:
    """Read a finished dataset, without checking values of its labels and files of its pictures.

    Returns
    -------
    labels : FolderRows
    dataset : Dataset
        Of these labels.
    notes : tuple of str
        That the labels are not those that the manifest was written for.

    Raises
    ------
    DatasetError
    """
    known = datasets.named(read_json(path / MANIFEST, DatasetError), path)
    table, digest = frame_files.read_labels(path)
    labels = FolderRows(_cast(table, path), FolderFiles(path, Masks(path).coded))
    changed = known.files.get(LABELS, digest) != digest
    notes = (f"{LABELS} does not match the digest in the manifest: it was changed or damaged",) if changed else ()
    return labels, datasets.of_rows(Store(str(path)), known, digest, labels), notes


def _unfinished(path: Path) -> Subject:
    """Read the frames that are finished; a record that is damaged is left out and counted."""
    identity = read_json(path / PARTIAL / IDENTITY, DatasetError)
    try:
        total, name = int(identity["frames"]), str(identity["scenario"]["name"])
        least = float(identity["scenario"]["labels"]["least_visible_fraction"])
    except (LookupError, TypeError, ValueError, OverflowError) as problem:
        raise DatasetError(f"{path}: not an unfinished simgrab dataset ({first_line(problem)})") from None
    rows, masks, damaged = list[Row](), dict[int, Coded](), 0
    for record in sorted((path / PARTIAL / ROWS).glob("*.json")):
        try:
            one = msgspec.json.decode(read_bytes(record, DatasetError, most_bytes=MOST_RECORD_BYTES), type=FrameRecord)
        except (ValueError, RecursionError, DatasetError):
            damaged += 1
        else:
            rows.append(one.truth)
            masks[one.truth.frame] = one.mask
    if not rows:
        raise DatasetError(f"{path} is unfinished, and no frame of it is there; continue with simgrab render --resume")
    labels = FolderRows(table_of(rows), FolderFiles(path, lambda row: masks[row.frame]))
    notes = [f"unfinished: {len(rows)} of {total} frames of {name} are there; simgrab render --resume goes on"]
    notes += [f"{damaged} records are damaged and not shown"] if damaged else []
    return _subject(labels, least, tuple(notes))


def _cast(table: pa.Table, path: Path) -> pa.Table:
    """Give a table the types that labels have."""
    schema = labels_schema()
    if sorted(table.column_names) != sorted(schema.names):
        lacks = sorted({*schema.names} - {*table.column_names}) or ["columns of their own"]
        raise DatasetError(f"{path / LABELS}: not labels of simgrab (they lack {lacks[0]})")
    try:
        made = table.select(schema.names).cast(schema)
    except MemoryError:
        raise
    except (pa.ArrowException, ValueError) as problem:
        raise DatasetError(f"{path / LABELS}: not labels of simgrab ({first_line(problem)})") from None
    if not made.num_rows:
        raise DatasetError(f"{path}: no frames in {LABELS}")
    if made["frame"].null_count or (np.diff(made["frame"].to_numpy()) <= 0).any():
        raise DatasetError(f"{path / LABELS}: frames must increase from row to row")
    return made


def _subject(labels: FolderRows, least: float, notes: tuple[str, ...], whole: Dataset | None = None) -> Subject:
    table, name = with_derived(labels.table, least), str(labels.files.folder)
    return Subject(name, "dataset", notes, table, Order("frame"), (*SHOWN, *factors(table)), labels, whole)


def with_derived(table: pa.Table, least: float) -> pa.Table:
    """Add what labels imply: whether a box is labelled, and each factor of what varied."""
    seen = np.isfinite(columns.numbers(table["box_x0_px"]))
    labelled = seen & (columns.numbers(table["visible_fraction"]) >= least)
    table = table.append_column(field("labelled", pa.bool_(), "whether detection labels hold a box"), [labelled])
    for name, values in columns.expanded(table["varied"], VARIED):
        table = table.append_column(field(name, values.type, "what varied within the dataset"), values)
    return table


def factors(table: pa.Table, prefix: str = "") -> list[str]:
    """Name the columns of what varies most: weather, place and grab, alone or together with something else."""
    before = f"{prefix}{VARIED}"
    named = [name for name in table.column_names if name.startswith(before)]
    return [name for factor in _FACTORS for name in named if factor in name.removeprefix(before).split("+")]


def field(name: str, kind: pa.DataType, text: str, unit: str = "") -> pa.Field:
    """Describe a column that labels do not have."""
    about: dict[str | bytes, Any] = {"unit": unit, "description": text}
    return pa.field(name, kind, metadata=about)
