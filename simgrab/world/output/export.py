"""A dataset's tables: Parquet, YOLO and COCO, as bytes."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from functools import cache
from pathlib import PurePosixPath
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
from pycocotools import mask as coco_mask

from simgrab.calibration import Calibration
from simgrab.labels import arrays as labels
from simgrab.labels.truth import KEYPOINT_NAMES, SPLITS, Row, Truth, columns
from simgrab.scenario import Scenario
from simgrab.world.output.stored import Record

_YOLO_NEEDS = ("train", "val")
_ARROW = {
    pa.bool_(): ("bool",),
    pa.int64(): ("Index", "Side"),
    pa.float64(): ("Finite", "Length", "Angle"),
    pa.string(): ("str", "Split"),
    pa.list_(pa.float64()): ("Vector", "Corners", "Pose", "Points"),
}


def labels_schema() -> pa.Schema:
    """Arrow schema of ``labels.parquet``; each column's metadata holds its unit and description."""
    return pa.schema(
        [
            pa.field(name, _arrow_type(_kinds()[name]), metadata={"unit": unit, "description": text})
            for name, (unit, text) in columns().items()
        ],
        metadata={"keypoint_names": json.dumps(KEYPOINT_NAMES)},
    )


def _kinds() -> dict[str, str]:
    """Annotation of each column as it is written."""
    return {name: str(kind) for name, kind in (Truth.__annotations__ | Row.__annotations__).items()}


def _arrow_type(annotation: str) -> pa.DataType:
    inner = annotation.removeprefix("Annotated[").lstrip()
    return next(kind for kind, words in _ARROW.items() if inner.startswith(words))


def parquet(rows: Sequence[Row], metadata: dict[str, Any]) -> bytes:
    """Labels as Parquet; ``metadata`` is kept under the schema key ``simgrab``."""
    schema = labels_schema()
    schema = schema.with_metadata({**(schema.metadata or {}), "simgrab": json.dumps(metadata, sort_keys=True)})
    table = pa.Table.from_pylist([msgspec.structs.asdict(row) for row in rows], schema=schema)
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue()


def is_labelled(row: Row, scenario: Scenario) -> bool:
    """Whether detection labels hold a box for the row, by the scenario's least fraction."""
    return labels.is_labelled(row, scenario.labels.least_visible_fraction)


def _box(row: Row) -> tuple[int, int, int, int]:
    box = (row.box_x0_px, row.box_y0_px, row.box_x1_px, row.box_y1_px)
    assert None not in box
    return box  # type: ignore[return-value]


def yolo(row: Row, scenario: Scenario) -> bytes:
    """One frame's YOLO label: ``0 cx cy w h`` in shares of the picture, or nothing."""
    if not is_labelled(row, scenario):
        return b""
    x0, y0, x1, y1 = _box(row)
    w, h = row.width_px, row.height_px
    return f"0 {(x0 + x1) / 2 / w:.8f} {(y0 + y1) / 2 / h:.8f} {(x1 - x0) / w:.8f} {(y1 - y0) / h:.8f}\n".encode()


def filled(rows: Sequence[Row]) -> list[str]:
    """Give the splits that have frames."""
    return [split for split in SPLITS if any(row.split == split for row in rows)]


def yolo_yaml(rows: Sequence[Row]) -> bytes:
    """``data.yaml``; without ``path``, trainers look beside the file itself.

    Trainers need the keys ``train`` and ``val``, and pictures under every key. Without frames, ``test`` is left out,
    and the other two name the folder of another split.
    """
    full = filled(rows)
    lines = []
    for split in SPLITS:
        if split in full:
            lines.append(f"{split}: images/{split}")
        elif split in _YOLO_NEEDS:
            lines += [f"# {split} has no frames, and trainers need some: these are those of {full[0]}."]
            lines += [f"{split}: images/{full[0]}"]
    return "\n".join([*lines, "nc: 1", "names: [grab]", ""]).encode()


def metadata(rows: Sequence[Row], split: str) -> bytes:
    """``metadata.csv`` of one split, as Hugging Face's ``imagefolder`` reads it: ``file_name`` and numbers.

    Its columns are those of ``labels.parquet`` that hold a number, or whether something is so. Where a number may be
    missing, whole ones are written as ``3.0``, so that a reader that infers types infers the same in every split.
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    names = _numbers()
    table.writerow(["file_name", *names])
    for row in rows:
        if row.split == split:
            values = ((getattr(row, name), optional) for name, optional in names.items())
            numbers = (float(v) if optional and v is not None else v for v, optional in values)
            table.writerow([PurePosixPath(row.file).name, *numbers])
    return text.getvalue().encode()


def metadata_name(split: str) -> str:
    """Where a split's ``metadata.csv`` lies in the dataset."""
    return f"images/{split}/metadata.csv"


@cache
def _numbers() -> dict[str, bool]:
    """Columns of one number or truth value each, with whether it may be missing."""
    numbers = (pa.bool_(), pa.int64(), pa.float64())
    return {f.name: "None" in _kinds()[f.name] for f in labels_schema() if f.type in numbers}


def annotation(record: Record) -> dict[str, Any]:
    """One frame's COCO annotation."""
    row = record.truth
    x0, y0, x1, y1 = _box(row)
    return {
        "id": row.frame + 1,
        "image_id": row.frame,
        "category_id": 1,
        "bbox": [x0, y0, x1 - x0, y1 - y0],
        "area": int(coco_mask.area(record.mask)),
        "segmentation": record.mask,
        "iscrowd": 0,
        "keypoints": row.keypoints,
        "num_keypoints": sum(v > 0 for v in row.keypoints[2::3]),
    }


def coco(records: Sequence[Record], split: str, scenario: Scenario) -> bytes:
    """COCO instances of one split, with run-length masks and keypoints.

    Boxes and masks are of the visible grab; keypoints keep simgrab's pixel convention, (0, 0) being the corner of
    the top-left pixel.
    """
    images, annotations = [], []
    for record in records:
        row = record.truth
        if row.split != split:
            continue
        images.append({"id": row.frame, "file_name": row.file, "width": row.width_px, "height": row.height_px})
        if is_labelled(row, scenario):
            annotations.append(annotation(record))
    category = {"id": 1, "name": "grab", "supercategory": "crane", "keypoints": KEYPOINT_NAMES, "skeleton": []}
    info = {"description": f"simgrab {scenario.name}: {scenario.description}", "version": scenario.digest()[:16]}
    return json.dumps(
        {"info": info, "licenses": [], "images": images, "annotations": annotations, "categories": [category]}
    ).encode()


def calibration_of(scenario: Scenario) -> Calibration:
    """Give what an instrument gets to know of the camera: nominal values, never the tilt."""
    camera, k = scenario.camera, scenario.camera.intrinsics
    d = k.distortion
    return Calibration(
        width_px=k.width_px, height_px=k.height_px, focal_length_px=k.f_px, cx_px=k.cx_px, cy_px=k.cy_px,
        k1=d.k1, k2=d.k2, p1=d.p1, p2=d.p2, k3=d.k3,
        offset_m=camera.offset_m, roll_deg=camera.roll_deg, offset_sd_m=0.05,
        display_constant_m=scenario.display.constant_m,
        digit_layout=scenario.display_layout,
    )  # fmt: skip
