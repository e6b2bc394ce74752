"""A dataset's tables, Parquet, YOLO and COCO, written row by row."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, TextIO, get_args, get_origin, get_type_hints

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pycocotools import mask as coco_mask

from simgrab.dataset import card, manifest, preview, yolo
from simgrab.dataset.datasets import MANIFEST
from simgrab.dataset.summary import Tally
from simgrab.io import models
from simgrab.io.stores import Store
from simgrab.model import label_arrays as arrays
from simgrab.model.calibration import Calibration
from simgrab.model.masks import Coded, coco_name
from simgrab.model.records.frame_files import LABELS
from simgrab.model.scenario import Scenario
from simgrab.model.truth import KEYPOINT_NAMES, SPLITS, Row, columns
from simgrab.runtime.versions import Fingerprint

_GROUP_ROWS = 1024  # of a Parquet table, in memory at once
_SPOOLED = 2**20  # bytes of annotations in memory
_NUMBERS = {bool: pa.bool_(), int: pa.int64(), float: pa.float64()}
_ARROW = _NUMBERS | {str: pa.string(), tuple: pa.list_(pa.float64())}


def column(name: str, kind: pa.DataType, unit: str, text: str) -> pa.Field:
    """Arrow field of a column, whose metadata holds its unit and description."""
    return pa.field(name, kind, metadata={"unit": unit, "description": text})


def labels_schema() -> pa.Schema:
    """Arrow schema of ``labels.parquet``."""
    kinds = _kinds()
    fields = [column(name, _ARROW[kinds[name][0]], unit, text) for name, (unit, text) in columns().items()]
    return pa.schema(fields, metadata={"keypoint_names": json.dumps(KEYPOINT_NAMES)})


def table_of(rows: Iterable[Row | None]) -> pa.Table:
    """Make the table of rows of labels; null where a row is None."""
    plain = [{} if row is None else msgspec.structs.asdict(row) for row in rows]
    return pa.Table.from_pylist(plain, schema=labels_schema())


def with_identity(schema: pa.Schema, identity: dict[str, Any]) -> pa.Schema:
    """Keep a dataset's identity in its schema, under the key ``simgrab``."""
    return schema.with_metadata({**schema.metadata, "simgrab": json.dumps(identity, sort_keys=True)})


@cache
def _kinds() -> dict[str, tuple[type, bool]]:
    """Type of each column of labels, a key of `_ARROW`, and whether values may be missing."""
    hints = {name: (hint, *get_args(hint)) for name, hint in get_type_hints(Row).items()}
    return {
        name: (next(kind for one in known if (kind := get_origin(one) or one) in _ARROW), type(None) in known)
        for name, known in hints.items()
    }


def is_labelled(row: Row, scenario: Scenario) -> bool:
    """Whether detection labels hold a box for the row, by the scenario's least fraction."""
    return arrays.is_labelled(row, scenario.labels.least_visible_fraction)


class Metadata:
    """``metadata.csv`` of one split, as Hugging Face's ``imagefolder`` reads it: ``file_name`` and numbers.

    Its columns are the numbers and truth values of ``labels.parquet``. In a column where numbers may be missing, whole
    numbers are written as ``3.0``, so that readers infer the same type for every split.
    """

    def __init__(self, file: TextIO) -> None:
        self._table = csv.writer(file, lineterminator="\n")
        self._table.writerow(["file_name", *_numbers()])

    def add(self, row: Row) -> None:
        """Write a row."""
        values = ((getattr(row, name), optional) for name, optional in _numbers().items())
        numbers = (float(v) if optional and v is not None else v for v, optional in values)
        self._table.writerow([PurePosixPath(row.file).name, *numbers])


def metadata(rows: Iterable[Row], split: str) -> bytes:
    """``metadata.csv`` of one split."""
    text = io.StringIO()
    table = Metadata(text)
    for row in rows:
        if row.split == split:
            table.add(row)
    return text.getvalue().encode()


def metadata_name(split: str) -> str:
    """Path of a split's ``metadata.csv`` in the dataset."""
    return f"images/{split}/metadata.csv"


@cache
def _numbers() -> dict[str, bool]:
    """Columns of one number or truth value each, with whether it may be missing."""
    kinds = _kinds()
    return {name: kinds[name][1] for name in columns() if kinds[name][0] in _NUMBERS}


