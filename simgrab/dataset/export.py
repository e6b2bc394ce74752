"""Write a dataset in the layout of another tool: what `simgrab export` does."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import itertools
import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from simgrab.dataset import preview, sensor_files, shards, tables
from simgrab.dataset import shard_reader as sharded
from simgrab.dataset.card import HF_SPLITS
from simgrab.dataset.datasets import MANIFEST, Dataset, LabelledFrame, buffer_names, named
from simgrab.dataset.shards import Packed
from simgrab.dataset.summary import Summary, Tally
from simgrab.dataset.tables import Contents, LabelWriter
from simgrab.errors import DatasetError
from simgrab.io import files
from simgrab.io.destination import check_new_folder, writing
from simgrab.io.stores import Store, is_url
from simgrab.model.truth import Row

Progress = Callable[[int, int], None]
Frames = Iterator[LabelledFrame]

MOST_SENSOR_BYTES = 2**31
OCCLUDED = 0.1  # share of the part in the picture that is hidden, from which a grab counts as occluded
_HF_GROUP_ROWS = 64  # pictures and all, in memory at once


@dataclass(frozen=True)
class ExportSource:
    """A dataset that is exported, and what its export is described by.

    ``shard_frames`` are those of each file that contains several. ``sensors`` are the SHA-256 of its sensor files by
    name, which every format includes.
    """

    dataset: Dataset
    contents: Contents
    shard_frames: int
    sensors: dict[str, str]


def export(
    dataset: str | Path | Dataset,
    out: str | Path,
    *,
    format: str,
    shard_frames: int | None = None,
    progress: Progress | None = None,
    part: bool = False,
    leave_out_hidden: bool = False,
) -> Summary:
    """Write a finished dataset, or a part of one, in the layout of another tool.

    Every format includes all labels of each frame, in ``labels.parquet`` or beside its picture, and the files of the
    scene's sensors.

    Parameters
    ----------
    dataset : str, Path or Dataset
        A place that `simgrab.open` takes, or the dataset that it returned.
    out : str or Path
        New folder, which appears complete or not at all; or a URL with no files below it, where an export without
        ``manifest.json`` is unfinished.
    format : str
        ``yolo``, ``yolo-pose``, ``yolo-seg``, ``yolo-obb``: images, text labels (boxes, key points, polygons of the
        masks, oriented boxes) and ``data.yaml``. ``coco``: images and instances as JSON. ``voc``: Pascal VOC's
        XML. ``webdataset``: the shards that `simgrab.render` writes below a URL. ``hf``: Parquet files with pictures
        and a card, for Hugging Face ``datasets``. ``simgrab``: the files that `simgrab.render` writes into a folder.
    shard_frames : int, optional
        Frames of each shard or Parquet file; 256 unless given.
    progress : callable, optional
        Called with (frames done, frames in all).
    part : bool
        Accept a part of a dataset in a folder, such as a split or a slice. Frames keep their numbers and their order.
        The manifest states under ``selection`` the number of frames of the whole dataset, and the digest of its labels.
        Not with ``webdataset``, whose shards are found by the numbers of their frames.
    leave_out_hidden : bool
        Leave out frames that show some of the grab, but less than ``labels.least_visible_fraction``, which detectors
        would take for background. What remains is such a part.

    Returns
    -------
    Summary
        Of the frames that were written; ``made`` is 0.

    Raises
    ------
    DatasetError
        If the format is not known, the dataset cannot be read, or the place cannot be used.
    """
    if format not in FORMATS:
        raise DatasetError(f"no format {format!r}; one of: {', '.join(FORMATS)}")
    if (part or leave_out_hidden) and format == "webdataset":
        raise DatasetError("a part of a dataset cannot be exported as webdataset; choose another format")
    if is_url(out):
        if Store(str(out)).names():
            raise DatasetError(f"{out} is not empty; choose another --out")
    else:
        check_new_folder(Path(out), DatasetError)
    opened = dataset if isinstance(dataset, Dataset) else sharded.open(dataset)
    source = _source(opened, shard_frames, format, part=part, leave_out_hidden=leave_out_hidden)
    about = source.contents
    summary = Summary.of(out, about.tally, about.scenario, 0, about.rendered_by.digest)
    if is_url(out):
        _write(source, Store(str(out)), progress)
        return summary
    with writing(out, DatasetError), files.drafted_folder(Path(out).absolute()) as draft:
        _write(source, Store(str(draft)), progress)
    return summary


def _source(
    dataset: Dataset, shard_frames: int | None, format: str, *, part: bool, leave_out_hidden: bool
) -> ExportSource:
    if not dataset.is_whole:
        if not part:
            raise DatasetError("a part of a dataset cannot be exported without part=True")
        _check_part(dataset)
    if leave_out_hidden and not (dataset := dataset.without_hidden()):
        raise DatasetError("no frame is left: all show less of the grab than labels.least_visible_fraction")
    known, where = dataset.manifest, f"{dataset.store.place}/{MANIFEST}"
    about = named(known, where)
    core = {key: known[key] for key in known if key not in ("renderer", "files", "manifest_digest", "shards")}
    if not dataset.is_whole:
        core = {key: core[key] for key in core if key != "clamped"} | {"frames": len(dataset)}
        core["selection"] = {"of_frames": dataset.data.frames, "labels_sha256": dataset.data.labels_sha256}
    scenario = dataset.scenario
    varies = bool(scenario.vary) or any(one.role == "randomiser" for one in about.extensions.functions)
    each = shards.frames_of(scenario, shard_frames, varies=varies)
    carried = {name: about.files.get(name, "") for name in sensor_files.names(scenario)}
    if missing := [name for name, digest in carried.items() if not digest]:
        raise DatasetError(f"{where}: it lists no {missing[0]}, which the scenario's sensors have")
    tally = functools.reduce(Tally.__add__, (Tally.of([frame.truth], scenario) for frame in dataset), Tally())
    contents = Contents(core, scenario, about.renderer, preview.tiles(dataset), tally, format)
    return ExportSource(dataset, contents, each, carried)


def _check_part(dataset: Dataset) -> None:
    if "shards" in dataset.manifest:
        raise DatasetError("a part of a dataset of shards cannot be exported: export the whole as simgrab first")
    numbers = [frame.truth.frame for frame in dataset]
    if not numbers or numbers != sorted(set(numbers)):
        raise DatasetError("a part must contain frames, in the order of the dataset")


def _write(source: ExportSource, store: Store, progress: Progress | None) -> None:
    for name, digest in source.sensors.items():
        data = source.dataset.store.read(name, most_bytes=MOST_SENSOR_BYTES)
        if hashlib.sha256(data).hexdigest() != digest:
            raise DatasetError(f"{source.dataset.store.place}: {name} was changed since it was written")
        store.write(name, data)
    FORMATS[source.contents.layout](source, store, _counted(source.dataset, progress))


def _counted(dataset: Dataset, progress: Progress | None) -> Iterator[LabelledFrame]:
    for done, frame in enumerate(dataset, 1):
        yield frame
        if progress:
            progress(done, len(dataset))


@contextlib.contextmanager
def _tables(source: ExportSource, store: Store, kind: str = "", coco: Collection[str] = ()) -> Iterator[tables.Add]:
    """Write tables, and at the end what describes the dataset; the manifest comes last."""
    about = source.contents
    with tables.tables_of(store, about.core, about.scenario, kind, coco, metadata=False) as add:
        yield add
    tables.describe(store, about, source.sensors)


def _pictures(source: ExportSource, store: Store, frames: Frames, *, kind: str = "", coco: bool = False) -> None:
    """Write pictures as files, and YOLO's label files of a kind, or COCO's annotations."""
    with _tables(source, store, kind, source.dataset.splits if coco else ()) as write:
        for frame in frames:
            store.write(frame.truth.file, frame.content)
            try:
                write(frame.truth, frame.coded_mask if coco or kind == "seg" else None)
            except ValueError as problem:  # of labels that contradict each other
                raise DatasetError(f"{source.dataset.store.place}: frame {frame.truth.frame}: {problem}") from None


def _voc(source: ExportSource, store: Store, frames: Frames) -> None:
    names: dict[str, list[str]] = {split: [] for split in source.dataset.splits}
    with _tables(source, store) as write:
        for frame in frames:
            row, stem = frame.truth, f"{frame.truth.frame:06d}"
            file = f"JPEGImages/{stem}.{row.file.rpartition('.')[2]}"
            store.write(file, frame.content)
            store.write(f"Annotations/{stem}.xml", _voc_annotation(row, file, labelled=frame.labelled))
            names[row.split].append(stem)
            write(msgspec.structs.replace(row, file=file), None)
        for split, stems in names.items():
            store.write(f"ImageSets/Main/{split}.txt", "".join(f"{stem}\n" for stem in stems).encode())


def _voc_annotation(row: Row, file: str, *, labelled: bool) -> bytes:
    """Pascal VOC's XML of one picture. Its pixels count from 1, and its boxes include their last pixel."""
    root = ET.Element("annotation")

    def put(parent: ET.Element, **values: object) -> None:
        for name, value in values.items():
            ET.SubElement(parent, name).text = str(value)

    folder, _, name = file.partition("/")
    put(root, folder=folder, filename=name)
    put(ET.SubElement(root, "size"), width=row.width_px, height=row.height_px, depth=3)
    put(root, segmented=0)
    if labelled:
        grab = ET.SubElement(root, "object")
        put(grab, name="grab", pose="Unspecified", truncated=int(row.in_frame_fraction < 1))
        put(grab, occluded=int(row.visible_fraction < (1 - OCCLUDED) * row.in_frame_fraction), difficult=0)
        assert row.box_x0_px is not None
        assert row.box_y0_px is not None
        box = {"xmin": row.box_x0_px + 1, "ymin": row.box_y0_px + 1, "xmax": row.box_x1_px, "ymax": row.box_y1_px}
        put(ET.SubElement(grab, "bndbox"), **box)
    ET.indent(root)
    return ET.tostring(root) + b"\n"