def annotation(row: Row, mask: Coded) -> dict[str, Any]:
    """One frame's COCO annotation; ``mask`` is the visible grab."""
    box, segmentation = arrays.box(row), msgspec.structs.asdict(mask)
    assert box is not None
    x0, y0, x1, y1 = map(int, box)
    return {
        "id": row.frame + 1,
        "image_id": row.frame,
        "category_id": 1,
        "bbox": [x0, y0, x1 - x0, y1 - y0],
        "area": int(coco_mask.area(segmentation)),
        "segmentation": segmentation,
        "iscrowd": 0,
        "keypoints": row.keypoints,
        "num_keypoints": sum(v > 0 for v in row.keypoints[2::3]),
    }


class Coco:
    """COCO instances of one split, with run-length masks and keypoints.

    Boxes and masks are of the visible grab; keypoints keep simgrab's pixel convention, (0, 0) being the corner of
    the top-left pixel.
    """

    def __init__(self, file: TextIO, scenario: Scenario) -> None:
        self._file, self._scenario = file, scenario
        self._annotations = tempfile.SpooledTemporaryFile(_SPOOLED, "w+", encoding="utf-8")  # noqa: SIM115
        self._images = self._labelled = 0
        info = {"description": f"simgrab {scenario.name}: {scenario.description}", "version": scenario.digest()[:16]}
        licence = {"id": 1, "name": card.licence(scenario), "url": "https://www.apache.org/licenses/LICENSE-2.0"}
        file.write(json.dumps({"info": info, "licenses": [licence]})[:-1] + ', "images": [')

    def add(self, row: Row, mask: Coded | None) -> None:
        """Write a frame, and its annotation where detection labels hold a box."""
        image = {"id": row.frame, "file_name": row.file, "width": row.width_px, "height": row.height_px, "license": 1}
        self._file.write(", " * (self._images > 0) + json.dumps(image))
        self._images += 1
        if mask is not None and is_labelled(row, self._scenario):
            self._annotations.write(", " * (self._labelled > 0) + json.dumps(annotation(row, mask)))
            self._labelled += 1

    def close(self) -> None:
        """Complete the file."""
        self._file.write('], "annotations": [')
        self._annotations.seek(0)
        shutil.copyfileobj(self._annotations, self._file)
        self._annotations.close()
        category = {"id": 1, "name": "grab", "supercategory": "crane", "keypoints": KEYPOINT_NAMES, "skeleton": []}
        self._file.write("], " + json.dumps({"categories": [category]})[1:])


class LabelWriter:
    """``labels.parquet``, or a table of the same columns and more; a row group of ``group_rows`` is kept in memory."""

    def __init__(self, file: BinaryIO, schema: pa.Schema, group_rows: int = _GROUP_ROWS) -> None:
        self._group_rows = group_rows
        self._writer, self._schema = pq.ParquetWriter(file, schema, compression="zstd"), schema
        self._rows: list[dict[str, Any]] = []

    def add(self, row: dict[str, Any]) -> None:
        """Add a row; a row group is written when it is full."""
        self._rows.append(row)
        if len(self._rows) == self._group_rows:
            self._flush()

    def _flush(self) -> None:
        self._writer.write_table(pa.Table.from_pylist(self._rows, schema=self._schema))
        self._rows.clear()

    def close(self) -> None:
        """Complete the file."""
        if self._rows:
            self._flush()
        self._writer.close()


Add = Callable[[Row, Coded | None], None]
"""Takes a row, and the mask of the visible grab where it is labelled."""
Writing = Callable[[str], AbstractContextManager[Path]]
"""Gives a path to write to for a file of the dataset, which takes its name when the context is left."""


def into(folder: Path) -> Writing:
    """Write files below a folder directly, without drafts."""

    @contextmanager
    def writing(name: str) -> Iterator[Path]:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        yield path

    return writing