def _webdataset(source: ExportSource, store: Store, frames: Frames) -> None:
    """Write each shard when its frames are complete."""
    about, done = source.contents, list[shards.Done]()
    while some := list(itertools.islice(frames, source.shard_frames)):  # whose pictures are read when they are written
        packed = (Packed(frame.truth, frame.coded_mask, _files(frame)) for frame in some)
        done.append(shards.write(store, len(done), packed, about.scenario, about.rendered_by))
    shards.finish(store, about.core, source.shard_frames, done, about.scenario, about.rendered_by, source.sensors)


def _simgrab(source: ExportSource, store: Store, frames: Frames) -> None:
    with tables.tables_of(store, source.contents.core, source.contents.scenario) as write:
        for frame in frames:
            for name, data in _files(frame).items():
                store.write(name, data)
            write(frame.truth, frame.coded_mask)
    tables.finish(store, source.contents, source.sensors)


def _hf(source: ExportSource, store: Store, frames: Frames) -> None:
    """Write labels, and for each split Parquet files of pictures and labels."""
    splits, schema, writers = source.dataset.splits, _hf_schema(), dict[str, LabelWriter]()
    with _tables(source, store) as write, ExitStack() as stack:
        opened = {split: stack.enter_context(ExitStack()) for split in splits}
        written = dict.fromkeys(splits, 0)
        for frame in frames:
            split = frame.truth.split
            number, place = divmod(written[split], source.shard_frames)
            if place == 0:
                opened[split].close()  # completes the file before
                total = math.ceil(splits[split] / source.shard_frames)
                name = f"data/{HF_SPLITS[split]}-{number:05d}-of-{total:05d}.parquet"
                file = opened[split].enter_context(opened[split].enter_context(store.writing(name)).open("wb"))
                writers[split] = opened[split].enter_context(closing(LabelWriter(file, schema, _HF_GROUP_ROWS)))
            writers[split].add(_hf_row(frame))
            written[split] += 1
            write(frame.truth, None)


def _hf_row(frame: LabelledFrame) -> dict[str, Any]:
    row, mask = frame.truth, frame.coded_mask
    boxes = []
    if frame.labelled and frame.box is not None:
        x0, y0, x1, y1 = frame.box.tolist()
        boxes = [[x0, y0, x1 - x0, y1 - y0]]
    return {
        "image": {"bytes": frame.content, "path": row.file.rpartition("/")[2]},
        "objects": {"bbox": boxes, "category": [0] * len(boxes)},
        "mask": None if mask is None else mask.counts,
        **msgspec.structs.asdict(row),
    }


def _hf_schema() -> pa.Schema:
    number = pa.float64()
    objects = pa.struct([("bbox", pa.list_(pa.list_(number))), ("category", pa.list_(pa.int64()))])
    fields = [
        pa.field("image", pa.struct([("bytes", pa.binary()), ("path", pa.string())])),
        tables.column("objects", objects, "px", "boxes x, y, width, height, as COCO's"),
        tables.column("mask", pa.string(), "", "COCO's compressed run lengths"),
        *tables.labels_schema(),
    ]
    about = {"info": {"features": {"image": {"_type": "Image"}}}}
    return pa.schema(fields, metadata={"huggingface": json.dumps(about)})


def _files(frame: LabelledFrame) -> dict[str, bytes]:
    """Files of a frame, by their names in a dataset."""
    names = buffer_names(frame.truth.file)
    return {frame.truth.file: frame.content} | {names[kind]: data for kind, data in frame.buffers.items()}


FORMATS: dict[str, Callable[[ExportSource, Store, Frames], None]] = {
    "yolo": functools.partial(_pictures, kind="box"),
    "yolo-pose": functools.partial(_pictures, kind="pose"),
    "yolo-seg": functools.partial(_pictures, kind="seg"),
    "yolo-obb": functools.partial(_pictures, kind="obb"),
    "coco": functools.partial(_pictures, coco=True),
    "voc": _voc,
    "webdataset": _webdataset,
    "hf": _hf,
    "simgrab": _simgrab,
}
"""Formats by name: each takes the frames, in order, and writes all files."""