@contextmanager
def tables_of(
    store: Store,
    core: dict[str, Any],
    scenario: Scenario,
    kind: str | None = None,
    coco: Collection[str] = SPLITS,
    *,
    metadata: bool = True,
) -> Iterator[Add]:
    """Write tables, frame by frame in order, with few frames in memory: by default those of a dataset of files.

    Parameters
    ----------
    core : dict
        The dataset's identity, which is kept in ``labels.parquet`` under the schema key ``simgrab``.
    kind : str, optional
        Kind of YOLO's label files, beside which ``data.yaml`` is written; the scenario's unless given, none if empty.
    coco : collection of str
        Splits that get a COCO file.
    metadata : bool
        Whether splits get a ``metadata.csv``.
    """
    kind = scenario.labels.yolo if kind is None else kind
    with ExitStack() as stack:

        def text(name: str) -> TextIO:
            path = stack.enter_context(store.writing(name))
            return stack.enter_context(path.open("w", encoding="utf-8", newline=""))

        binary = stack.enter_context(stack.enter_context(store.writing(LABELS)).open("wb"))
        labels = stack.enter_context(closing(LabelWriter(binary, with_identity(labels_schema(), core))))
        instances = {split: stack.enter_context(closing(Coco(text(coco_name(split)), scenario))) for split in coco}
        tables: dict[str, Metadata | None] = {}

        def add(row: Row, mask: Coded | None) -> None:
            labels.add(msgspec.structs.asdict(row))
            if row.split in instances:
                instances[row.split].add(row, mask)
            if row.split not in tables:
                tables[row.split] = Metadata(text(metadata_name(row.split))) if metadata else None
            if table := tables[row.split]:
                table.add(row)
            if kind:
                store.write(yolo.name(row), yolo.label(row, mask, scenario, kind))

        yield add
        if kind:
            store.write("data.yaml", yolo.data_yaml([split for split in SPLITS if split in tables], kind))


@dataclass(frozen=True)
class Contents:
    """What the files are made from that describe a dataset."""

    core: dict[str, Any]  # see `simgrab.dataset.manifest.identity`
    scenario: Scenario
    rendered_by: Fingerprint
    tiles: Iterable[tuple[NDArray[np.uint8], Row]]  # frames of the contact sheet, BGR
    tally: Tally  # of all frames
    layout: str = "simgrab"  # a format of `simgrab.dataset.export`


def finish(store: Store, contents: Contents, digests: dict[str, str]) -> None:
    """Describe a dataset of files, after frames and tables; ``digests`` are of its sensors' files."""
    if store.folder is not None:
        for split in SPLITS:  # a split may be empty; a trainer still looks for its folder
            (store.folder / "images" / split).mkdir(parents=True, exist_ok=True)
    names = LABELS, "data.yaml", *map(coco_name, SPLITS), *map(metadata_name, contents.tally.full)
    describe(store, contents, digests | {name: store.sha256(name) for name in names})


def describe(store: Store, contents: Contents, digests: dict[str, str]) -> None:
    """Write the contact sheet, the camera file, copies of users' own grabs, the card, and the manifest, which is last.

    ``digests`` are the SHA-256 of other files by name. The manifest has none of the card, which may be edited.
    """
    core, scenario = contents.core, contents.scenario
    files = {preview.NAME: preview.of(contents.tiles)} | beside(scenario)
    for name, data in (files | {card.NAME: card.of(scenario, core, contents.tally, contents.layout)}).items():
        store.write(name, data)
    digests = digests | {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    store.write(MANIFEST, manifest.compose(core, contents.rendered_by, digests))


def beside(scenario: Scenario) -> dict[str, bytes]:
    """Write the files beside the labels of every dataset, by name: the camera file, and copies of users' own grabs."""
    found = {"camera.toml": calibration_of(scenario).to_toml().encode()}
    for model in scenario.models:
        found |= {f"{models.copied(model.sha256)}/{name}": data for name, data in model.files.items()}
    return found


def calibration_of(scenario: Scenario) -> Calibration:
    """Return the camera as the instrument may know it: nominal values, never the tilt."""
    camera, k = scenario.camera, scenario.camera.intrinsics
    d = k.distortion
    return Calibration(
        width_px=k.width_px, height_px=k.height_px, focal_length_px=k.f_px, cx_px=k.cx_px, cy_px=k.cy_px,
        k1=d.k1, k2=d.k2, p1=d.p1, p2=d.p2, k3=d.k3,
        offset_m=camera.offset_m, roll_deg=camera.roll_deg, offset_sd_m=0.05,
        mount=camera.mount.__struct_config__.tag,  # type: ignore[arg-type]  # of one of its kinds
        display_constant_m=scenario.display.constant_m,
        digit_layout=scenario.display_layout,
    )  # fmt: skip
